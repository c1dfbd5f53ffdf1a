"""``python -m benchmarks accuracy``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from benchmarks.accuracy import (
    LIMITS,
    RenderOptions,
    SceneScore,
    Totals,
    scene_files,
    score_scene,
    totals,
)
from benchmarks.commands.options import BenchOptions
from benchmarks.passes import BenchTracker
from calib.errors import InputError
from planview.synthetic.assets import SCENES


@Parameter(name="*")
@dataclass(frozen=True)
class AccuracyOptions(BenchOptions):
    """What is rendered, tracked and scored."""

    scene: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these scenes, by name."""
    seeds: int = 1
    """Seed 0 is the scene as committed; every further one a variation of it."""
    tracker: BenchTracker = "template"
    """Which tracker to score; peer is the naive engine to compare with."""
    frames: int | None = None
    """Only the first frames of every scene."""
    scale: float = 1.0
    """Factor on the image size."""
    scenes: Path = SCENES
    """Folder with scenes."""
    out: Path | None = None
    """Folder that keeps the runs (tracks.csv, run.json); nothing is kept by default."""


def bench_accuracy(*, options: AccuracyOptions | None = None) -> None:
    """Render every committed scene, track it and score it.

    Example: python -m benchmarks accuracy --scene crossing --scene group

    Example with three variations of each scene (other walks, rigs and heights): python -m benchmarks accuracy --seeds 4
    """
    options = options or AccuracyOptions()
    if options.seeds < 1 or (options.frames is not None and options.frames < 1) or not 0.05 <= options.scale <= 4:
        raise InputError(
            f"expected --seeds and --frames from 1, --scale 0.05 to 4, "
            f"found {options.seeds}, {options.frames}, {options.scale:g}"
        )
    settings, messages = options.settings(), Console(stderr=True, markup=False)
    with messages.status("...") as status:
        tasks = [(path, seed) for path in scene_files(options.scene, options.scenes) for seed in range(options.seeds)]
        rendering = RenderOptions(options.cache_folder, options.scale, options.frames)
        scores = [
            score_scene(path, seed, rendering, options.out, settings, status.update, options.tracker)
            for path, seed in tasks
        ]
    together = totals(scores)
    if options.json_output:
        print(json.dumps(_json(scores, together), indent=2))
    else:
        print_scores(scores, together, Console(markup=False))


def print_scores(scores: Sequence[SceneScore], together: Totals, console: Console) -> None:
    """A row per recording, then all together beside what they must keep."""
    table = Table("scene", "rows", "MOTA", "IDF1", "position cm", "height cm", "switches", "significant errors")
    for column in table.columns[1:7]:
        column.justify = "right"
    for score in scores:
        e = score.evaluation.to_json()
        kinds = [f"{k} {v}" for k, v in e["significant_errors"].items() if v and k != "total"]
        name = score.name + (f" ({score.seed})" if score.seed else "")
        table.add_row(
            name, str(e["truth_rows"]), _number(e["mota"]), _number(e["idf1"]),
            f"{_number(e['position_error_mean_m'], 100, 1)} ± {_number(e['position_error_std_m'], 100, 1)}",
            _number(e["height_error_mean_m"], 100, 1), str(e["switches"]), ", ".join(kinds) or "none",
        )  # fmt: skip
    table.add_section()
    table.add_row(
        "all", str(together.truth_rows), _number(together.mota), "",
        f"{_number(together.position_error_m, 100, 1)} ± {_number(together.position_std_m, 100, 1)}",
        _number(together.height_error_m, 100, 1), "", str(together.significant["total"]),
    )  # fmt: skip
    table.add_row("must be", "", "", "", f"<= {100 * LIMITS['position_error_m']:.0f}",
                  f"<= {100 * LIMITS['height_error_m']:.0f}", "", f"<= {LIMITS['significant_errors']:.0f}")  # fmt: skip
    console.print(table)
    for score in scores:
        for error in score.evaluation.significant:
            console.print(
                f"{score.name} ({score.seed}) frame {error.frame}: {error.kind}, person {error.truth_id}, "
                f"track {error.track_id}: {error.note}",
                highlight=False,
            )


def _json(scores: Sequence[SceneScore], together: Totals) -> dict[str, Any]:
    whole = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(together).items()}
    return {"scenes": [score.to_json() for score in scores], "totals": whole, "limits": LIMITS}


def _number(value: float | None, factor: float = 1.0, digits: int = 3) -> str:
    return "-" if value is None or math.isnan(value) else f"{factor * value:.{digits}f}"
