"""Whole studies: their jobs on processes of this machine or workers of a Dask cluster, ranked at the end."""

from __future__ import annotations

import json
import os
import shutil
import time
import traceback
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from threading import get_ident
from typing import Any, NamedTuple

import cv2
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from calib.errors import InputError, WorkError
from calib.io import reason
from planview.engine.open import open_engine
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.folder import finished_run, folder_lock, read_run_info, write_result
from planview.output.resume import code_version
from planview.output.run import RunLog, RunOptions, run
from planview.sweep.jobs import MAPS_FILE, Planned, RunJob, StudyJob, planned
from planview.sweep.results import JobResult, Ranked, ranked, study_page, summary_csv
from planview.sweep.study import Study, grid, random_draws, run_figures
from planview.trajectories.formats import load_tracks, load_truth
from stereo.readers import OpenOptions

CONNECT_S = 10.0
CHECK_S = 5.0
"""A job that takes longer is waited for again, if the cluster is still there [s]."""
JOBS_PER_THREAD = 3
"""Jobs per thread of a cluster that are handed over at a time, so that the scheduler stays small."""
WORKERS_S = 60.0
"""A cluster may be without workers for so long [s]."""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


class Pool(NamedTuple):
    """Calls functions elsewhere, up to ``at_once`` at a time, each from a thread that waits for it; ``call`` raises
    WorkError when a call will not end."""

    at_once: int
    call: Callable[[Callable[..., Any], object], Any]


@contextmanager
def processes(count: int) -> Iterator[Pool]:
    """Processes of this machine, each with one job and one core: a job that kills its process fails alone.

    They are joblib's (loky): fresh ones, since forked ones would share OpenCV's threads.
    """
    from joblib.externals.loky import ProcessPoolExecutor

    process_of: dict[int, Any] = {}  # by the thread that waits for it

    def call(function: Callable[..., Any], argument: object) -> Any:
        me = get_ident()
        if me not in process_of:
            process_of[me] = ProcessPoolExecutor(1, env=ONE_THREAD)
        try:
            return process_of[me].submit(function, argument).result()
        except BrokenProcessPool:
            del process_of[me]
            raise WorkError("its process was killed") from None

    try:
        yield Pool(count, call)
    finally:
        for process in list(process_of.values()):
            process.shutdown(wait=True, kill_workers=True)


@contextmanager
def cluster(address: str) -> Iterator[Pool]:
    """Workers of a Dask cluster that share the file system with this machine.

    Dask gives the job of a worker that died to another one, up to three times (``allowed-failures``). Raises
    InputError: ``distributed`` is not installed, no scheduler at the address, or no worker arrives. Calls raise
    WorkError: the scheduler is lost, or there was no worker for WORKERS_S.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("expected the package distributed; install planview[cluster]") from error
    try:
        client = Client(address, timeout=CONNECT_S)
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError as error:
        raise InputError(f"expected a worker at {address}, found none in {WORKERS_S:.0f} s") from error
    except (OSError, ValueError) as error:
        raise InputError(f"expected a Dask scheduler at {address}, found none ({error})") from error
    with_workers_s = time.monotonic()

    def call(function: Callable[..., Any], argument: object) -> Any:
        nonlocal with_workers_s
        future = client.submit(function, argument, pure=False)
        while True:
            try:
                return future.result(timeout=CHECK_S)
            except TimeoutError:
                now = time.monotonic()
            if client.status in ("closed", "closing"):
                raise WorkError("the scheduler of the cluster was lost")
            if client.ncores():
                with_workers_s = now
            elif now - with_workers_s > WORKERS_S:
                raise WorkError(f"all workers of the cluster were lost {now - with_workers_s:.0f} s ago")

    with closing(client):
        yield Pool(JOBS_PER_THREAD * sum(client.ncores().values()), call)


class Done(NamedTuple):
    """How a task ended: with a value, or with an error in one sentence."""

    key: str
    value: Any = None
    error: str = ""


def guarded(function: Callable[..., Any], argument: object) -> tuple[Any, str]:
    """The value of a call and an empty text, or None and what went wrong; runs in the other process."""
    try:
        return function(argument), ""
    except (InputError, WorkError) as error:
        return None, str(error)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(str(error).split())[:300]
        return None, f"unexpected {type(error).__name__} in {where.name}, line {where.lineno}: {text}"


def run_tasks(function: Callable[..., Any], arguments: Mapping[str, object], pool: Pool) -> Iterator[Done]:
    """Call a function with each of the arguments, by key; each comes once, in the order in which they end."""

    def end(key: str, argument: object) -> Done:
        try:
            return Done(key, *pool.call(partial(guarded, function), argument))
        except WorkError as error:
            return Done(key, error=str(error))
        except (Exception, CancelledError) as failure:
            return Done(key, error=f"the worker was lost ({type(failure).__name__})")

    threads = ThreadPoolExecutor(pool.at_once)
    try:
        for future in as_completed([threads.submit(end, *task) for task in arguments.items()]):
            yield future.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)


ATTEMPT = ".attempt-"


def track(job: RunJob) -> None:
    """Run into ``job.folder`` unless it is there.

    Results appear there in one step when they are whole: a run that is killed leaves only an attempt, and of two at the
    same time the first that finishes stays.
    """
    if job.version != code_version():
        raise WorkError(f"expected planview {job.version} on this worker, found {code_version()}")
    if is_done(job):
        return
    cv2.setNumThreads(1)  # a study runs a job per core
    with _attempt(job.folder) as folder:
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
    """Run unless that is done, and score; the figures are written into its folder."""
    track(job.run)
    evaluation = None
    if job.truth is not None:
        span = (0, job.run.frames - 1) if job.run.frames else None
        evaluation = evaluate_tracks(load_tracks(job.run.folder / "tracks.csv"), load_truth(job.truth), None, span)
    figures = run_figures(read_run_info(job.run.folder / "run.json"), evaluation)
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


STUDY_FILE, SUMMARY_FILE, PAGE_FILE = "study.json", "summary.csv", "report.html"


def run_study(
    study: Study, names: Sequence[str], out: Path, pool: AbstractContextManager[Pool], console: Console
) -> tuple[list[JobResult], list[Ranked]]:
    """Run all that is not done and write study.json, summary.csv and report.html; all runs in the order of the study,
    and its configurations, best first.

    Args:
        study: with absolute paths.
        names: of the recordings, all different.
        out: folder for results; of earlier studies in it, what has the same input, configuration and version is kept.
        pool: entered when there is something to run.
    Raises:
        InputError: a setting that is no parameter, a cluster that cannot be reached, or another study in the folder.
        WorkError: the folder cannot be written.
    """
    study.refuse_many()
    configurations = (
        grid(study.parameters)
        if study.method == "grid"
        else random_draws(study.parameters, study.samples, study.search_seed)
    )
    jobs = planned(study, out, names, configurations)
    with folder_lock(out):
        remove_attempts(out)
        write_result(out / STUDY_FILE, study.model_dump_json(indent=2) + "\n")
        runs = _run(jobs, pool, console)
        remove_attempts(out)
        ranking = ranked(runs, study.objective)
        # The page is written again where a run was made or failed.
        summary, page, text = out / SUMMARY_FILE, out / PAGE_FILE, summary_csv(runs)
        written = page.is_file() and summary.is_file() and summary.read_text(encoding="utf-8") == text
        if not written or not all(run.reused for run in runs):
            write_result(summary, text)
            write_result(page, study_page(study, runs, ranking, out.name))
    return runs, ranking


def _run(study_jobs: Sequence[Planned], pool: AbstractContextManager[Pool], console: Console) -> list[JobResult]:
    """Results in the order of the jobs."""
    known: dict[int, JobResult] = {}
    waiting: dict[str, dict[int, StudyJob]] = {}
    for i, job in enumerate(study_jobs):
        if isinstance(job, JobResult):
            known[i] = job
        elif (figures := earlier_figures(job)) is not None:
            known[i] = _result(job, figures, "", reused=True)
        else:
            waiting.setdefault(job.key, {})[i] = job
    jobs = {key: next(iter(alike.values())) for key, alike in waiting.items()}
    maps = {job.maps.key: job.maps for job in jobs.values() if job.maps and not is_done(job.maps)}
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[state]}"),
    )  # fmt: skip
    results, counts = dict[int, JobResult](), {"done before": 0, "failed": 0}
    with Progress(*columns, console=console) as watch:
        bar = watch.add_task("runs", total=len(study_jobs), state="")
        recording = watch.add_task("plan-view recordings", total=len(maps), state="", visible=bool(maps))

        def take(ended: Mapping[int, JobResult]) -> None:
            results.update(ended)
            for result in ended.values():
                counts["done before"] += result.reused
                counts["failed"] += bool(result.error)
            parts = (f"{number} {how}" for how, number in counts.items() if number)
            watch.update(bar, completed=len(results), state=", ".join(parts))

        take(known)
        if not jobs:
            return [results[i] for i in range(len(study_jobs))]
        with pool as opened:
            errors: dict[str, str] = {}
            for done in run_tasks(track, maps, opened):
                watch.advance(recording)
                errors[done.key] = done.error
            ready = {key: job for key, job in jobs.items() if not (job.maps and errors.get(job.maps.key))}
            for key in jobs.keys() - ready.keys():
                take({i: _result(job, {}, errors[job.maps.key]) for i, job in waiting[key].items() if job.maps})
            for done in run_tasks(track_and_score, ready, opened):
                take({i: _result(job, done.value or {}, done.error) for i, job in waiting[done.key].items()})
    return [results[i] for i in range(len(study_jobs))]


def _result(job: StudyJob, figures: dict[str, float], error: str, *, reused: bool = False) -> JobResult:
    folder = None if error else job.run.folder
    return JobResult(job.name, job.configuration, job.seed, folder, figures, error, reused, job.maps is not None)
