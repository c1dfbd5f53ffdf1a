"""``planview bench ablation``."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from calib.errors import InputError
from planview.bench.ablation import AblationRecording, AblationRow, Interval, Trial, ablation_rows, run_trials
from planview.bench.accuracy import cache_folder, scene_files
from planview.bench.suite import SUITE, chosen_files
from planview.bench.variants import CONFIGURED, LADDER, RULES, Variant, chosen_variants
from planview.evaluation.result import KINDS, Evaluation
from planview.pipeline.config import load_config

TABLE_WIDTH = 144
"""Columns of text that the table needs."""


def bench_ablation(
    *,
    rules: Annotated[bool, Parameter(negative="")] = False,
    variant: Annotated[Sequence[str], Parameter(negative="")] = (),
    seed: Annotated[Sequence[int], Parameter(negative="")] = (),
    minutes: float = 10.0,
    scene: Annotated[Sequence[str], Parameter(negative="")] = (),
    recording: Annotated[Sequence[Path], Parameter(negative="")] = (),
    jobs: int = 1,
    scenes: Path = SUITE,
    cache: Path | None = None,
    config: Path | None = None,
    set_: Annotated[Sequence[str], Parameter(name="--set")] = (),
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Switch parts of the engine off, one at a time, and compare all variants on the same recordings.

    One table: significant errors, identity changes, misses, false positives and mean position error of every variant,
    with 95 % bootstrap intervals over recordings, beside the paper's figures (Harville 2002, section 5: 1 significant
    error, 17 without occupancy, 25 without height). Variants of the tracker track the recorded plan-view points of the
    engine as configured; those of foreground and feedback run in full.

    Example: planview bench ablation --scene trio --scene crossing --jobs 2

    Parameters
    ----------
    rules
        Switch off the template tracker's special rules instead of parts of the engine.
    variant
        Only these variants, by name.
    seed
        Seeds of the challenges; 1 by default, and none where --recording is given.
    minutes
        Length of the challenges of each seed together [min].
    scene
        Only these challenges, by name.
    recording
        A recording folder with truth.csv; may be given several times.
    jobs
        Trials at the same time, each in a process of its own.
    scenes
        Folder with challenges.
    cache
        Folder for rendered recordings; the user's cache by default.
    config
        TOML file with parameters of the pipeline; what is configured there is the first row.
    set_
        One parameter of the pipeline.
    json_output
        Print one JSON object.
    """
    if jobs < 1 or not 0 < minutes <= 1000 or any(s < 0 for s in seed):
        raise InputError(f"expected --jobs from 1, --minutes above 0, --seed from 0, found {jobs}, {minutes:g}, {seed}")
    base, variants = load_config(config, set_), chosen_variants(RULES if rules else LADDER, variant)
    rendered = _challenges(seed, minutes, scene, scenes, cache or cache_folder(), bool(recording))
    recordings = [AblationRecording(path, None, path) for path in recording] + rendered
    for folder in recording:
        AblationRecording(folder, None, folder).folder()
    with tempfile.TemporaryDirectory(prefix="planview-ablation-") as temporary:
        trials = [Trial(r, v, base, Path(temporary) / f"{i}.h5") for v in variants for i, r in enumerate(recordings)]
        rows = ablation_rows(_watched(trials, variants, jobs))
    if json_output:
        found = [row.to_json() for row in rows]
        print(json.dumps({"recordings": [r.name for r in recordings], "variants": found}, indent=2))
    else:
        print_ablation(rows, Console(markup=False, width=TABLE_WIDTH))


def _challenges(
    seeds: Sequence[int], minutes: float, scene: Sequence[str], scenes: Path, cache: Path, folders: bool
) -> list[AblationRecording]:
    if folders and not seeds and not scene:
        return []
    files = scene_files(scene, scenes)
    return [
        AblationRecording(path, s, cache)
        for s in dict.fromkeys(seeds or [1])
        for path in chosen_files(files, s, minutes)
    ]


def _watched(trials: Sequence[Trial], variants: Sequence[Variant], jobs: int) -> dict[Variant, list[Evaluation]]:
    """Scores of every variant in the order of the recordings, with a bar while it lasts."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    done: dict[Trial, Evaluation] = {}
    with Progress(*columns, console=Console(stderr=True, markup=False)) as progress:
        task = progress.add_task("the engine as configured", total=len(trials))
        for score in run_trials(trials, jobs):
            done[score.trial] = score.evaluation
            name = f"{score.trial.variant.name}: {score.trial.recording.name} done"
            progress.update(task, advance=1, description=name)
    return {v: [done[trial] for trial in trials if trial.variant == v] for v in variants}


def print_ablation(rows: Sequence[AblationRow], console: Console) -> None:
    """A row per variant, below every figure its interval; then what each variant switches off."""
    table = Table(
        "variant", "lost, missed,\nswapped, false", "significant\nper 10 min", "change", "paper",
        "identity\nper 10 min", "misses\n%", "false\npositives %", "position\ncm",
    )  # fmt: skip
    for column in table.columns:
        column.no_wrap = True
    for row in rows:
        v = row.variant
        table.add_row(
            v.name, ", ".join(str(row.significant[kind]) for kind in KINDS), _figure(row.per_10_min),
            "" if v == CONFIGURED else _figure(row.change_per_10_min), "" if v.paper is None else str(v.paper),
            _figure(row.strict_per_10_min), _figure(row.misses, 100), _figure(row.false_positives, 100),
            _figure(row.position_error_m, 100),
        )  # fmt: skip
    console.print(table)
    for row in rows:
        if row.variant.meaning:
            console.print(f"{row.variant.name}: {row.variant.meaning}", highlight=False)


def _figure(value: Interval, factor: float = 1.0) -> str:
    if math.isnan(value.value):
        return "-"
    number, low, high = (f"{factor * x:.1f}" for x in value)
    return f"{number}\n[{low}, {high}]"
