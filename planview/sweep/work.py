"""Whole studies: their jobs on processes of this machine or workers of a Dask cluster, ranked at the end."""

from __future__ import annotations

import json
import shutil
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress

from calib.errors import InputError, WorkError
from calib.io import ATTEMPT, whole_folder
from planview.engine.open import open_engine
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.folder import finished_run, folder_lock, read_run_info, write_result
from planview.output.resume import code_version
from planview.output.run import RunLog, RunOptions, run
from planview.sweep.jobs import MAPS_FILE, Planned, RunJob, StudyJob, planned
from planview.sweep.page import study_page
from planview.sweep.results import JobResult, Ranked, ranked, summary_csv
from planview.sweep.study import Study, grid, random_draws, run_figures
from planview.trajectories.formats import load_tracks, load_truth
from stereo.readers import OpenOptions

CONNECT_S = 10.0
WORKERS_S = 60.0
"""A cluster may begin without workers for so long [s]; later the study waits for new ones."""


class Done(NamedTuple):
    """How a task ended: with a value, or with an error in one sentence."""

    key: str
    value: Any = None
    error: str = ""


Tasks = Callable[[Callable[..., Any], Mapping[str, object]], Iterator[Done]]
"""Calls a function elsewhere with each of the arguments, by key; each comes once, in the order in which they end."""


def guarded(function: Callable[..., Any], key: str, argument: object) -> Done:
    """Call a function; runs in the other process."""
    try:
        return Done(key, function(argument))
    except (InputError, WorkError) as error:
        return Done(key, error=str(error))
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(str(error).split())[:300]
        return Done(key, error=f"unexpected {type(error).__name__} in {where.name}, line {where.lineno}: {text}")


def on_processes(jobs: int, function: Callable[..., Any], arguments: Mapping[str, object]) -> Iterator[Done]:
    """``Tasks`` in processes of this machine, ``jobs`` at a time, each on one core.

    A process that is killed ends joblib's round and the tasks in its hands: these are divided until the one that
    kills its process is alone, and fails.
    """
    from joblib import Parallel, delayed, parallel_config

    rounds = [dict(arguments)]
    while rounds:
        left = rounds.pop()
        calls = [delayed(guarded)(function, key, argument) for key, argument in left.items()]
        try:
            # Two at least, since joblib runs a single job in this process; one of them then has nothing to do.
            with parallel_config("loky", n_jobs=max(2, jobs), inner_max_num_threads=1):
                for done in Parallel(return_as="generator_unordered", pre_dispatch=jobs, batch_size=1)(calls):
                    del left[done.key]
                    yield done
        except BrokenProcessPool:
            tasks = list(left.items())
            if len(tasks) == 1:
                yield Done(tasks[0][0], error="its process was killed")
                continue
            begun = min(jobs, len(tasks) // 2)
            rounds += [dict(tasks[begun:]), dict(tasks[:begun])]


def on_cluster(address: str, function: Callable[..., Any], arguments: Mapping[str, object]) -> Iterator[Done]:
    """``Tasks`` on the workers of a Dask cluster that share the file system with this machine.

    Dask gives the task of a worker that died to another one, up to three times (``allowed-failures``), and waits for
    new workers when all are gone. Raises InputError: ``distributed`` is not installed, no scheduler at the address, or
    no worker arrives.
    """
    if not arguments:
        return
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise InputError("expected the package distributed; install planview[cluster]") from error
    try:
        client = Client(address, timeout=CONNECT_S)
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError as error:
        raise InputError(f"expected a worker at {address}, found none in {WORKERS_S:.0f} s") from error
    except (OSError, ValueError) as error:
        raise InputError(f"expected a Dask scheduler at {address}, found none ({error})") from error
    with client:
        tasks = client.map(partial(guarded, function), list(arguments), list(arguments.values()), pure=False)
        keys = dict(zip(tasks, arguments, strict=True))
        for task in as_completed(tasks):
            lost = "its workers died" if task.status == "error" else "the scheduler of the cluster was lost"
            yield task.result() if task.status == "finished" else Done(keys[task], error=lost)


def track(job: RunJob) -> None:
    """Run into ``job.folder`` unless it is there (see ``whole_folder``)."""
    if job.version != code_version():
        raise WorkError(f"expected planview {job.version} on this worker, found {code_version()}")
    if is_done(job):
        return
    cv2.setNumThreads(1)  # a study runs a job per core
    with whole_folder(job.folder) as folder:
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
        if not is_done(job):  # what lacks something makes room only now
            shutil.rmtree(job.folder, ignore_errors=True)


def is_done(job: RunJob) -> bool:
    """Whether the folder of a run is there with all that is asked for."""
    return finished_run(job.folder) is not None and (not job.save_maps or (job.folder / MAPS_FILE).is_file())


def track_and_score(job: StudyJob) -> dict[str, float]:
    """Run unless that is done, and score; the figures are written into its folder."""
    track(job.run)
    scores: dict[str, Any] = {}
    if job.truth is not None:
        span = (0, job.run.frames - 1) if job.run.frames else None
        tracks, truth = load_tracks(job.run.folder / "tracks.csv"), load_truth(job.truth)
        scores = evaluate_tracks(tracks, truth, None, span).to_json()
    figures = run_figures(read_run_info(job.run.folder / "run.json"), scores)
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


STUDY_FILE, SUMMARY_FILE, PAGE_FILE = "study.json", "summary.csv", "report.html"


def run_study(
    study: Study, names: Sequence[str], out: Path, run_tasks: Tasks, console: Console
) -> tuple[list[JobResult], list[Ranked]]:
    """Run all that is not done and write study.json, summary.csv and report.html; all runs in the order of the study,
    and its configurations, best first.

    Args:
        study: with absolute paths.
        names: of the recordings, all different.
        out: folder for results; of earlier studies in it, what has the same input, configuration and version is kept.
        run_tasks: where jobs run.
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
        runs = _run(jobs, run_tasks, console)
        remove_attempts(out)
        ranking = ranked(runs, study.objective)
        # The page is written again where a run was made or failed.
        summary, page, text = out / SUMMARY_FILE, out / PAGE_FILE, summary_csv(runs)
        written = page.is_file() and summary.is_file() and summary.read_text(encoding="utf-8") == text
        if not written or not all(run.reused for run in runs):
            write_result(summary, text)
            write_result(page, study_page(study, runs, ranking, out.name))
    return runs, ranking


def _run(study_jobs: Sequence[Planned], run_tasks: Tasks, console: Console) -> list[JobResult]:
    """Results in the order of the jobs."""
    results: dict[int, JobResult] = {}
    waiting: dict[str, dict[int, StudyJob]] = {}
    for i, job in enumerate(study_jobs):
        if isinstance(job, JobResult):
            results[i] = job
        elif (figures := earlier_figures(job)) is not None:
            results[i] = _result(job, figures, "", reused=True)
        else:
            waiting.setdefault(job.key, {})[i] = job
    jobs = {key: next(iter(alike.values())) for key, alike in waiting.items()}
    maps = {job.maps.key: job.maps for job in jobs.values() if job.maps and not is_done(job.maps)}
    errors: dict[str, str] = {}
    with Progress(*Progress.get_default_columns(), MofNCompleteColumn(), console=console) as watch:
        if maps:
            recorded = watch.track(run_tasks(track, maps), len(maps), description="plan-view recordings")
            errors = {done.key: done.error for done in recorded}
        ready = {key: job for key, job in jobs.items() if not (job.maps and errors.get(job.maps.key))}
        for key in jobs.keys() - ready.keys():
            results |= {i: _result(job, {}, errors[job.maps.key]) for i, job in waiting[key].items() if job.maps}
        for done in watch.track(run_tasks(track_and_score, ready), len(ready), description="runs"):
            results |= {i: _result(job, done.value or {}, done.error) for i, job in waiting[done.key].items()}
    return [results[i] for i in range(len(study_jobs))]


def _result(job: StudyJob, figures: dict[str, float], error: str, *, reused: bool = False) -> JobResult:
    folder = None if error else job.run.folder
    return JobResult(job.name, job.configuration, job.seed, folder, figures, error, reused, job.maps is not None)
