"""Messages of a run on the terminal."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from calib.errors import printable
from planview.output.folder import RunInfo

if TYPE_CHECKING:
    from planview.engine.engine import FrameResult


class PlainConsole(Console):
    """Console that shows control characters, since a folder's name may hold escape codes; no markup unless asked, and
    no emoji for what stands between colons."""

    def __init__(self, *, markup: bool = False, quiet: bool = False, **options: Any) -> None:
        if quiet:  # a notebook would show an empty widget
            options["force_jupyter"] = False
        super().__init__(markup=markup, emoji=False, quiet=quiet, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text), **options)


EVERY_S = 5.0
"""Time between two lines [s]."""


@contextmanager
def compile_notice(console: Console) -> Iterator[None]:
    """Print a line when the first kernel is compiled, and every EVERY_S while more are; none when all are cached."""
    from numba.core.event import Event, Listener, install_listener  # half a second, which only a run pays

    class Lines(Listener):
        kernels = 0
        last_s = 0.0

        def on_start(self, event: Event) -> None:
            if not self.last_s:
                self.show("compiling kernels, once per installation: about a minute")

        def on_end(self, event: Event) -> None:
            self.kernels += 1
            if time.monotonic() - self.last_s > EVERY_S:
                self.show(f"compiling kernels: {self.kernels} so far")

        def show(self, text: str) -> None:
            console.print(text, highlight=False)
            self.last_s = time.monotonic()

    with install_listener("numba:compile", Lines()):
        yield


class FrameProgress(Progress):
    """A bar with frames per second, remaining time and the people in view; call it with every frame."""

    def __init__(self, console: Console, n_frames: int | None, first: int = 0) -> None:
        super().__init__(
            TextColumn("tracking"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[people]}"),
            console=console,
        )
        self._frames = 0
        self._first = first
        self._task = self.add_task("tracking", total=n_frames, rate="", people="")

    def __call__(self, result: FrameResult) -> None:
        people = sum(track.state == "confirmed" for track in result.tracks)
        self._frames += 1
        elapsed_s = self.tasks[0].elapsed
        rate = f"{self._frames / elapsed_s:.1f} frames/s" if elapsed_s else ""
        self.update(self._task, completed=result.frame + 1 - self._first, rate=rate, people=f"{people} in view")


def summary(console: Console, info: RunInfo, folder: Path) -> None:
    """People seen, frames read and skipped, calibration, floor, and the median time of every stage."""
    table = Table(show_header=False, box=None, pad_edge=False)
    people = str(info.people)
    if info.remark:
        people += f": {info.remark}"
    table.add_row("people seen", people)
    frames = f"{info.frames_read:,}"
    if info.first_frame:
        frames += f" from frame {info.first_frame} on, where the background starts"
    if info.skipped:
        frames += f", {info.frames_skipped} skipped ({info.skipped[0].why})"
    table.add_row("frames", f"{frames}, tracked in {info.elapsed_s:.0f} s")
    for note in info.notes:
        table.add_row("note", note)
    if info.rig and info.rig.correction:
        table.add_row("calibration", info.rig.correction)
    if info.floor is not None:
        floor = info.floor
        source = "floor found in the recording" if floor.source == "found" else floor.source
        place = f"{floor.height_m:.2f} m above the floor, tilt {floor.tilt_deg:.1f} degrees"
        table.add_row("camera", f"{place} ({source})")
    stages = ", ".join(f"{name} {ms:.1f}" for name, ms in info.stages_ms.items() if ms is not None)
    table.add_row("ms per frame", f"{stages} (medians; reading runs in parallel)")
    table.add_row("results", str(folder))
    for warning in info.warnings:
        table.add_row("warning", warning.text)
    console.print(table)


def as_text(renderable: RenderableType) -> str:
    """Text that a console would print, as plain text for ``repr``, also in a notebook."""
    file = io.StringIO()
    console = PlainConsole(file=file, width=120, highlight=False, force_jupyter=False, force_terminal=False)
    console.print(renderable)
    return file.getvalue().rstrip()
