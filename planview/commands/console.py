"""What commands draw on the terminal: messages, how far the work is, and a table about a run."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from calib.errors import printable
from planview.output.folder import RunInfo


class PlainConsole(Console):
    """Console that shows control characters, since a folder's name may hold escape codes; no markup by default, and
    no emoji for what stands between colons."""

    def __init__(self, *, markup: bool = False, **options: Any) -> None:
        super().__init__(markup=markup, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text), **options)


class Bar(Progress):
    """What is being done and how much of it, with its rate and the time that is left."""

    def __init__(self, console: Console) -> None:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
        )
        super().__init__(*columns, console=console, transient=True, disable=not console.is_terminal)
        self.begin("working")

    def begin(self, what: str) -> None:
        """Draw other work from its beginning."""
        for task in self.task_ids:
            self.remove_task(task)
        self._task = self.add_task(what, total=None, rate="")

    def __call__(self, done: int, total: int | None) -> None:
        elapsed_s = self.tasks[0].elapsed
        rate = f"{done / elapsed_s:.1f} per second" if elapsed_s else ""
        self.update(self._task, completed=done, total=total, rate=rate)


class _Shown(logging.Handler):
    """Shows what the library logs: what it does next on the bar, anything else as a line."""

    def __init__(self, bar: Bar) -> None:
        super().__init__()
        self._bar = bar

    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        if record.levelno == logging.DEBUG:
            self._bar.begin(message)
        elif record.levelno == logging.INFO:
            self._bar.console.print(message, highlight=False, soft_wrap=True)
        else:
            print(printable(message), file=sys.stderr)


@contextmanager
def drawing(*, quiet: bool = False) -> Iterator[Bar]:
    """Draw how far the work is, and show what it logs, until the block ends; with ``quiet`` warnings alone."""
    logger = logging.getLogger("planview")
    level = logger.level
    bar = Bar(PlainConsole(stderr=True, quiet=quiet))
    handler = _Shown(bar)
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    try:
        with bar:
            yield bar
    finally:
        logger.setLevel(level)
        logger.removeHandler(handler)


EVERY_S = 5.0
"""Time between two lines [s]."""


@contextmanager
def compile_notice() -> Iterator[None]:
    """Log a line when the first kernel is compiled, and every EVERY_S while more are; none when all are cached."""
    from numba.core.event import Event, Listener, install_listener  # half a second, which only a run pays

    log = logging.getLogger(__name__)

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
            log.info(text)
            self.last_s = time.monotonic()

    with install_listener("numba:compile", Lines()):
        yield


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
