"""``python -m benchmarks suite``."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from benchmarks.accuracy import scene_files
from benchmarks.commands.options import BenchOptions
from benchmarks.passes import BenchTracker, in_processes
from benchmarks.provenance import provenance
from benchmarks.suite import (
    JUDGING_SEED,
    SUITE,
    SuiteJob,
    SuiteScore,
    SuiteTotals,
    Way,
    chosen_files,
    dealt_files,
    run_job,
    suite_totals,
)
from calib.errors import InputError
from calib.io import write_whole


@Parameter(name="*")
@dataclass(frozen=True)
class ChallengeOptions(BenchOptions):
    """Which challenges are drawn, and how they are tracked."""

    seed: Annotated[Sequence[int], Parameter(negative="")] = ()
    """Seeds to draw; a new one from the clock by default, so that no work was done on it."""
    minutes: float = 10.0
    """Length of the scenes of each seed together [min]; the seed decides which scenes. The whole suite is longer than
    ten minutes."""
    scene: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these scenes, by name."""
    deal: Annotated[bool, Parameter(negative="")] = False
    """Deal all scenes out to the seeds in turn, instead of drawing every scene with every seed."""
    jobs: int = 1
    """Scenes worked on at the same time, each in a process of its own."""
    tracker: BenchTracker = "template"
    """Tracker that follows people; peer is the naive engine to compare with."""
    refine: Annotated[bool, Parameter(negative="")] = False
    """Score the refined tracks, too."""
    peer: Annotated[bool, Parameter(negative="")] = False
    """Score the naive engine, too: its tracks come from the same pass."""
    scenes: Path = SUITE
    """Folder with challenges."""
    out: Path | None = None
    """Folder that keeps the runs (tracks.csv, run.json) and suite.json; nothing is kept by default."""


def bench_suite(*, options: ChallengeOptions | None = None) -> None:
    """Render challenges that a seed draws, track them and score them.

    Every seed is another recording of every scene: other rooms, rigs, lenses, light, people, clothes and ways. Seeds 0
    to 99 are for working on the engine; seeds from 100 on are for judging it, each once.

    Rendered recordings, and runs of the present code over them, are kept in the cache: what was interrupted goes on
    where it was.

    Example: python -m benchmarks suite --seed 1 --minutes 3 --jobs 2 --refine --peer
    """
    options = options or ChallengeOptions()
    if options.jobs < 1 or not 0 < options.minutes <= 1000 or any(s < 0 for s in options.seed):
        raise InputError(
            f"expected --jobs from 1, --minutes above 0, --seed from 0, "
            f"found {options.jobs}, {options.minutes:g}, {options.seed}"
        )
    console = Console(stderr=True, markup=False)
    seeds = list(dict.fromkeys(options.seed)) or [_new_seed()]
    console.print("seeds: " + ", ".join(f"{s} ({'judging' if s >= JUDGING_SEED else 'worked on'})" for s in seeds))
    settings, files = options.settings(), scene_files(options.scene, options.scenes)
    if options.deal:
        chosen = dealt_files(files, seeds)
    else:
        chosen = [(s, path) for s in seeds for path in chosen_files(files, s, options.minutes)]
    o = options
    work = [SuiteJob(p, s, o.cache_folder, o.out, settings, o.tracker, o.refine, o.peer) for s, p in chosen]
    ways = _watched(work, options.jobs, console)
    result = {"seeds": seeds, **provenance()} | {
        way: _json(scores, suite_totals(scores)) for way, scores in ways.items()
    }
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        write_whole(options.out / "suite.json", json.dumps(result, indent=2) + "\n")
    if options.json_output:
        print(json.dumps(result, indent=2))
        return
    for way, scores in ways.items():
        print_suite(way, scores, suite_totals(scores), Console(markup=False))


def _new_seed() -> int:
    """A judging seed from the clock, which has most likely never been drawn."""
    return JUDGING_SEED + (time.time_ns() // 1_000_000 ^ os.getpid()) % 1_000_000_000


def _watched(work: Sequence[SuiteJob], jobs: int, console: Console) -> dict[Way, list[SuiteScore]]:
    """Scores of every way in the order of the work, with a bar while it lasts."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    done: dict[tuple[int, str], list[SuiteScore]] = {}
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("rendering and tracking", total=len(work))
        for scores in in_processes(run_job, work, jobs):
            first = scores[0].score
            done[first.seed, first.name] = scores
            progress.update(task, advance=1, description=f"{first.name}-{first.seed} done")
    ways: dict[Way, list[SuiteScore]] = {}
    for job in work:
        for score in done[job.seed, job.path.stem]:
            ways.setdefault(score.way, []).append(score)
    return ways


def print_suite(way: Way, scores: Sequence[SuiteScore], together: SuiteTotals, console: Console) -> None:
    """A row per scene, and all together: significant errors, switches, mean errors of position and height [cm]."""
    table = Table(f"scene, {way}", "seed", "rows", "significant", "MOTA", "IDF1", "switch", "pos cm", "height")
    for column in (*table.columns[1:3], *table.columns[4:]):
        column.justify = "right"
    for item in scores:
        e = item.score.evaluation.to_json()
        table.add_row(
            item.score.name, str(item.score.seed), str(e["truth_rows"]), _kinds(e["significant_errors"]),
            _number(e["mota"]), _number(e["idf1"]), str(e["switches"]),
            _number(e["position_error_mean_m"], 100, 1), _number(e["height_error_mean_m"], 100, 1),
        )  # fmt: skip
    table.add_section()
    table.add_row(
        f"all, {together.minutes:.1f} min", "", str(together.truth_rows), _kinds(together.significant),
        _number(together.mota), _number(together.idf1), str(together.switches),
        _number(together.position_error_m, 100, 1), _number(together.height_error_m, 100, 1),
    )  # fmt: skip
    console.print(table)
    console.print(
        f"per 10 minutes: {together.significant_per_10_min:.1f} significant errors, {together.strict_per_10_min:.1f} "
        "with every change of identity"
    )
    for item in scores:
        for error in item.score.evaluation.significant:
            where = f"{way}: {item.score.name} ({item.score.seed}) frame {error.frame}"
            who = f"person {error.truth_id}, track {error.track_id}"
            console.print(f"{where}: {error.kind}, {who}: {error.note}", highlight=False)


def _kinds(counts: dict[str, int]) -> str:
    return ", ".join(f"{kind} {n}" for kind, n in counts.items() if n and kind != "total") or "none"


def _json(scores: Sequence[SuiteScore], together: SuiteTotals) -> dict[str, Any]:
    whole = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(together).items()}
    return {"scenes": [score.to_json() for score in scores], "totals": whole}


def _number(value: float | None, factor: float = 1.0, digits: int = 3) -> str:
    return "-" if value is None or math.isnan(value) else f"{factor * value:.{digits}f}"
