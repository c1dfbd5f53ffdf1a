"""The runs of a study: each is done once, in a folder named by all that its tracks depend on."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from calib.errors import InputError, WorkError
from calib.io import ATTEMPT, whole_folder
from planview.engine.config import Config, load_config
from planview.engine.open import IMAGE_SOURCES, TrackerName, base_config, open_engine
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.folder import folder_lock, read_run_info, write_result
from planview.output.resume import code_version, content_key, key_of
from planview.output.run import run
from planview.output.run_folder import read_object
from planview.output.run_spec import RunSpec
from planview.progress import Progress
from planview.studies.results import JobResult, run_figures, summary_csv
from planview.studies.study import Configuration, RecordingEntry, Study
from planview.studies.workers import Done, on_workers
from planview.trajectories.formats import load_tracks, load_truth, truth_file
from stereo.readers import OpenOptions
from stereo.readers.open import find_reader, rigs_file, sensor_folders

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class StudyInput:
    """A recording of a study: its name, its files, the key of their content, the configuration that it begins with, and
    its truth."""

    name: str
    entry: RecordingEntry
    key: str
    base: Config
    truth: Path | None
    truth_key: str


@dataclass(frozen=True)
class Job:
    """A run of a study.

    Attributes:
        folder: named by the key of all that the tracks depend on.
        version: the ``code_version`` that must run it.
    """

    source: StudyInput
    configuration: Configuration
    seed: int
    config: Config
    tracker: TrackerName
    frames: int
    folder: Path
    version: str

    @property
    def is_done(self) -> bool:
        """There are tracks of the whole run."""
        return (self.folder / "run.json").is_file()

    @property
    def scores_file(self) -> Path:
        """Figures of the run. Recordings of equal content share the run, but each has its own truth."""
        return self.folder / f"scores_{self.source.truth_key[:16] or 'none'}.json"

    def result(self, done: Done, *, reused: bool) -> JobResult:
        """The row of the run in the table, from how it ended."""
        folder = None if done.error else self.folder
        return JobResult(self.source.name, self.configuration, self.seed, folder, done.value or {}, done.error, reused)


def plan_jobs(study: Study, names: Sequence[str], out: Path) -> list[Job | JobResult]:
    """The runs of a study (arguments of ``run_study``), or why they cannot begin: configuration by configuration,
    recording by recording, seed by seed. Raises InputError: a setting that is not a parameter, or out of its range."""
    version = code_version()
    sources = [*map(identify, names, study.recordings)]

    @cache  # recordings that begin with the same parameters share their configurations: there may be RUNS_MAX runs
    def load_keyed_config(configuration: Configuration, seed: int, base: Config) -> tuple[Config, str]:
        config = load_config(study.config, [*configuration.settings, f"seed={seed}"], base)
        return config, key_of(config.model_dump(mode="json"))

    jobs: list[Job | JobResult] = []
    for configuration in study.configurations():
        for name, source in zip(names, sources, strict=True):
            for seed in study.seeds:
                if isinstance(source, InputError):
                    jobs.append(JobResult(name, configuration, seed, error=str(source)))
                    continue
                config, config_key = load_keyed_config(configuration, seed, source.base)
                folder = out / "jobs" / key_of(source.key, config_key, study.tracker, study.frames, version)
                jobs.append(Job(source, configuration, seed, config, study.tracker, study.frames, folder, version))
    return jobs


def identify(name: str, entry: RecordingEntry) -> StudyInput | InputError:
    """Find the key and the truth of a recording, or why it cannot be used."""
    path = entry.path
    files = [*filter(None, (entry.calibration, entry.camera))]
    try:
        files += FILES.get(find_reader(path, IMAGE_SOURCES).key, files_of_images)(path)
        key = key_of(entry.fps, *map(content_key, files))
        truth = entry.truth or truth_file(path if path.is_dir() else path.parent)
        return StudyInput(name, entry, key, base_config(path), truth, content_key(truth) if truth else "")
    except InputError as error:
        return error


def files_of_images(path: Path) -> list[Path]:
    """Files that tracks depend on: the recording and its companions."""
    return [path, *companion_files(path)]


def files_of_sensors(path: Path) -> list[Path]:
    """rigs.toml, and the folders of the sensors."""
    return [rigs_file(path), *sensor_folders(path)]


FILES: dict[str, Callable[[Path], list[Path]]] = {"sensors": files_of_sensors, "maps": lambda path: [path]}
"""By the key of a reader, what tracks depend on; of all others ``files_of_images``."""


def companion_files(path: Path) -> list[Path]:
    """Files that may belong to a recording of a single file: calibrations, times and poses in its folder."""
    if not path.is_file():
        return []
    endings = (".yml", ".yaml", ".json", ".xml", ".conf")
    names = ("rig.toml", "world.toml", "camera.toml", "timestamps.csv")
    companions = []
    for file in sorted(path.parent.iterdir()):
        may_belong = file.suffix.lower() in endings or file.name in names
        if may_belong and file.name != path.name and file.is_file():
            companions.append(file)
    return companions


def do_job(job: Job) -> dict[str, float]:
    """Run unless an earlier study has done it, and score; the figures are written into its folder."""
    if job.version != code_version():
        raise WorkError(f"expected planview {job.version} on this worker, found {code_version()}")
    if not job.is_done:
        _track(job)
    scores: dict[str, Any] = {}
    if job.source.truth is not None:
        span = (0, job.frames - 1) if job.frames else None
        tracks = load_tracks(job.folder / "tracks.csv")
        scores = evaluate_tracks(tracks, load_truth(job.source.truth), None, span).to_json()
    figures = run_figures(read_run_info(job.folder / "run.json"), scores)
    write_result(job.scores_file, json.dumps(figures, indent=2) + "\n")
    return figures


def _track(job: Job) -> None:
    cv2.setNumThreads(1)  # a study runs a job per core
    entry = job.source.entry
    with whole_folder(job.folder) as folder:
        engine = open_engine(
            entry.path, job.tracker, job.config, entry.camera, OpenOptions(entry.calibration, entry.fps)
        )
        engine.ahead = 0
        run(engine, RunSpec(folder, last_frame=job.frames - 1 if job.frames else None))
        if not job.is_done:  # a folder that lacks run.json makes room only now
            shutil.rmtree(job.folder, ignore_errors=True)


def run_study(
    study: Study, names: Sequence[str], out: Path, workers: AbstractContextManager[Client], progress: Progress
) -> list[JobResult]:
    """Run all that is not done and write study.json and summary.csv; the results come in the order of the study.

    ``study`` has absolute paths, and its recordings ``names`` that differ. What earlier studies in ``out`` did with the
    same input, configuration and version is kept; ``workers`` start for what is left. Raises InputError: a setting that
    is no parameter, too many runs, no cluster, or another study in the folder. WorkError: it cannot be written.
    """
    jobs = plan_jobs(study, names, out)
    with folder_lock(out):
        write_result(out / "study.json", study.model_dump_json(indent=2) + "\n")
        try:
            results = _do_jobs(jobs, workers, progress)
        finally:
            for left_by_killed in out.glob(f"*/{ATTEMPT}*"):
                shutil.rmtree(left_by_killed, ignore_errors=True)
        write_result(out / "summary.csv", summary_csv(results))
    return results


def _do_jobs(
    jobs: Sequence[Job | JobResult], workers: AbstractContextManager[Client], progress: Progress
) -> list[JobResult]:
    """Results in the order of the jobs."""
    left = {job.scores_file: job for job in jobs if isinstance(job, Job) and not read_object(job.scores_file)}
    done: dict[Path, Done] = {}
    if left:
        with workers as client:
            for ended in on_workers(client, do_job, left):
                done[ended.key] = ended
                progress(len(done), len(left))
    results = []
    for job in jobs:
        if isinstance(job, Job):
            file = job.scores_file
            job = job.result(done.get(file) or Done(file, read_object(file)), reused=file not in left)
        results.append(job)
    return results
