"""``python -m benchmarks heads``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from benchmarks.commands.options import BenchOptions
from benchmarks.heads import LIMITS, HeadsScore, score_heads
from calib.errors import InputError


@Parameter(name="*")
@dataclass(frozen=True)
class HeadsOptions(BenchOptions):
    """Which scenes are drawn."""

    seeds: Annotated[Sequence[int], Parameter(consume_multiple=True, negative="")] = (101, 102, 103)
    """Seeds to draw; 0 and 1 were worked on."""


def bench_heads(*, options: HeadsOptions | None = None) -> None:
    """Two heads in one room: how well people align them, and tracking with both against each alone.

    Every seed draws a room with two heads (on opposite walls, beside each other, or across a corner), two or three
    people who walk about, and clocks that begin apart. Every head is tracked alone, the heads are aligned by these
    tracks, and both are tracked in one world with that alignment.

    Example: python -m benchmarks heads --seeds 101 102 103
    """
    options = options or HeadsOptions()
    if not options.seeds or any(seed < 0 for seed in options.seeds):
        raise InputError(f"--seeds: expected seeds from 0, found {list(options.seeds)}")
    console, config = Console(stderr=True, markup=False), options.settings()
    scores = [score_heads(seed, options.cache_folder, config, console.print) for seed in options.seeds]
    if options.json_output:
        print(json.dumps({"limits": LIMITS, "seeds": [score.to_json() for score in scores]}, indent=2))
    else:
        print_heads(scores, Console(markup=False))


def print_heads(scores: Sequence[HeadsScore], console: Console) -> None:
    """A row per seed: errors of the alignment, position errors alone and together, errors of identity together."""
    errors_of = ("swapped", "lost", "missed", "false_track")
    table = Table("seed", "scene", "align cm", "deg", "ms", "alone cm", "both cm", "switches", *errors_of)
    for score in scores:
        a, joint = score.alignment, score.joint.to_json()
        errors = joint["significant_errors"]
        table.add_row(
            str(score.seed),
            score.description.split(",")[0],
            f"{100 * a.position_m:.1f}" if a else "refused",
            f"{math.degrees(abs(a.heading_rad)):.2f}" if a else "-",
            f"{1000 * abs(a.clock_s):.0f}" if a else "-",
            f"{100 * score.single_error_m:.1f}",
            f"{100 * score.joint_error_m:.1f}",
            str(joint["switches"]),
            *(str(errors[kind]) for kind in errors_of),
        )
    console.print(table)
    for score in scores:
        if score.refusal:
            console.print(f"seed {score.seed}: {score.refusal}")
    console.print(
        f"asked: alignment within {LIMITS['position_cm']:g} cm, {LIMITS['heading_deg']:g} degrees and "
        f"{LIMITS['clock_ms']:g} ms; both no worse than alone; no change of identity"
    )
