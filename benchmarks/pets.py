"""PETS 2009 S2-L1, view 1: the trackers of one camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple, get_args

import numpy as np

from benchmarks.options import Report, Row, benchmark, progress
from calib.errors import InputError
from calib.ground_camera import load_ground_camera, save_ground_camera
from planview.api.arguments import in_range
from planview.api.run import run
from planview.engine.config import Config
from planview.engine.open import ImageTrackerName
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.trajectories.formats import load_truth

FPS = 7.0
"""Nominal frame rate of the sequence."""
PRINTED = ("tracker", "protocol", "tracked_frames", "truth_rows", "mota", "idf1", "hota", "switches", "misses",
           "false_positives")  # fmt: skip
FOCAL_STEP = 1e-5
"""Difference of focal length between cameras that are nearly alike."""


class PetsRun(NamedTuple):
    """Scores of one run of one tracker.

    Attributes:
        protocols: by what they are of: boxes at IoU 0.5, and where tracks have positions the floor with a gate of 1 m,
            after the rigid motion between the two world frames.
    """

    tracker: ImageTrackerName
    frames: int
    protocols: dict[str, Evaluation]


@benchmark
def pets(
    folder: Path,
    *,
    camera: Path | None = None,
    tracker: Literal["both", "human-model", "ellipse-particle"] = "both",
    frames: int | None = None,
    seeds: int = 1,
) -> Report:
    """Score the single-camera trackers on PETS S2-L1 view 1.

    Example: python -m benchmarks pets ../shared/data/pets09-s2l1-view001 --camera camera.toml

    Example: python -m benchmarks pets ../shared/data/pets09-s2l1-view001 --tracker ellipse-particle --seeds 20

    Args:
        folder: Folder with view001.mp4 and gt.txt.
        camera: camera.toml, e.g. from planview calibrate human with tests/data/pets_people.json; the ellipse-particle
            tracker needs none, but is scored on the floor with one.
        tracker: Which tracker to score.
        frames: Only the first frames.
        seeds: Run the ellipse-particle tracker with this many seeds, the human-model tracker with this many cameras
            that are nearly alike, and print the spread of the scores.
    """
    in_range("seeds", seeds, 1, 1000)
    if frames is not None:
        in_range("frames", frames, 1, 1_000_000)
    if camera is None and tracker != "ellipse-particle":
        raise InputError("the human-model tracker needs --camera camera.toml (see planview calibrate human)")
    for name in ("gt.txt", "view001.mp4"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: expected a folder with {name} (PETS S2-L1 view 1), found none")
    progress(f"tracking {folder}")
    rows: list[Row] = []
    spreads: list[Row] = []
    for name in get_args(ImageTrackerName):
        if tracker not in ("both", name):
            continue
        runs = track_nearly_alike(name, folder, camera, frames, seeds)
        rows += protocol_rows(runs[0])
        if seeds > 1:
            spreads += spread_rows(runs)
    printed = [{name: row[name] for name in PRINTED} for row in rows]
    return Report({"scores": rows, "spread": spreads}, [printed, spreads])


def track_nearly_alike(
    tracker: ImageTrackerName, folder: Path, camera: Path | None, frames: int | None, seeds: int
) -> list[PetsRun]:
    """Score ``seeds`` runs of a tracker, by seeds; the human-model tracker draws no random numbers, and its runs differ
    by FOCAL_STEP in the focal length of the camera."""
    if camera is None or tracker == "ellipse-particle":
        return [score_run(tracker, folder, camera, frames, seed) for seed in range(seeds)]
    truth = load_ground_camera(camera)
    runs = []
    with TemporaryDirectory() as place:
        for n in range(seeds):
            path = Path(place) / f"{n}.toml"
            save_ground_camera(replace(truth, focal_px=truth.focal_px * (1.0 + FOCAL_STEP * n)), path)
            runs.append(score_run(tracker, folder, path, frames, 0))
    return runs


def score_run(tracker: ImageTrackerName, folder: Path, camera: Path | None, frames: int | None, seed: int) -> PetsRun:
    """Track the video and score the tracks; without a camera.toml only boxes are scored."""
    frames_seen: list[int] = []
    tracks = run(
        folder / "view001.mp4",
        tracker=tracker,
        config=Config(seed=seed),
        calibration=camera,
        frames=frames,
        watch=lambda result: frames_seen.append(result.frame),
    )
    truth = load_truth(folder / "gt.txt")
    span = (0, len(frames_seen) - 1)
    boxes = EvaluationParams(match_on="boxes", fps=FPS)
    protocols = {"boxes, IoU 0.5": evaluate_tracks(tracks, truth, boxes, span)}
    if camera is not None:
        on_floor = EvaluationParams(gate_m=1.0, align=True, fps=FPS)
        protocols["floor, 1 m"] = evaluate_tracks(tracks, truth, on_floor, span)
    return PetsRun(tracker, len(frames_seen), protocols)


def protocol_rows(scored: PetsRun) -> list[Row]:
    """A row per protocol with every figure."""
    rows: list[Row] = []
    for protocol, evaluation in scored.protocols.items():
        names = {"tracker": scored.tracker, "protocol": protocol, "tracked_frames": scored.frames}
        rows.append(names | evaluation.to_json())
    return rows


def spread_rows(runs: Sequence[PetsRun]) -> list[Row]:
    """Mean, deviation and range over several runs, a row per protocol."""
    rows: list[Row] = []
    for protocol in runs[0].protocols:
        evaluations = [scored.protocols[protocol] for scored in runs]
        mota = np.array([evaluation.clear.mota for evaluation in evaluations], dtype=np.float64)
        idf1 = np.array([evaluation.idf1 for evaluation in evaluations], dtype=np.float64)
        rows.append(
            {
                "tracker": runs[0].tracker,
                "protocol": protocol.partition(",")[0],
                "runs": len(runs),
                "mota_mean": mota.mean(),
                "mota_deviation": mota.std(),
                "mota_range": np.ptp(mota),
                "idf1_mean": idf1.mean(),
                "idf1_deviation": idf1.std(),
            }
        )
    return rows
