"""``python -m benchmarks counting``."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, get_args

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from benchmarks.accuracy import RenderOptions
from benchmarks.commands.options import BenchOptions
from benchmarks.counting import (
    ACCURACY_MIN,
    PAPER_RIGHT_PERCENT,
    SINGLE,
    CountingTable,
    Scorer,
    SingleTracker,
    scene_names,
    score_trajectories,
    score_view,
)
from benchmarks.pavement import score_pavement
from benchmarks.rooms import all_rooms, score_room
from benchmarks.views import ViewScore, ViewTracker, score_drawn_view, view_names
from calib.errors import InputError


@Parameter(name="*")
@dataclass(frozen=True)
class CountingOptions(BenchOptions):
    """What is counted, and by which tracker."""

    scene: Annotated[Sequence[str], Parameter(negative="", show_default=False)] = ()
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
    seeds: Annotated[Sequence[int], Parameter(negative="", show_default=False)] = ()
    """Seeds of the drawn views of data/synthetic/views (--scene names some of these then), with both trackers. Seeds 0
    to 9 are worked on, others judge."""
    rooms: Annotated[Sequence[int], Parameter(negative="", show_default=False)] = ()
    """Seeds of drawn conference rooms: another camera, other clothes and seats each. Seeds 0 to 9 are worked on, others
    judge."""
    out: Path | None = None
    """Folder that keeps the runs; a temporary one by default."""
    figures: Path | None = None
    """Folder that gets pictures of the rendered views: models over the busiest frame, numbers of people over time."""


def bench_counting(*, options: CountingOptions | None = None) -> None:
    """Score counts and occupancy on rendered views and real recordings, beside the paper's figures.

    Example: python -m benchmarks counting --scene door_oblique --scene conference

    Example of wrong numbers of people: python -m benchmarks counting --scene station --tracker ellipse-particle

    Example with drawn views of seeds never looked at: python -m benchmarks counting --seeds 501 --seeds 502

    Example with drawn conference rooms: python -m benchmarks counting --rooms 501 --rooms 502

    Example with the real recordings: python -m benchmarks counting --data ../shared/data --pavement-camera camera.toml
    """
    options = options or CountingOptions()
    if options.frames is not None and options.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {options.frames}")
    if options.seeds:
        _bench_views(options)
        return
    if options.rooms:
        _bench_rooms(options)
        return
    table = CountingTable((), ())
    with _scoring(options) as scorer:
        for name in scene_names(options.scene, options.scenes):
            table += score_view(name, scorer, options.scenes)
        if options.data is not None:
            scorer.tell("counting trajectories")
            table += score_trajectories(options.data / "trajectories")
            who = options.tracker if options.pavement_camera is not None else "ellipse-particle"
            clip = options.data / "overhead-counting" / "pavement.mp4"
            table += score_pavement(clip, replace(scorer, tracker=who), options.pavement_camera)
    _print(table, options)


@contextmanager
def _scoring(options: CountingOptions) -> Iterator[Scorer]:
    """With a line of progress, and a temporary folder for runs that are not kept."""
    settings, rendering = options.settings(), RenderOptions(options.cache_folder, frames=options.frames)
    with tempfile.TemporaryDirectory() as temporary, Console(stderr=True, markup=False).status("...") as status:
        place = options.out or Path(temporary)
        yield Scorer(rendering, place, settings, status.update, options.tracker, options.figures)


def _bench_rooms(options: CountingOptions) -> None:
    _require_seeds("--rooms", options.rooms)
    with _scoring(options) as scorer:
        tables = [score_room(seed, scorer) for seed in options.rooms]
    _print(all_rooms(tables), options)


def _print(table: CountingTable, options: CountingOptions) -> None:
    if options.json_output:
        print(json.dumps(table.to_json(), indent=2))
    else:
        print_counting(table, Console(markup=False))


def _require_seeds(name: str, seeds: Sequence[int]) -> None:
    if min(seeds) < 0:
        raise InputError(f"{name}: expected numbers from 0, found {min(seeds)}")


def _bench_views(options: CountingOptions) -> None:
    _require_seeds("--seeds", options.seeds)
    settings, rendering = options.settings(), RenderOptions(options.cache_folder, frames=options.frames)
    with Console(stderr=True, markup=False).status("...") as status:
        scores = [
            score_drawn_view(name, seed, tracker, rendering, settings, status.update)
            for seed in options.seeds
            for name in view_names(options.scene)
            for tracker in get_args(ViewTracker)
        ]
    if options.json_output:
        print(json.dumps([score.to_json() for score in scores], indent=2))
    else:
        print_views(scores, Console(markup=False))


def print_views(scores: Sequence[ViewScore], console: Console) -> None:
    """A row per view and tracker, and each tracker's mean and worst."""
    shown = _table(
        "view, seed", "tracker", "true", "found", "strict %", "people", "there", "wrong frames %", "occupancy %"
    )
    for s in scores:
        c = s.crossings
        shown.add_row(
            f"{s.view} {s.seed}", s.tracker, f"{c.true_left_to_right}+{c.true_right_to_left}",
            f"{c.found_left_to_right}+{c.found_right_to_left}", _number(s.strict, 100), str(s.found), str(s.there),
            _number(s.wrong_frames, 100), _number(s.occupancy, 100),
        )  # fmt: skip
    console.print(shown)
    for tracker in get_args(ViewTracker):
        mine = [s for s in scores if s.tracker == tracker]
        strict, found, there = [s.strict for s in mine], sum(s.found for s in mine), sum(s.there for s in mine)
        mean, occupied = sum(strict) / len(strict), sum(s.occupancy for s in mine) / len(mine)
        console.print(
            f"{tracker}: crossings strict {100 * mean:.1f} % on average, {100 * min(strict):.1f} % on the worst; "
            f"{found} people counted, {there} were there; number of people in the middle of the view right in "
            f"{100 * occupied:.1f} % of the frames",
            highlight=False,
        )


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
                f"{line.min_percent:.0f}", f"{PAPER_RIGHT_PERCENT[g.people]:.1f}",
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
