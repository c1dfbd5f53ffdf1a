"""Many runs: every recording with every combination of settings."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calib.errors import InputError
from planview.evaluation.evaluate import evaluate_tracks
from planview.maps.recording import is_maps
from planview.pipeline.config import load_config
from planview.pipeline.factory import base_config, open_engine
from planview.runs.folder import finished_run, prepare_folder
from planview.runs.report.page import write_report
from planview.runs.run import run
from planview.trajectories.layouts import load_tracks, load_truth


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        recording: what to track: a stereo recording, or maps.h5 of one.
        settings: overrides like "maps.cell_m=0.04".
        config: parameters common to all runs.
        folder: where the results go.
    """

    recording: Path
    settings: tuple[str, ...]
    config: Path | None
    folder: Path


def jobs_of(recordings: Sequence[Path], vary: Sequence[str], config: Path | None, out: Path) -> list[Job]:
    """All combinations; every setting is checked before anything runs.

    Raises:
        InputError: two recordings of one name, or a setting that is not a known parameter in its range.
    """
    names = [_name(recording) for recording in recordings]
    if len(set(names)) < len(names):
        raise InputError(f"expected recordings with different names, found {sorted(names)}")
    choices = [_choices(text) for text in vary]
    jobs = []
    for recording, settings in itertools.product(recordings, itertools.product(*choices)):
        load_config(config, settings, base_config(recording))
        label = "_".join(setting.replace("=", "-") for setting in settings) or "defaults"
        jobs.append(Job(recording, tuple(settings), config, out / _name(recording) / label))
    folders = [job.folder for job in jobs]
    if len(set(folders)) < len(folders):
        raise InputError(f"--vary: expected different settings for every run, found one twice in {list(vary)}")
    return jobs


def _name(recording: Path) -> str:
    path = recording.resolve()
    return path.parent.name if is_maps(path) else path.name


def _choices(text: str) -> list[str]:
    name, equals, values = text.partition("=")
    if not equals or not values:
        raise InputError(f"--vary: expected table.key=value,value, found {text!r}")
    return [f"{name}={value}" for value in values.split(",")]


def run_jobs(jobs: Sequence[Job], at_once: int = 1, cluster: str | None = None) -> list[tuple[Job, dict[str, float]]]:
    """Run jobs locally, in processes, or on a Dask cluster; the order of the results is that of the jobs.

    Raises:
        InputError: the cluster cannot be reached or ``distributed`` is not installed.
    """
    if cluster is None:
        from joblib import Parallel, delayed

        # loky starts fresh processes: forked ones would share OpenCV's threads.
        return list(zip(jobs, Parallel(n_jobs=at_once)(delayed(run_job)(job) for job in jobs), strict=True))
    try:
        from distributed import Client

        client = Client(cluster, timeout=10)
    except ImportError as error:
        raise InputError("--cluster: expected the package distributed; install planview[cluster]") from error
    except OSError as error:
        raise InputError(f"--cluster: expected a Dask scheduler at {cluster}, found none ({error})") from error
    with client:
        return list(zip(jobs, client.gather(client.map(run_job, jobs, pure=False)), strict=True))


def run_job(job: Job) -> dict[str, float]:
    """Run one job unless its folder holds a finished run; figures of the run and, with truth, its scores.

    Raises:
        InputError: the folder holds a finished run with other parameters.
    """
    config = load_config(job.config, job.settings, base_config(job.recording))
    info = finished_run(job.folder)
    if info is None:
        prepare_folder(job.folder, overwrite=(job.folder / "run.json").is_file())
        info = run(open_engine(job.recording, "template", config), job.folder)
        write_report(job.folder)
    elif info.config != config.model_dump(mode="json"):
        raise InputError(f"{job.folder}: holds a run with other parameters; choose another folder for this sweep")
    figures: dict[str, float] = {"people": info.people, "elapsed_s": info.elapsed_s}
    truth = (job.recording.parent if is_maps(job.recording) else job.recording) / "truth.csv"
    if truth.is_file():
        scores = evaluate_tracks(load_tracks(job.folder / "tracks.csv"), load_truth(truth))
        summary = scores.to_json()
        for key in ("mota", "idf1", "position_error_mean_m", "height_error_mean_m"):
            figures[key] = summary[key]
        figures["errors"] = summary["significant_errors"]["total"]
    return figures
