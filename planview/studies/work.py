"""Whole studies: each run is done once, and all are ranked at the end."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache
from itertools import product, starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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
from planview.output.folder import folder_lock, read_run_info, write_result
from planview.output.report.page import write_report
from planview.output.resume import code_version, content_key, key_of
from planview.output.run import RunOptions, run
from planview.output.run_folder import read_object
from planview.output.tables import MapsLog
from planview.studies.results import JobResult, Ranked, ranked, study_page, summary_csv
from planview.studies.study import Configuration, RecordingEntry, Study, run_figures
from planview.studies.workers import Done, on_workers
from planview.trajectories.formats import load_tracks, load_truth, truth_file
from stereo.readers import OpenOptions, holds_pair
from stereo.readers.open import is_multi_rig, rigs_file

if TYPE_CHECKING:
    from distributed import Client

MAPS_FILE = "maps.h5"


@dataclass(frozen=True)
class RunJob:
    """One run into a folder of its own, named by the key of all that the result depends on; ``version``: the
    ``code_version`` that must run it."""

    source: RecordingEntry
    config: Config
    tracker: TrackerName
    frames: int
    folder: Path
    version: str
    save_maps: bool
    report: bool

    @property
    def is_done(self) -> bool:
        return (self.folder / (MAPS_FILE if self.save_maps else "run.json")).is_file()


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
        """Alike runs have the same one; recordings of equal content share their run, but each has its own truth."""
        return self.run.folder / f"scores_{self.recording.truth_key[:16] or 'none'}.json"


def planned(
    study: Study, out: Path, names: Sequence[str], configurations: Sequence[Configuration]
) -> list[StudyJob | JobResult]:
    """The runs of a study (arguments of ``run_study``), or why they cannot begin, configuration by configuration,
    recording by recording, seed by seed. Raises InputError: a setting that is no parameter or out of its range."""
    recordings = list(zip(names, map(_looked_at, study.recordings), strict=True))
    version = code_version()

    @cache  # recordings that begin with the same parameters share their configurations: there may be RUNS_MAX runs
    def effective(configuration: Configuration, seed: int, base: Config) -> tuple[tuple[Config, str], ...]:
        """The configuration of a run, and that which records its maps: all that decides points, of the rest the
        defaults; each with its key."""
        full, defaults = load_config(study.config, [*configuration.settings, f"seed={seed}"], base), Config()
        fixed = {name: getattr(full.maps, name) for name in FIXED_MAP_PARAMETERS}
        tables = {name: getattr(full, name) for name in FIXED_TABLES} | {"maps": defaults.maps.model_copy(update=fixed)}
        return tuple((c, key_of(c.model_dump(mode="json"))) for c in (full, defaults.model_copy(update=tables)))

    def run_job(source: RecordingEntry, source_key: str, keyed: tuple[Config, str], kind: str) -> RunJob:
        config, config_key = keyed
        folder = out / kind / key_of(source_key, config_key, study.tracker, study.frames, version, kind)
        is_maps, report = kind == "maps", study.reports and kind == "jobs"
        return RunJob(source, config, study.tracker, study.frames, folder, version, is_maps, report)

    def job(configuration: Configuration, named: tuple[str, _Recording | str], seed: int) -> StudyJob | JobResult:
        name, recording = named
        if isinstance(recording, str):
            return JobResult(name, configuration, seed, error=recording)
        (entry, key, base, *_), maps = recording, None
        full, points = effective(configuration, seed, base)
        single = is_maps(entry.path) or is_multi_rig(entry.path) or study.tracker == "human-model"
        if study.maps and not single and (study.tracker == "joint" or entry.calibration or holds_pair(entry.path)):
            maps = run_job(entry, key, points, "maps")
            entry, key = RecordingEntry(path=maps.folder / MAPS_FILE), maps.folder.name
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


def run_study(
    study: Study, names: Sequence[str], out: Path, workers: AbstractContextManager[Client], console: Console
) -> tuple[list[JobResult], list[Ranked]]:
    """Run all that is not done and write study.json, summary.csv and report.html; all runs in the order of the study,
    and its configurations, best first.

    ``study`` has absolute paths, and its recordings ``names`` that differ. What earlier studies in ``out`` did with the
    same input, configuration and version is kept; ``workers`` start for what is left. Raises InputError: a setting that
    is no parameter, too many runs, no cluster, or another study in the folder. WorkError: it cannot be written.
    """
    jobs = planned(study, out, names, study.configurations())
    with folder_lock(out):
        write_result(out / "study.json", study.model_dump_json(indent=2) + "\n")
        try:
            runs = _run(jobs, workers, console)
        finally:
            for left_by_killed in out.glob(f"*/{ATTEMPT}*"):
                shutil.rmtree(left_by_killed, ignore_errors=True)
        ranking = ranked(runs, study.objective)
        write_result(out / "summary.csv", summary_csv(runs))
        write_result(out / "report.html", study_page(study, runs, ranking, out.name))
    return runs, ranking


def _run(
    jobs: Sequence[StudyJob | JobResult], workers: AbstractContextManager[Client], console: Console
) -> list[JobResult]:
    """Results in the order of the jobs."""
    jobs_by_file = {job.scores_file: job for job in jobs if isinstance(job, StudyJob)}
    earlier = {key: figures for key, job in jobs_by_file.items() if (figures := read_object(job.scores_file))}
    ended = {key: Done(key, figures) for key, figures in earlier.items()}
    if left := {key: job for key, job in jobs_by_file.items() if key not in earlier}:
        with workers as client, Progress(*Progress.get_default_columns(), MofNCompleteColumn(), console=console) as bar:
            ended |= {done.key: done for done in _tracked(left, client, bar)}

    def result(job: StudyJob | JobResult) -> JobResult:
        if isinstance(job, JobResult):
            return job
        done = ended[job.scores_file]
        folder = None if done.error else job.run.folder
        return replace(
            job.blank, folder=folder, figures=done.value or {}, error=done.error, reused=job.scores_file in earlier
        )

    return list(map(result, jobs))


def _tracked(jobs: Mapping[Path, StudyJob], client: Client, bar: Progress) -> Iterator[Done]:
    """The figures of each job. Plan-view recordings are made first; where one fails, so do its jobs."""
    maps = {job.maps.folder: job.maps for job in jobs.values() if job.maps and not job.maps.is_done}
    errors: dict[Path, str] = {}
    if maps:
        recorded = bar.track(on_workers(client, track, maps), len(maps), description="plan-view recordings")
        errors = {done.key: done.error for done in recorded if done.error}
    ready = dict(jobs)
    for key, job in jobs.items():
        if job.maps and (error := errors.get(job.maps.folder)):
            del ready[key]
            yield Done(key, error=error)
    yield from bar.track(on_workers(client, track_and_score, ready), len(ready), description="runs")
