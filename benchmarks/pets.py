"""The single-camera trackers on PETS S2-L1 view 1, in both protocols."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.tracking_errors import TrackingErrors, tracking_errors
from calib.errors import InputError
from calib.ground_camera import GroundCamera, load_ground_camera, save_ground_camera
from planview.engine.config import Config
from planview.engine.factory import TrackerName, open_engine
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories, TrajectoryCollector

FPS = 7.0
"""Nominal frame rate of the sequence."""
CAMERA_TILT_DEG, CAMERA_SHARE = 0.5, 0.03
"""How far nearby cameras are off [deg], [1]: what calibrations of one view from different people differ by."""
FLOOR_GATE_M = 1.0
"""Gate of the floor protocol; box protocol: IoU 0.5."""


@dataclass(frozen=True, eq=False)
class PetsScores:
    """Scores of one tracker.

    Attributes:
        tracker: its name.
        frames: how many were tracked.
        boxes: with boxes at IoU 0.5.
        floor: on the floor with a gate of 1 m, after the rigid motion between the two world frames; None for tracks
            without floor positions.
        errors: false tracks, losses and switches of the boxes.
        spread: of MOTA and errors over seeds; None when one seed was run.
        cameras: of MOTA over cameras; None when one was used.
    """

    tracker: TrackerName
    frames: int
    boxes: Evaluation
    floor: Evaluation | None
    errors: TrackingErrors
    spread: SeedSpread | None = None
    cameras: CameraSpread | None = None


@dataclass(frozen=True)
class CameraSpread:
    """MOTA of the boxes under cameras that differ a little, the given one first."""

    mota: tuple[float, ...]

    def to_json(self) -> dict[str, Any]:
        """Every score, and their range."""
        return {"mota": self.mota, "mota_range": max(self.mota) - min(self.mota)}


@dataclass(frozen=True)
class SeedSpread:
    """Scores of one clip under many seeds, in order of the seeds."""

    mota: tuple[float, ...]
    errors: tuple[int, ...]

    def to_json(self) -> dict[str, Any]:
        """Every score, standard deviation and range of MOTA, mean number of errors."""
        return {
            "mota": self.mota,
            "errors": self.errors,
            "mota_deviation": float(np.std(self.mota)),
            "mota_range": max(self.mota) - min(self.mota),
            "errors_mean": float(np.mean(self.errors)),
        }


def human_model_on_pets(
    folder: Path,
    camera: Path,
    frames: int | None = None,
    done: Callable[[int], None] = lambda frame: None,
    cameras: int = 1,
) -> PetsScores:
    """Score the human-model tracker.

    Args:
        folder: with view001.mp4 and gt.txt.
        camera: camera.toml, from ``planview calibrate human``.
        frames: at most so many.
        done: called after each frame.
        cameras: the tracker is run with so many, the given one and others near it (``nearby_camera``).
    Raises:
        InputError: files that are missing or do not fit.
    """
    first = _score("human-model", folder, camera, frames, done)
    if cameras == 1:
        return first
    given, scores = load_ground_camera(camera), [first]
    with TemporaryDirectory() as place:
        for number in range(1, cameras):
            path = Path(place) / f"camera{number}.toml"
            save_ground_camera(nearby_camera(given, number), path)
            scores.append(_score("human-model", folder, path, frames, done))
    return replace(first, cameras=CameraSpread(tuple(_mota(s) for s in scores)))


def nearby_camera(camera: GroundCamera, seed: int) -> GroundCamera:
    """A camera within ``CAMERA_TILT_DEG`` and ``CAMERA_SHARE`` of another's tilt, focal length and height."""
    tilt, focal, height = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    return replace(
        camera,
        tilt_rad=camera.tilt_rad + math.radians(CAMERA_TILT_DEG * tilt),
        focal_px=camera.focal_px * (1.0 + CAMERA_SHARE * focal),
        height_m=camera.height_m * (1.0 + CAMERA_SHARE * height),
    )


def _mota(scores: PetsScores) -> float:
    return math.nan if scores.boxes.clear.mota is None else scores.boxes.clear.mota


def ellipse_particle_on_pets(
    folder: Path,
    camera: Path | None,
    frames: int | None = None,
    done: Callable[[int], None] = lambda frame: None,
    seeds: int = 1,
) -> PetsScores:
    """Score the ellipse-particle tracker; without a camera only boxes are scored (see ``human_model_on_pets``).

    Args:
        seeds: seeds 0 to ``seeds - 1`` are run; the scores are those of seed 0.
    """
    first = _score("ellipse-particle", folder, camera, frames, done)
    if seeds == 1:
        return first
    rest = [_score("ellipse-particle", folder, camera, frames, done, seed) for seed in range(1, seeds)]
    scores = [first, *rest]
    return replace(first, spread=SeedSpread(tuple(_mota(s) for s in scores), tuple(s.errors.total for s in scores)))


def _score(
    tracker: TrackerName,
    folder: Path,
    camera: Path | None,
    frames: int | None,
    done: Callable[[int], None],
    seed: int = 0,
) -> PetsScores:
    truth = load_truth(_file(folder, "gt.txt"))
    tracks, n = _track(tracker, _file(folder, "view001.mp4"), camera, frames, done, seed)
    span = (0, n - 1)
    boxes = evaluate_tracks(tracks, truth, EvaluationParams.model_validate({"match_on": "boxes", "fps": FPS}), span)
    errors = tracking_errors(truth.where(truth.frame < n), tracks)
    if camera is None:
        return PetsScores(tracker, n, boxes, None, errors)
    on_floor = EvaluationParams.model_validate({"gate_m": FLOOR_GATE_M, "align": True, "fps": FPS})
    return PetsScores(tracker, n, boxes, evaluate_tracks(tracks, truth, on_floor, span), errors)


def _file(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.is_file():
        raise InputError(f"{folder}: expected a folder with {name} (PETS S2-L1 view 1), found none")
    return path


def _track(
    tracker: TrackerName, video: Path, camera: Path | None, frames: int | None, done: Callable[[int], None], seed: int
) -> tuple[Trajectories, int]:
    """Tracks of the video as ``planview run`` would write them, and the number of frames."""
    tracks, n = TrajectoryCollector(), 0
    for n, result in enumerate(islice(open_engine(video, tracker, Config(seed=seed), camera), frames), 1):
        tracks.add(result.frame, result.timestamp_s, result.tracks)
        done(n)
    return tracks.trajectories(), n
