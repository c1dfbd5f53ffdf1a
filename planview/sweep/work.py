"""What a process or a worker of a cluster does: one run, and its scores."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2

from calib.errors import WorkError
from calib.io import reason
from planview.engine.open import open_engine
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.folder import finished_run, write_result
from planview.output.resume import code_version
from planview.output.run import RunLog, RunOptions, run
from planview.sweep.jobs import MAPS_FILE, RunJob, StudyJob
from planview.sweep.study import run_figures
from planview.trajectories.formats import load_tracks, load_truth
from stereo.readers import OpenOptions

ATTEMPT = ".attempt-"


def track(job: RunJob) -> None:
    """Run into ``job.folder`` unless it is there.

    Results appear there in one step when they are whole: a run that is killed leaves only an attempt beside, and of
    two at the same time the first that finishes stays.

    Raises:
        InputError, WorkError: as ``open_engine`` and ``run``; another version of planview than the study's.
    """
    if job.version != code_version():
        raise WorkError(f"expected planview {job.version} on this worker, found {code_version()}")
    if is_done(job):
        return
    with _attempt(job.folder) as folder, one_thread():
        engine = open_engine(
            job.source.path, job.tracker, job.config, job.source.camera, OpenOptions(job.source.calibration)
        )
        engine.ahead = 0
        logs: list[RunLog] = []
        if job.save_maps:
            from planview.output.maps_log import MapsLog

            logs.append(MapsLog(engine, folder / MAPS_FILE))
        run(engine, folder, RunOptions(tracker=job.tracker, max_frames=job.frames), logs)
        if job.report:
            from planview.output.report.page import write_report

            write_report(folder)


def is_done(job: RunJob) -> bool:
    """Whether the folder of a run is there with all that is asked for."""
    return finished_run(job.folder) is not None and (not job.save_maps or (job.folder / MAPS_FILE).is_file())


def track_and_score(job: StudyJob) -> dict[str, float]:
    """Run unless that is done, and score; the figures are written beside the run. Raises InputError, WorkError: as
    ``track``; truth that cannot be read."""
    track(job.run)
    info = finished_run(job.run.folder)
    if info is None:
        raise WorkError(f"{job.run.folder}: expected a finished run, found none")
    evaluation = None
    if job.truth is not None:
        span = (0, job.run.frames - 1) if job.run.frames else None
        evaluation = evaluate_tracks(load_tracks(job.run.folder / "tracks.csv"), load_truth(job.truth), None, span)
    figures = run_figures(info, evaluation)
    write_result(_scores_file(job), json.dumps(figures, indent=2) + "\n")
    return figures


def earlier_figures(job: StudyJob) -> dict[str, float] | None:
    """Figures of an earlier study with the same input, configuration, version and truth; None where there are none."""
    try:
        found: Any = json.loads(_scores_file(job).read_text(encoding="utf-8"))
        return {str(name): float(value) for name, value in found.items()}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return None


def _scores_file(job: StudyJob) -> Path:
    """Recordings of equal content share their run, but each has its own truth."""
    return job.run.folder / f"scores_{job.truth_key[:16] or 'none'}.json"


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV on one thread: a study runs a job per core."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def remove_attempts(out: Path) -> None:
    """Remove what killed processes left in the folder of a study, which nobody else writes into."""
    for folder in out.glob(f"*/{ATTEMPT}*"):
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _attempt(final: Path) -> Iterator[Path]:
    """A folder that becomes ``final`` when all went well."""
    folder = final.parent / f"{ATTEMPT}{os.getpid()}-{uuid.uuid4().hex[:8]}"
    try:
        folder.mkdir(parents=True)
        yield folder
        if final.is_dir() and finished_run(final) is None:
            shutil.rmtree(final)
        with suppress(FileExistsError):
            os.rename(folder, final)
    except OSError as error:
        if finished_run(final) is None:
            raise WorkError(f"{final}: cannot be written ({reason(error)})") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)
