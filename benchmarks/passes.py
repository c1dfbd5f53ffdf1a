"""Runs of an engine over rendered recordings, kept in their cache, and their scores."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import cv2

import planview
from benchmarks import peaks
from benchmarks.options import Row, progress
from benchmarks.peaks import PeakTracker
from calib.errors import WorkError
from calib.io import whole_folder
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.open import open_engine
from planview.evaluation.result import KINDS, Evaluation, pool
from planview.evaluation.significant import poisson_upper
from planview.output.folder import finished_run
from planview.output.resume import code_version, key_of
from planview.output.run import run
from planview.output.run_spec import RunSpec
from planview.studies.workers import on_workers, workers
from stereo.readers import OpenOptions

FACING = "median difference of walkers to the truth, or where that has no facing, to their direction of walking"
Job = TypeVar("Job")
Result = TypeVar("Result")
RATES_HZ = {"rgbd-one-walker": 5.0, "rgbd-six-people": 5.0}
"""Frame rates of real recordings without times, as the files that describe them give them."""


def bench_engine(recording: Path, tracker: str, config: Config | None, camera: Path | None = None) -> Engine:
    """An engine of a recording with a tracker of planview, or the baseline "peaks" (errors as of ``open_engine``)."""
    chosen = cast(Any, PeakTracker() if tracker == "peaks" else tracker)
    return open_engine(recording, chosen, config, camera, OpenOptions(fps=RATES_HZ.get(recording.name)))


@dataclass(frozen=True)
class Pass:
    """One run of one engine over the folder of a recording, kept in ``runs`` below the cache."""

    recording: Path
    cache: Path
    config: Config
    tracker: str = "joint"

    @property
    def folder(self) -> Path:
        """Folder of the run: a hash of the recording, the configuration and the engine's code is in its name."""
        path = self.recording.resolve()
        changed_ns = max((file.stat().st_mtime_ns for file in path.iterdir()), default=0)
        text = f"{path} {changed_ns} {self.config.model_dump_json()} {self.tracker} {code_key()}"
        return self.cache / "runs" / f"{path.name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


@cache
def code_key() -> str:
    """Key of the source of all that decides tracks: another version of it does not find older runs."""
    return key_of(code_version(), Path(peaks.__file__).read_text("utf-8"))


def run_pass(job: Pass) -> Path:
    """The folder of a run (tracks.csv, run.json, decisions.csv), from the cache when it is there."""
    if finished_run(job.folder) is not None:
        return job.folder
    shutil.rmtree(job.folder, ignore_errors=True)
    with whole_folder(job.folder) as part:
        engine = bench_engine(job.recording, job.tracker, job.config)
        run(engine, RunSpec(part))
    return job.folder


def watched(work: Callable[[Job], Result], jobs: Sequence[Job], at_once: int) -> Iterator[tuple[Job, Result]]:
    """Every job with its result in the order in which they are done, in ``at_once`` processes of one thread each.
    Raises WorkError: a job fails in its process."""
    for count, (job, result) in enumerate(_results(work, jobs, at_once), 1):
        progress(f"{count} of {len(jobs)} recordings rendered and tracked")
        yield job, result


def _results(work: Callable[[Job], Result], jobs: Sequence[Job], at_once: int) -> Iterator[tuple[Job, Result]]:
    if at_once == 1:
        for job in jobs:
            yield job, work(job)
        return
    with workers(at_once) as client:
        for done in on_workers(client, partial(_work_alone, work), dict(enumerate(jobs))):
            if done.error:
                raise WorkError(f"{jobs[done.key]}: {done.error}")
            yield jobs[done.key], done.value


def _work_alone(work: Callable[[Job], Result], job: Job) -> Result:
    cv2.setNumThreads(1)
    return work(job)


def provenance() -> dict[str, str]:
    """Commit of the sources ("unknown" outside of a git repository), marked where they differ from it, and date."""
    command = ["git", "-C", str(Path(planview.__path__[0])), "describe", "--always", "--dirty"]
    described = subprocess.run(command, capture_output=True, text=True, check=False)
    return {"commit": described.stdout.strip() or "unknown", "date": datetime.now(UTC).date().isoformat()}


@dataclass(frozen=True)
class SceneScore:
    """The scores of one way of tracking one recording.

    Attributes:
        frames, duration_s: length of the recording.
        folder: where tracks.csv and run.json are, when they were kept.
    """

    name: str
    seed: int
    evaluation: Evaluation
    recording: Path
    frames: int
    duration_s: float
    folder: Path | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "scene": self.name,
            "seed": self.seed,
            "out": str(self.folder) if self.folder else None,
            **self.evaluation.to_json(),
            "recording": str(self.recording),
            "frames": self.frames,
            "duration_s": self.duration_s,
        }


def together(scores: Sequence[SceneScore]) -> Evaluation:
    """All recordings as one, as long as they are together."""
    duration_s = sum(score.duration_s for score in scores)
    return replace(pool([score.evaluation for score in scores]), duration_s=duration_s)


def scores_json(scores: Sequence[SceneScore]) -> dict[str, Any]:
    """Every recording, and all together."""
    totals = together(scores).to_json() if scores else {}
    return {"scenes": [score.to_json() for score in scores], "totals": totals}


def score_table(what: str, scores: Sequence[SceneScore]) -> list[Row]:
    """A row per recording and one of all together."""
    rows = [_score_row({what: score.name, "seed": score.seed}, score.evaluation) for score in scores]
    if scores:
        rows.append(_score_row({what: "all", "seed": ""}, together(scores)))
    return rows


def _score_row(names: Row, evaluation: Evaluation) -> Row:
    figures = evaluation.to_json()
    counts = figures["significant_errors"]
    kinds = [f"{kind} {counts[kind]}" for kind in KINDS if counts[kind]]
    row = {**names, "rows": evaluation.sequence.truth_rows, "significant": ", ".join(kinds) or "none"}
    counts_and_shares = "people", "tracked_people", "false_positives", "misses", "events", "mota", "idf1", "switches"
    row |= {key: figures[key] for key in counts_and_shares}
    row["pos cm"] = _centimetres(figures["position_error_mean_m"])
    row["height cm"] = _centimetres(figures["height_error_mean_m"])
    row["facing deg"] = evaluation.facing.walkers_deg
    return row


def _centimetres(value_m: float | None) -> float | None:
    return None if value_m is None else round(100 * value_m, 1)


def error_notes(what: str, scores: Sequence[SceneScore]) -> list[str]:
    """Rates of errors with their bounds, then every error."""
    if not scores:
        return []
    every = together(scores)
    swaps = sum(error.kind == "swapped" for error in every.significant)
    counts = {
        "significant errors": len(every.significant),
        "events": every.events,
        "with every change of identity": len(every.significant) - swaps + every.clear.switches,
    }
    per = 600.0 / every.duration_s
    rates = [f"{per * n:.1f} (at most {per * poisson_upper(n):.1f}) {name}" for name, n in counts.items()]
    minutes = every.duration_s / 60
    notes = [
        f"facing deg: {FACING}",
        f"in 10 minutes, of {minutes:.1f}, with the 95 % bound of so few: {', '.join(rates)}",
    ]
    for score in scores:
        for error in score.evaluation.significant:
            who = f"person {error.truth_id}, track {error.track_id}"
            notes.append(f"{what}: {score.name} ({score.seed}) frame {error.frame}: {error.kind}, {who}: {error.note}")
    return notes
