"""The three trackers on the same recordings: accuracy, speed and what each needs, as docs/trackers.md."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from calib.errors import InputError, WorkError
from calib.ground_camera import GroundCamera
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.factory import FloorTrackerName, floor_tracker, image_tracker
from planview.engine.pipeline import Pipeline
from planview.engine.setup import Setup, set_up
from planview.engine.single_camera_pipeline import SingleCameraPipeline
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.trajectories.table import Trajectories, TrajectoryCollector
from stereo.recording import Recording, Skipped, VideoFrame

Tell = Callable[[str], None]

Way = Literal["template", "ellipse-particle, floor", "human-model", "ellipse-particle, image"]

WAYS: dict[Way, str] = {
    "template": "stereo pair, calibration",
    "ellipse-particle, floor": "stereo pair, calibration",
    "human-model": "one camera, camera.toml",
    "ellipse-particle, image": "one camera, nothing (camera.toml for metres)",
}
"""Tracker and plane, and what it needs; in the order of the tables."""


@dataclass(frozen=True)
class TrackerScore:
    """One way of tracking one recording.

    Attributes:
        way: a key of ``WAYS``.
        recording: name.
        evaluation: on the floor.
        track_ms: median time of the tracker alone, for one camera with its foreground [ms].
        frames_per_s: from reading to tracks.
    """

    way: Way
    recording: str
    evaluation: Evaluation
    track_ms: float
    frames_per_s: float


class LeftCamera:
    """The rectified left images of a stereo recording, as a video: what a single camera would have seen."""

    def __init__(self, recording: Recording, setup: Setup) -> None:
        self._recording, self._setup = recording, setup
        self.path, self.n_frames, self.fps = recording.path, recording.n_frames, recording.fps
        self.size = setup.rectifier.geometry.size
        self.skipped: list[Skipped] = recording.skipped

    def __iter__(self) -> Iterator[VideoFrame]:
        for frame in self._recording:
            left = self._setup.rectifier(frame.left, frame.right).left
            yield VideoFrame(frame.index, frame.timestamp_s, left)


def ground_camera(setup: Setup) -> GroundCamera:
    """The rectified left camera above the floor that was found, as the single-camera trackers take it.

    Its model has its centre in the middle of the image, which a rectified camera keeps to a few pixels.
    """
    geometry, pose = setup.rectifier.geometry, setup.floor.world_SE3_left
    tilt = math.acos(float(np.clip(-pose.rotation[2, 2], -1.0, 1.0)))
    tilt = min(tilt, math.radians(89.0))
    up = pose.rotation[2]
    # From straight above roll is the choice of the Y axis.
    roll = math.atan2(float(up[0]), -float(up[1])) if math.hypot(up[0], up[1]) > 0.1 else 0.0
    return GroundCamera(*geometry.size, geometry.focal_u_px, float(pose.translation[2]), tilt, roll_rad=roll)


def compare(recording: Recording, name: str, truth: Trajectories, config: Config, tell: Tell) -> list[TrackerScore]:
    """Track one stereo recording in all ways and score each on the floor.

    Raises:
        WorkError: no floor is visible, or nothing to track.
    """
    setup = set_up(recording, config)
    camera = ground_camera(setup)
    scores = []
    for way in WAYS:
        tell(f"{name}: {way}")
        engine = _engine(way, recording, setup, camera, config)
        tracks, track_ms, seconds, frames = _follow(engine)
        if frames == 0:
            raise WorkError(f"{recording.path}: expected frames to track, found none")
        # One camera cannot tell where a body's axis is behind its outline as well: the same gate for all the same.
        evaluation = evaluate_tracks(tracks, truth.where(truth.frame < frames), EvaluationParams())
        scores.append(TrackerScore(way, name, evaluation, track_ms, frames / max(seconds, 1e-9)))
    return scores


def _engine(way: Way, recording: Recording, setup: Setup, camera: GroundCamera, config: Config) -> Engine:
    if way == "human-model":
        tracker = image_tracker("human-model", config, camera)
    elif way == "ellipse-particle, image":
        tracker = image_tracker("ellipse-particle", config, camera)
    else:
        name: FloorTrackerName = "template" if way == "template" else "ellipse-particle"
        return Pipeline(recording, setup, config, floor_tracker(name, config))
    return SingleCameraPipeline.from_recording(LeftCamera(recording, setup), tracker, config, camera)


def _follow(engine: Engine) -> tuple[Trajectories, float, float, int]:
    """Tracks, median time of the tracker [ms], seconds in all, frames."""
    spent: list[float] = []
    tracks, start = TrajectoryCollector(), time.perf_counter()
    for result in engine:
        tracks.add(result.frame, result.timestamp_s, result.tracks)
        stages = result.stages_ms
        spent.append(stages["track"] + (stages["foreground"] if engine.stereo is None else 0.0))
    seconds = time.perf_counter() - start
    return tracks.trajectories(), float(np.median(spent)) if spent else math.nan, seconds, len(spent)


def page(scores: list[TrackerScore], command: str) -> str:
    """docs/trackers.md: what each tracker needs and does, and the tables."""
    names = list(dict.fromkeys(score.recording for score in scores))
    lines = [*INTRODUCTION, f"Made by `{command}`.", ""]
    lines += ["## All recordings together", "", *_table(_pooled(scores)), ""]
    for name in names:
        lines += [f"## {name}", "", *_table([(s.way, s) for s in scores if s.recording == name]), ""]
    return "\n".join(lines)


def _pooled(scores: list[TrackerScore]) -> list[tuple[str, list[TrackerScore]]]:
    return [(way, [s for s in scores if s.way == way]) for way in WAYS if any(s.way == way for s in scores)]


def _table(rows: Iterable[tuple[str, TrackerScore | list[TrackerScore]]]) -> list[str]:
    lines = [
        "| tracker | MOTA | IDF1 | switches | significant errors | position error | height error | tracker alone "
        "| whole engine |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for way, row in rows:
        group = row if isinstance(row, list) else [row]
        every = [s.evaluation for s in group]
        rows_of_truth = sum(e.truth_rows for e in every)
        wrong = sum(e.clear.misses + e.clear.false_positives + e.clear.switches for e in every)
        identities = sum((e.identity.idf1 or 0.0) * e.truth_rows for e in every)
        position = np.concatenate([e.position_error_m for e in every])
        height = np.concatenate([e.height_error_m for e in every])
        cells = [
            f"{1 - wrong / rows_of_truth:.2f}" if rows_of_truth else "",
            f"{identities / rows_of_truth:.2f}" if rows_of_truth else "",
            str(sum(e.clear.switches for e in every)),
            str(sum(len(e.significant) for e in every)),
            f"{100 * position.mean():.1f} cm" if len(position) else "",
            f"{100 * height.mean():.1f} cm" if len(height) else "",
            f"{np.mean([s.track_ms for s in group]):.1f} ms",
            f"{np.mean([s.frames_per_s for s in group]):.0f} frames/s",
        ]
        lines.append(f"| {way} | " + " | ".join(cells) + " |")
    return lines


INTRODUCTION = [
    "# Three trackers on the same recordings",
    "",
    "| tracker | needs | follows | paper |",
    "|---|---|---|---|",
    "| `template` | a stereo pair and its calibration | templates of height and occupancy on the floor "
    "| Harville 2002 |",
    "| `ellipse-particle`, floor | a stereo pair and its calibration | ellipses of constant metric size on the "
    "occupancy map | del-Blanco, Jaureguizar, Garcia 2012, moved to the floor |",
    "| `human-model` | one camera and its `camera.toml` | the projected hull of a standing person "
    "| Zhang, Venetianer, Lipton 2008 |",
    "| `ellipse-particle`, image | one camera and nothing else; a `camera.toml` adds metres | ellipses on the image's "
    "foreground | del-Blanco, Jaureguizar, Garcia 2012 |",
    "",
    "Each stereo recording is tracked four times: by both trackers on the floor, and by the single-camera trackers on "
    "its rectified left images with the camera that the stereo pair found above its floor. All are scored on the floor "
    "with a gate of 0.5 m. `tracker alone` is the tracker's median time per frame, for one camera with its foreground; "
    "`whole engine` runs from reading to tracks. A single camera has no depth: what stands behind another person's "
    "shoulders, or walks with its feet hidden, costs it metres.",
    "",
]


def check_truth(path: Path) -> None:
    """Raises InputError when a recording has no truth to be scored against."""
    if not (path / "truth.csv").is_file():
        raise InputError(f"{path}: expected a recording with truth.csv, found none")
