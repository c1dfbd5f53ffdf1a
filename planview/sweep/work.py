"""Whole studies: runs on processes of this machine or workers of a Dask cluster, each done once, ranked at the end."""

from __future__ import annotations

import json
import shutil
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product, starmap
from pathlib import Path
from typing import Any, NamedTuple

import cv2
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress

from calib.errors import InputError, WorkError
from calib.io import ATTEMPT, whole_folder
from calib.world import load_rigs
from planview.engine.config import Config, load_config
from planview.engine.open import FIXED_MAP_PARAMETERS, FIXED_TABLES, TrackerName, base_config, open_engine
from planview.evaluation.evaluate import evaluate_tracks
from planview.maps.recording import is_maps
from planview.output.folder import finished_run, folder_lock, read_run_info, write_result
from planview.output.report.page import write_report
from planview.output.resume import code_version, content_key, key_of
from planview.output.run import RunOptions, run
from planview.output.run_folder import read_object
from planview.output.tables import MapsLog
from planview.sweep.results import JobResult, Ranked, ranked, study_page, summary_csv
from planview.sweep.study import Configuration, RecordingEntry, Study, grid, random_draws, run_figures
from planview.trajectories.formats import load_tracks, load_truth, truth_file
from stereo.readers import OpenOptions, holds_pair
from stereo.readers.open import is_multi_rig, rigs_file

MAPS_FILE = "maps.h5"
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


@dataclass(frozen=True)
class RunJob:
    """One run into a folder of its own, which is there when the run is finished; ``key``: what the result depends on;
    ``version``: the ``code_version`` that must run it."""

    source: RecordingEntry
    config: Config
    tracker: TrackerName
    frames: int
    key: str
    folder: Path
    version: str
    save_maps: bool
    report: bool

    @property
    def is_done(self) -> bool:
        """Whether the folder is there with all that the study keeps."""
        return finished_run(self.folder) is not None and (not self.save_maps or (self.folder / MAPS_FILE).is_file())


class _Recording(NamedTuple):
    """What all jobs of a recording share: ``key`` of its content, the configuration that it begins with, its truth."""

    entry: RecordingEntry
    key: str
    base: Config
    truth: Path | None
    truth_key: str


@dataclass(frozen=True)
class StudyJob:
    """A run of a study, ``blank`` without its figures; its source is a plan-view recording where ``maps`` makes one
    first."""

    blank: JobResult
    recording: _Recording
    run: RunJob
    maps: RunJob | None

    @property
    def scores_file(self) -> Path:
        """Recordings of equal content share their run, but each has its own truth."""
        return self.run.folder / f"scores_{self.recording.truth_key[:16] or 'none'}.json"

    def result(self, figures: dict[str, float], error: str = "", *, reused: bool = False) -> JobResult:
        """What came of it."""
        folder = None if error else self.run.folder
        return replace(self.blank, folder=folder, figures=figures, error=error, reused=reused)


def planned(
    study: Study, out: Path, names: Sequence[str], configurations: Sequence[Configuration]
) -> list[StudyJob | JobResult]:
    """The runs of a study (arguments of ``run_study``), or why they cannot begin, configuration by configuration,
    recording by recording, seed by seed. Raises InputError: a setting that is no parameter or out of its range."""
    recordings = list(zip(names, map(_looked_at, study.recordings), strict=True))
    version = code_version()
    for configuration in configurations:
        load_config(study.config, configuration.settings)

    @cache  # recordings that begin with the same parameters share their configurations: there may be RUNS_MAX runs
    def effective(configuration: Configuration, seed: int, base: Config) -> tuple[tuple[Config, str], ...]:
        """The configuration of a run, and that which records its maps: all that decides points, of the rest the
        defaults; each with its key."""
        full, defaults = load_config(study.config, [*configuration.settings, f"seed={seed}"], base), Config()
        fixed = {name: getattr(full.maps, name) for name in FIXED_MAP_PARAMETERS}
        tables = {name: getattr(full, name) for name in FIXED_TABLES} | {"maps": defaults.maps.model_copy(update=fixed)}
        return tuple((c, key_of(c.model_dump(mode="json"))) for c in (full, defaults.model_copy(update=tables)))

    def run_job(source: RecordingEntry, source_key: str, keyed: tuple[Config, str], kind: str) -> RunJob:
        key = key_of(source_key, keyed[1], study.tracker, study.frames, version, kind)
        report = study.reports and kind == "jobs"
        return RunJob(
            source, keyed[0], study.tracker, study.frames, key, out / kind / key, version, kind == "maps", report
        )

    def job(configuration: Configuration, named: tuple[str, _Recording | str], seed: int) -> StudyJob | JobResult:
        name, recording = named
        if isinstance(recording, str):
            return JobResult(name, configuration, seed, error=recording)
        (entry, key, base, *_), maps = recording, None
        full, points = effective(configuration, seed, base)
        single = is_maps(entry.path) or is_multi_rig(entry.path) or study.tracker == "human-model"
        if study.maps and not single and (study.tracker == "joint" or entry.calibration or holds_pair(entry.path)):
            maps = run_job(entry, key, points, "maps")
            entry, key = RecordingEntry(path=maps.folder / MAPS_FILE), maps.key
        blank = JobResult(name, configuration, seed, from_maps=maps is not None)
        return StudyJob(blank, recording, run_job(entry, key, full, "jobs"), maps)

    return list(starmap(job, product(configurations, recordings, study.seeds)))


def _looked_at(entry: RecordingEntry) -> _Recording | str:
    """A recording, or why it cannot be used."""
    path = entry.path
    try:
        # Several heads may lie anywhere, a calibration next to a video.
        if is_maps(path):
            key = content_key(path)
        elif is_multi_rig(path):
            file = rigs_file(path)
            key = key_of(content_key(file), *(content_key(file.parent / rig.folder) for rig in load_rigs(file)))
        else:
            key = key_of(content_key(path), *map(content_key, companion_files(path)))
        key = key_of(key, entry.fps, *(content_key(file) if file else "" for file in (entry.calibration, entry.camera)))
        truth = entry.truth or truth_file(path.parent if is_maps(path) else path)
        return _Recording(entry, key, base_config(path), truth, content_key(truth) if truth else "")
    except InputError as error:
        return str(error)


def companion_files(path: Path) -> list[Path]:
    """Files that may belong to a recording of a single file: calibrations, times and poses in its folder."""
    endings = (".yml", ".yaml", ".json", ".xml", ".conf")
    names = ("rig.toml", "world.toml", "camera.toml", "timestamps.csv")
    files = sorted(path.parent.iterdir()) if path.parent.is_dir() and not path.is_dir() else []
    known = [file for file in files if file.suffix.lower() in endings or file.name in names]
    return [file for file in known if file.name != path.name and file.is_file()]


def track(job: RunJob) -> None:
    """Run into ``job.folder`` unless it is there (see ``whole_folder``)."""
    if job.version != code_version():
        raise WorkError(f"expected planview {job.version} on this worker, found {code_version()}")
    if job.is_done:
        return
    cv2.setNumThreads(1)  # a study runs a job per core
    with whole_folder(job.folder) as folder:
        source, options = job.source, OpenOptions(job.source.calibration, job.source.fps)
        engine = open_engine(source.path, job.tracker, job.config, source.camera, options)
        engine.ahead = 0
        logs = [MapsLog(engine, folder / MAPS_FILE)] if job.save_maps else []
        run(engine, folder, RunOptions(tracker=job.tracker, max_frames=job.frames), logs)
        if job.report:
            write_report(folder)
        if not job.is_done:  # what lacks something makes room only now
            shutil.rmtree(job.folder, ignore_errors=True)


def track_and_score(job: StudyJob) -> dict[str, float]:
    """Run unless that is done, and score; the figures are written into its folder."""
    track(job.run)
    scores: dict[str, Any] = {}
    if job.recording.truth is not None:
        span = (0, job.run.frames - 1) if job.run.frames else None
        tracks, truth = load_tracks(job.run.folder / "tracks.csv"), load_truth(job.recording.truth)
        scores = evaluate_tracks(tracks, truth, None, span).to_json()
    figures = run_figures(read_run_info(job.run.folder / "run.json"), scores)
    write_result(job.scores_file, json.dumps(figures, indent=2) + "\n")
    return figures


def _earlier_figures(job: StudyJob) -> dict[str, float] | None:
    """Figures of an earlier study with the same input, configuration, version and truth; None where there are none."""
    try:
        return {name: float(value) for name, value in read_object(job.scores_file).items()} or None
    except (InputError, ValueError, TypeError):
        return None


def run_study(
    study: Study, names: Sequence[str], out: Path, run_tasks: Tasks, console: Console
) -> tuple[list[JobResult], list[Ranked]]:
    """Run all that is not done and write study.json, summary.csv and report.html; all runs in the order of the study,
    and its configurations, best first.

    ``study`` has absolute paths, and its recordings ``names`` that differ. What earlier studies in ``out`` did with the
    same input, configuration and version is kept. Raises InputError: a setting that is no parameter, a cluster that
    cannot be reached, or another study in the folder. WorkError: the folder cannot be written.
    """
    study.refuse_many()
    if study.method == "grid":
        configurations = grid(study.parameters)
    else:
        configurations = random_draws(study.parameters, study.samples, study.search_seed)
    jobs = planned(study, out, names, configurations)

    def remove_attempts() -> None:
        """What killed processes left: nobody else writes into this folder."""
        for folder in out.glob(f"*/{ATTEMPT}*"):
            shutil.rmtree(folder, ignore_errors=True)

    with folder_lock(out):
        remove_attempts()
        write_result(out / "study.json", study.model_dump_json(indent=2) + "\n")
        runs = _run(jobs, run_tasks, console)
        remove_attempts()
        ranking = ranked(runs, study.objective)
        # The page is written again where a run was made or failed.
        summary, page, text = out / "summary.csv", out / "report.html", summary_csv(runs)
        written = page.is_file() and summary.is_file() and summary.read_text(encoding="utf-8") == text
        if not written or not all(run.reused for run in runs):
            write_result(summary, text)
            write_result(page, study_page(study, runs, ranking, out.name))
    return runs, ranking


def _run(study_jobs: Sequence[StudyJob | JobResult], run_tasks: Tasks, console: Console) -> list[JobResult]:
    """Results in the order of the jobs; alike ones run once."""
    results: dict[int, JobResult] = {}
    waiting: dict[str, dict[int, StudyJob]] = {}
    for i, job in enumerate(study_jobs):
        if isinstance(job, JobResult):
            results[i] = job
        elif (figures := _earlier_figures(job)) is not None:
            results[i] = job.result(figures, reused=True)
        else:
            waiting.setdefault(str(job.scores_file), {})[i] = job
    jobs = {key: next(iter(alike.values())) for key, alike in waiting.items()}
    maps = {job.maps.key: job.maps for job in jobs.values() if job.maps and not job.maps.is_done}
    errors: dict[str, str] = {}
    with Progress(*Progress.get_default_columns(), MofNCompleteColumn(), console=console) as watch:
        if maps:
            recorded = watch.track(run_tasks(track, maps), len(maps), description="plan-view recordings")
            errors = {done.key: done.error for done in recorded}
        stopped = {key: errors.get(job.maps.key, "") if job.maps else "" for key, job in jobs.items()}
        ready = {key: job for key, job in jobs.items() if not stopped[key]}
        ended = watch.track(run_tasks(track_and_score, ready), len(ready), description="runs")
        for done in [*(Done(key, error=error) for key, error in stopped.items() if error), *ended]:
            results |= {i: job.result(done.value or {}, done.error) for i, job in waiting[done.key].items()}
    return [results[i] for i in range(len(study_jobs))]
