"""``python -m benchmarks foreground``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from benchmarks.accuracy import RenderOptions
from benchmarks.commands.options import BenchOptions
from benchmarks.foreground import CONDITIONS, ForegroundScore, pooled, score_foreground
from benchmarks.views import view_names
from calib.errors import InputError


@Parameter(name="*")
@dataclass(frozen=True)
class ForegroundOptions(BenchOptions):
    """Which views are drawn, and how much of them."""

    scene: Annotated[Sequence[str], Parameter(negative="")] = ("lobby",)
    """Views of data/synthetic/views, by name."""
    seeds: Annotated[Sequence[int], Parameter(negative="")] = (0,)
    """Seeds of the views. Seeds 0 to 9 are worked on, others judge."""
    frames: int = 150
    """Only the first frames of every view."""


def bench_foreground(*, options: ForegroundOptions | None = None) -> None:
    """Share of wrong pixels of one camera's foreground beside OpenCV's MOG2 and KNN, by condition, with exact masks.

    Each view is drawn once per condition (dark, blurred, compressed, a polished floor...); the first three seconds do
    not count.

    Example: python -m benchmarks foreground --scene lobby --seeds 0
    """
    options = options or ForegroundOptions()
    if options.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {options.frames}")
    if not options.seeds or min(options.seeds) < 0:
        raise InputError("--seeds: expected numbers from 0")
    settings, rendering = options.settings(), RenderOptions(options.cache_folder, frames=options.frames)
    with Console(stderr=True, markup=False).status("...") as status:
        scores = [
            score
            for seed in options.seeds
            for name in view_names(options.scene)
            for condition in CONDITIONS
            for score in score_foreground(name, seed, condition, rendering, settings, status.update)
        ]
    if options.json_output:
        print(json.dumps([score.to_json() for score in scores], indent=2))
    else:
        print_foreground(scores, Console(markup=False))


def print_foreground(scores: Sequence[ForegroundScore], console: Console) -> None:
    """A row per condition: wrong pixels in percent, missed people and false room pixels in brackets."""
    methods = list(dict.fromkeys(score.method for score in scores))
    shown = Table("condition", *methods, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for condition in dict.fromkeys(score.condition for score in scores):
        cells = [pooled(scores, condition, method) for method in methods]
        texts = [f"{100 * wrong:.2f} ({100 * missed:.0f}, {100 * false:.2f})" for wrong, missed, false in cells]
        shown.add_row(condition, *texts)
    console.print(shown)
    console.print("wrong pixels %; in brackets people's pixels missed %, and the room's that are foreground %")
