"""Spread of the figures of a recording when its times and depths change by less than their errors."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from benchmarks.options import Report, Row, benchmark, progress
from benchmarks.passes import bench_engine
from benchmarks.real import recordings_with_truth, truth_of
from planview.api.run import run
from planview.engine.config import load_config
from planview.engine.open import base_config
from planview.evaluation.evaluate import evaluate_tracks
from planview.maps.recording import MapsRecording
from planview.synthetic.assets import real_recordings
from planview.trajectories.table import Trajectories

TIME_S = 1e-6
"""Half width of the change of each frame's time [s]."""
DEPTH_M = 0.001
"""Deviation of the change of each point's depth [m]."""


@benchmark
def jitter(*, data: Path | None = None, recording: Sequence[str] = (), runs: int = 10) -> Report:
    """Print how far scores spread when times change by a microsecond and depths by a millimetre.

    Each recording is tracked once, and its foreground points are tracked again with such changes. A difference between
    two versions of the engine that is below this spread means nothing.

    Example: python -m benchmarks jitter --data ../shared/data --recording rgbd-overhead

    Args:
        data: Folder with recordings; $PLANVIEW_TEST_DATA, else ../shared/data of the repository, by default.
        recording: Only these recordings, by the names of their folders.
        runs: How often each recording is changed.
    """
    rows = [_spread(folder, runs) for folder in recordings_with_truth(data or real_recordings(), recording)]
    return Report({"spread": rows}, [rows], ("from lowest to highest over all runs",))


def _spread(folder: Path, runs: int) -> Row:
    """Lowest and highest scores of a recording over some runs, with the unchanged one."""
    truth = truth_of(folder)
    scores = []
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        engine = bench_engine(folder, "joint", load_config(None, (), base_config(folder)))
        scores.append(_score(run(engine, out=out, maps=True), truth))
        for seed in range(runs):
            progress(f"{folder.name}: change {seed + 1} of {runs}")
            changed = _change(out / "maps.h5", seed)
            scores.append(_score(run(changed), truth))
    return {
        "recording": folder.name,
        "people": _range([score["tracked_people"] for score in scores], "g"),
        "mota": _range([score["mota"] for score in scores], ".3f"),
        "position cm": _range([100.0 * score["position_error_mean_m"] for score in scores], ".1f"),
    }


def _range(values: Sequence[float], form: str) -> str:
    """From the lowest to the highest value."""
    return f"{min(values):{form}} to {max(values):{form}}"


def _score(tracks: Trajectories, truth: Trajectories) -> Row:
    """Scores in the frames in which the truth has rows."""
    return evaluate_tracks(tracks.where(np.isin(tracks.frame, truth.frame)), truth).to_json()


def _change(maps: Path, seed: int) -> Path:
    """A copy of a plan-view recording with other times and depths, next to it."""
    changed = maps.with_name("changed.h5")
    shutil.copy(maps, changed)
    rng = np.random.default_rng(seed)
    geometry = MapsRecording(maps).sensor.rig.geometry
    with h5py.File(changed, "r+") as file:
        times_s = file["frames/timestamp_s"]
        times_s[:] += rng.uniform(-TIME_S, TIME_S, times_s.shape)
        disparities_px = file["points/disparity"]
        px_per_m = disparities_px[:] ** 2 / (geometry.focal_u_px * geometry.baseline_m)
        disparities_px[:] += px_per_m * rng.normal(0.0, DEPTH_M, disparities_px.shape)
    return changed
