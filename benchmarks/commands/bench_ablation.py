"""``python -m benchmarks ablation``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from benchmarks.ablation import AblationRecording, AblationRow, Interval, Trial, ablation_rows, run_trials
from benchmarks.accuracy import scene_files
from benchmarks.commands.options import BenchOptions
from benchmarks.provenance import provenance
from benchmarks.suite import SUITE, chosen_files
from benchmarks.variants import CONFIGURED, LADDER, RULES, Variant, chosen_variants
from calib.errors import InputError
from calib.io import write_whole
from planview.evaluation.result import KINDS, Evaluation

TABLE_WIDTH = 144
"""Columns of text that the table needs."""


@Parameter(name="*")
@dataclass(frozen=True)
class AblationOptions(BenchOptions):
    """Which variants are compared, and on what."""

    rules: Annotated[bool, Parameter(negative="")] = False
    """Switch off the template tracker's special rules instead of parts of the engine."""
    variant: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these variants, by name."""
    seed: Annotated[Sequence[int], Parameter(negative="")] = ()
    """Seeds of the challenges; 1 by default, and none where --recording is given."""
    minutes: float = 10.0
    """Length of the challenges of each seed together [min]."""
    scene: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these challenges, by name."""
    recording: Annotated[Sequence[Path], Parameter(negative="")] = ()
    """A recording folder with truth.csv; may be given several times."""
    jobs: int = 1
    """Trials at the same time, each in a process of its own."""
    scenes: Path = SUITE
    """Folder with challenges."""
    out: Path | None = None
    """JSON file that gets the table; none by default."""


def bench_ablation(*, options: AblationOptions | None = None) -> None:
    """Switch parts of the engine off, one at a time, and compare all variants on the same recordings.

    One table: significant errors, identity changes, misses, false positives and mean position error of every variant,
    with 95 % bootstrap intervals over recordings, beside the paper's figures (Harville 2002, section 5: 1 significant
    error, 17 without occupancy, 25 without height). Variants of the tracker track the recorded plan-view points of the
    engine as configured; those of foreground and feedback run in full.

    Example: python -m benchmarks ablation --scene trio --scene crossing --jobs 2
    """
    o = options or AblationOptions()
    if o.jobs < 1 or not 0 < o.minutes <= 1000 or any(s < 0 for s in o.seed):
        raise InputError(
            f"expected --jobs from 1, --minutes above 0, --seed from 0, found {o.jobs}, {o.minutes:g}, {o.seed}"
        )
    base, variants = o.settings(), chosen_variants(RULES if o.rules else LADDER, o.variant)
    given = [AblationRecording(path, None, o.cache_folder) for path in o.recording]
    for recording in given:
        recording.folder()
    recordings = given + _challenges(o)
    rows = ablation_rows(_watched([Trial(r, v, base) for v in variants for r in recordings], variants, o.jobs))
    names = {"recordings": [r.name for r in recordings], **provenance()}
    text = json.dumps(names | {"variants": [row.to_json() for row in rows]}, indent=2) + "\n"
    if o.out is not None:
        o.out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(o.out, text)
    if o.json_output:
        print(text, end="")
    else:
        print_ablation(rows, Console(markup=False, width=TABLE_WIDTH))


def _challenges(o: AblationOptions) -> list[AblationRecording]:
    if o.recording and not o.seed and not o.scene:
        return []
    files = scene_files(o.scene, o.scenes)
    return [
        AblationRecording(path, s, o.cache_folder)
        for s in dict.fromkeys(o.seed or [1])
        for path in chosen_files(files, s, o.minutes)
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
