"""Recordings with truth on the floor: how often the right number of people is found, and who is who."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pandas import read_csv

from benchmarks.options import Report, Row, benchmark, progress
from benchmarks.passes import FACING, bench_engine
from calib.errors import InputError
from calib.types import F64, I64
from planview.api.run import run
from planview.engine.config import load_config
from planview.engine.open import base_config
from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.metrics import build_sequence, clear_scores, floor_similarity
from planview.synthetic.assets import real_recordings
from planview.trajectories.ends import velocities
from planview.trajectories.table import Trajectories, read_truth, table_of

BASELINE = "peaks"
"""The tracker to beat, which is always scored too."""
PRINTED = ("recording", "tracker", "right_number", "ids", "people", "judged", "positions", "mota", "idf1",
           "position_error_mean_m", "misses", "false_positives", "facing deg", "ahead cm")  # fmt: skip
NOTES = (
    "right number: as many people are reported as show; those too hidden to judge may be reported or not",
    f"facing deg: {FACING}",
    "ahead cm: places of walkers ahead of their heads, along the way that they walk, with the 95 % interval",
)
WALKER_PATH = "walker_path_from_depth.csv"
WALKER_VISIBLE_FRAMES = 30
BESIDE_WALKER_M = 0.3
"""The walker's path comes without ids: later the walker stands cut by the image's border, and so does a second person
to the right [m] (README of the recording). Its frames without a row are not judged."""
SEPARATE_S = 0.5
"""Errors of places within one step of a walker are one error [s]."""
SEPARATE_MIN = 4
"""Fewer steps give no interval."""
DRAWS = 500
"""Bootstrap draws of steps for an interval."""
GATE_M = 0.5
"""A row shows somebody who is nearer than this [m]: as tracks are scored."""
WALKING_MPS = 0.3
"""Speed from which somebody walks [m/s]."""


@benchmark
def real(
    *,
    data: Path | None = None,
    recording: Sequence[str] = (),
    tracker: Sequence[str] = ("joint",),
    overrides: Sequence[str] = (),
) -> Report:
    """Score every real plan-view recording with truth, and the baseline of height peaks.

    A recording is a folder with truth.csv (frame, id, x_m, y_m, height_m, visible); people with visible 0 are too
    hidden or cut off to judge, and may be reported or not. docs/results.md has the sources of the recordings.

    Example: python -m benchmarks real --data ../shared/data --recording rgbd-six-people

    Args:
        data: Folder with recordings; $PLANVIEW_TEST_DATA, else ../shared/data of the repository, by default.
        recording: Only these recordings, by the names of their folders.
        tracker: Trackers, as of planview run; the baseline of height peaks is always added.
        overrides: One parameter of the engine; can be repeated.
    """
    rows: list[Row] = []
    for folder in recordings_with_truth(data or real_recordings(), recording):
        for name in dict.fromkeys((*tracker, BASELINE)):
            progress(f"{folder.name}: {name}")
            rows.append(score_recording(folder, name, overrides))
    printed = [{name: row[name] for name in PRINTED} for row in rows]
    return Report({"scores": rows}, [printed], NOTES)


def recordings_with_truth(data: Path, names: Sequence[str] = ()) -> list[Path]:
    """Folders of recordings with truth on the floor, by name. Raises InputError: there is none, or none of a name."""
    by_name = {}
    for folder in sorted(data.glob("*")):
        if (folder / "truth.csv").is_file() or (folder / WALKER_PATH).is_file():
            by_name[folder.name] = folder
    for name in names:
        if name not in by_name:
            choices = ", ".join(by_name) or "none"
            raise InputError(f"expected one of {choices} in {data}, found {name!r}", argument="recording")
    if not by_name:
        raise InputError(
            f"{data}: no recordings with truth.csv; --data or $PLANVIEW_TEST_DATA names their folder, and "
            "docs/results.md has their sources"
        )
    return [by_name[name] for name in names or by_name]


def score_recording(folder: Path, tracker: str, settings: Sequence[str]) -> Row:
    """Track a recording and score the tracks in the frames that are judged."""
    truth = truth_of(folder)
    engine = bench_engine(folder, tracker, load_config(None, settings, base_config(folder)))
    tracks = run(engine)
    judged = judged_frames(folder, truth, engine.recording.n_frames)
    evaluation = evaluate_tracks(tracks.where(np.isin(tracks.frame, judged)), truth)
    row: Row = {"recording": folder.name, "tracker": tracker}
    row |= count_people(tracks, truth, judged)
    row |= evaluation.to_json()
    row["people"] = len(np.unique(truth.track_id[~(truth.visible <= 0)]))
    row["facing deg"] = evaluation.facing.walkers_deg
    row["ahead cm"] = ahead_of_heads_cm(tracks, truth, 1.0 / engine.recording.fps)
    return row


def truth_of(folder: Path) -> Trajectories:
    """People of a recording on the floor."""
    if (folder / "truth.csv").is_file():
        return read_truth(folder / "truth.csv")
    rows = read_csv(folder / WALKER_PATH)
    both_stand = rows["frame"] >= WALKER_VISIBLE_FRAMES
    is_second = both_stand & (rows["x_m"] > BESIDE_WALKER_M)
    columns = {
        "frame": rows["frame"],
        "id": 1 + is_second,
        "x_m": rows["x_m"],
        "y_m": rows["z_m"],
        "height_m": rows["height_m"],
        "visible": ~both_stand,
    }
    return table_of(columns, WALKER_PATH)


def judged_frames(folder: Path, truth: Trajectories, n_frames: int) -> I64:
    """(F,) frames in which tracks are judged, of a recording with at least ``n_frames``."""
    if (folder / "truth.csv").is_file():  # frames without a row are empty
        return np.arange(max(n_frames, int(truth.frame.max()) + 1))
    return np.unique(truth.frame)


def count_people(tracks: Trajectories, truth: Trajectories, frames: I64) -> Row:
    """Figures of the confirmed tracks of a recording in the (F,) frames that are judged.

    Returns:
        right_number: share of frames in which as many people are reported as show; those too hidden or cut off to judge
        (``visible`` 0 in the truth) may be reported or not. ids: confirmed ids. judged, positions: rows of the truth of
        people who show, and all.
    """
    confirmed = tracks.where(np.isin(tracks.frame, frames) & (tracks.state == "confirmed"))
    shown = truth.where(~(truth.visible <= 0))
    found = _people_in(confirmed, frames)
    is_right = (found >= _people_in(shown, frames)) & (found <= _people_in(truth, frames))
    return {
        "right_number": float(is_right.mean()),
        "ids": len(np.unique(confirmed.track_id)),
        "judged": len(shown),
        "positions": len(truth),
    }


def _people_in(tracks: Trajectories, frames: I64) -> I64:
    """(F,) number of people in each of the frames."""
    return np.bincount(tracks.frame, minlength=int(frames.max()) + 1)[frames]


def ahead_of_heads_cm(tracks: Trajectories, truth: Trajectories, frame_s: float) -> tuple[float, float, float]:
    """Distance by which reported places of walkers are ahead of their heads along the way that they walk [cm], with the
    95 % interval; NaN where too few people walk.

    Least squares of (reported - true place) = ahead * (unit vector of the true velocity) + offset: cameras are not
    registered to the centimetre, which moves everybody alike. The interval is from bootstrapping the walkers' steps.
    """
    confirmed = tracks.where(tracks.state == "confirmed")
    velocity_mps = velocities(truth, frame_s * truth.frame.astype(np.float64))
    speed_mps = np.hypot(*velocity_mps.T)
    true_row, row = clear_scores(build_sequence(truth, confirmed, floor_similarity(GATE_M))).matches.T
    is_judged = (speed_mps[true_row] >= WALKING_MPS) & ~(truth.visible[true_row] <= 0)
    true_row = true_row[is_judged]
    row = row[is_judged]
    error_m = np.column_stack([confirmed.x_m[row] - truth.x_m[true_row], confirmed.y_m[row] - truth.y_m[true_row]])
    direction = velocity_mps[true_row] / speed_mps[true_row, None]
    unknowns = np.concatenate([direction[:, :, None], np.tile(np.eye(2), (len(row), 1, 1))], axis=2)
    step = np.column_stack([truth.track_id[true_row], (truth.frame[true_row] * frame_s / SEPARATE_S).astype(np.int64)])
    steps, step_of = np.unique(step, axis=0, return_inverse=True)
    if len(steps) < SEPARATE_MIN:
        return math.nan, math.nan, math.nan
    ahead_cm = 100.0 * _solve_draws(unknowns, error_m[..., None], step_of.reshape(-1), len(steps))
    low, high = np.quantile(ahead_cm[1:], [0.025, 0.975])
    return float(ahead_cm[0]), float(low), float(high)


def _solve_draws(unknowns: F64, values: F64, step_of: I64, n_steps: int) -> F64:
    """(1 + DRAWS,) first unknown by least squares, of all steps and of each bootstrap draw of steps."""
    transposed = unknowns.transpose(0, 2, 1)
    normal = np.zeros((n_steps, 3, 3))
    right = np.zeros((n_steps, 3, 1))
    np.add.at(normal, step_of, transposed @ unknowns)
    np.add.at(right, step_of, transposed @ values)
    draws = np.random.default_rng(0).multinomial(n_steps, np.full(n_steps, 1.0 / n_steps), size=DRAWS)
    times = np.concatenate([np.ones((1, n_steps)), draws])
    solved = np.linalg.pinv(np.tensordot(times, normal, 1)) @ np.tensordot(times, right, 1)
    return np.asarray(solved[:, 0, 0])
