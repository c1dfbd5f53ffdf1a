"""``planview bench counting``."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from calib.errors import InputError
from planview.bench.accuracy import RenderOptions
from planview.bench.commands.options import BenchOptions
from planview.bench.counting import (
    ACCURACY_MIN,
    PAPER_RIGHT_PERCENT,
    RIGHT_MIN_PERCENT,
    SINGLE,
    CountingTable,
    SingleTracker,
    scene_names,
    score_pavement,
    score_trajectories,
    score_view,
)


@Parameter(name="*")
@dataclass(frozen=True)
class CountingOptions(BenchOptions):
    """What is counted, and by which tracker."""

    scene: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these rendered scenes, by name."""
    tracker: SingleTracker = "human-model"
    """Who follows people in the rendered views and the pavement clip."""
    data: Path | None = None
    """Folder of the real recordings (trajectories/, overhead-counting/); left out when not given."""
    pavement_camera: Path | None = None
    """camera.toml of the pavement clip; without one, the ellipse-particle tracker and the image are used for it."""
    frames: int | None = None
    """Only the first frames of every rendered scene."""
    scenes: Path = SINGLE
    """Folder with scenes and their rules."""
    out: Path | None = None
    """Folder that keeps the runs; a temporary one by default."""
    figures: Path | None = None
    """Folder that gets pictures of the rendered views: models over the busiest frame, numbers of people over time."""


def bench_counting(*, options: CountingOptions | None = None) -> None:
    """Score counts and occupancy on rendered views and real recordings, beside the paper's figures.

    Example: planview bench counting --scene door_oblique --scene conference

    Example of the wrong numbers of people in view: planview bench counting --scene station --tracker ellipse-particle

    Example with the real recordings: planview bench counting --data ../shared/data --pavement-camera camera.toml
    """
    options = options or CountingOptions()
    if options.frames is not None and options.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {options.frames}")
    settings, messages = options.settings(), Console(stderr=True, markup=False)
    table = CountingTable((), ())
    with tempfile.TemporaryDirectory() as temporary, messages.status("...") as status:
        place = options.out or Path(temporary)
        rendering = RenderOptions(options.cache_folder, frames=options.frames)
        for name in scene_names(options.scene, options.scenes):
            table += score_view(
                name, rendering, place, settings, status.update, options.tracker, options.scenes, options.figures
            )
        if options.data is not None:
            status.update("counting trajectories")
            table += score_trajectories(options.data / "trajectories")
            status.update("tracking the pavement")
            who = options.tracker if options.pavement_camera is not None else "ellipse-particle"
            clip = options.data / "overhead-counting" / "pavement.mp4"
            table += score_pavement(clip, place, settings, who, options.pavement_camera)
    if options.json_output:
        print(json.dumps(table.to_json(), indent=2))
    else:
        print_counting(table, Console(markup=False))


def print_counting(table: CountingTable, console: Console) -> None:
    """Crossings as in table 3 and occupancy as in table 4 of the paper, beside what they must be."""
    if table.crossings:
        shown = _table("view: line", "true", "found", "acc. %", "strict %", "prec. rec.", "turned", "late s", "")
        for row in table.crossings:
            s = row.scores
            shown.add_row(
                f"{row.recording}: {row.rule}", f"{s.true_left_to_right}+{s.true_right_to_left}",
                f"{s.found_left_to_right}+{s.found_right_to_left}", _number(s.accuracy, 100),
                _number(s.strict_accuracy, 100), f"{_number(s.precision, 1, 2)} {_number(s.recall, 1, 2)}",
                str(s.wrong_direction), _number(s.timing_mean_s, 1, 2, "+"), _verdict(row.ok),
            )  # fmt: skip
        console.print(shown)
        console.print(f"left to right + right to left; to reach: {100 * ACCURACY_MIN:.0f} % (paper, table 3: 76-97 %)")
    if table.occupancy:
        shown = _table("view: zone", "people", "frames", "right %", "to reach", "paper", "E(d)", "E|d|", "")
        for line in table.occupancy:
            g = line.group
            shown.add_row(
                f"{line.recording}: {line.rule}", g.people, str(g.frames), _number(g.right_percent),
                f"{RIGHT_MIN_PERCENT[g.people]:.0f}", f"{PAPER_RIGHT_PERCENT[g.people]:.1f}",
                _number(g.mean_difference, 1, 2, "+"), _number(g.mean_absolute_difference, 1, 2), _verdict(line.ok),
            )  # fmt: skip
        console.print(shown)
        console.print("E(d), E|d|: mean and mean absolute difference of found and true number")
    for view in table.views:
        console.print(
            f"{view.recording}: wrong number of people in view in {view.wrong} of {view.frames} frames "
            f"({100 * view.error:.1f} %), too few in {view.too_few}",
            highlight=False,
        )


def _table(*columns: str) -> Table:
    table = Table(*columns, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for number, column in enumerate(table.columns):
        column.justify = "right" if number else "left"
    return table


def _verdict(ok: bool) -> str:
    return "ok" if ok else "short"


def _number(value: float | None, factor: float = 1.0, digits: int = 1, sign: str = "") -> str:
    return "-" if value is None else f"{factor * value:{sign}.{digits}f}"
