"""Runs of an engine over rendered recordings, kept in their cache: what did not change is not run again."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import cv2
from joblib import Parallel, delayed, parallel_config

import planview
from benchmarks import peaks
from benchmarks.options import new_folder, progress
from benchmarks.peaks import PeakTracker
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.open import open_engine
from planview.output.folder import finished_run
from planview.output.maps_log import MapsLog
from planview.output.resume import code_version, key_of
from planview.output.run import RunLog, RunOptions, run

Job = TypeVar("Job")
Result = TypeVar("Result")


def bench_engine(recording: Path, tracker: str, config: Config | None) -> Engine:
    """An engine of a recording with a tracker of planview, or the baseline "peaks" (errors as of ``open_engine``)."""
    return open_engine(recording, cast(Any, PeakTracker() if tracker == "peaks" else tracker), config)


@dataclass(frozen=True)
class Pass:
    """One run of one engine over the folder of a recording, kept in ``runs`` below the cache; ``recorded``: with its
    plan-view points."""

    recording: Path
    cache: Path
    config: Config
    tracker: str = "joint"
    recorded: bool = False

    @property
    def folder(self) -> Path:
        """Where the run is kept: a hash of the recording, the configuration and the engine's code is in its name."""
        at = self.recording.resolve()
        made = max((path.stat().st_mtime_ns for path in at.iterdir()), default=0)
        text = f"{at} {made} {self.config.model_dump_json()} {self.tracker} {self.recorded} {code_key()}"
        return self.cache / "runs" / f"{at.name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


@cache
def code_key() -> str:
    """Of the source of everything that decides tracks: another version of it does not find older runs."""
    return key_of(code_version(), Path(peaks.__file__).read_text("utf-8"))


def run_pass(job: Pass) -> Path:
    """The folder of a run (tracks.csv, run.json, decisions.csv, with ``recorded`` maps.h5), from the cache when it is
    there."""
    if finished_run(job.folder) is not None:
        return job.folder
    shutil.rmtree(job.folder, ignore_errors=True)
    part = new_folder(job.folder.parent, job.folder.name)
    try:
        engine = bench_engine(job.recording, job.tracker, job.config)
        logs: list[RunLog] = [MapsLog(engine, part / "maps.h5")] if job.recorded else []
        run(engine, part, RunOptions(tracker=job.tracker), logs)
        part.rename(job.folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return job.folder


def watched(work: Callable[[Job], Result], jobs: Sequence[Job], at_once: int) -> Iterator[tuple[Job, Result]]:
    """Every job with its result in the order in which they are done, in ``at_once`` processes of one thread each."""
    with parallel_config("loky", inner_max_num_threads=1):
        # Processes are spawned, not forked: open3d and numba hold threads.
        alone = Parallel(n_jobs=at_once, return_as="generator_unordered")
        done = alone(delayed(_alone)(work, job) for job in jobs) if at_once > 1 else ((j, work(j)) for j in jobs)
        for n, (job, result) in enumerate(done, 1):
            progress(f"{n} of {len(jobs)} recordings rendered and tracked")
            yield job, result


def _alone(work: Callable[[Job], Result], job: Job) -> tuple[Job, Result]:
    cv2.setNumThreads(1)
    return job, work(job)


def provenance() -> dict[str, str]:
    """Commit of the sources ("unknown" outside of a git repository), marked where they differ from it, and date."""
    command = ["git", "-C", str(Path(planview.__path__[0])), "describe", "--always", "--dirty"]
    commit = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or "unknown"
    return {"commit": commit, "date": datetime.now(UTC).date().isoformat()}
