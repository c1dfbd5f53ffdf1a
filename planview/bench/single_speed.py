"""The single-camera trackers beside OpenCV's MOG2 on the same frames."""

from __future__ import annotations

import math
import time

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import U8
from planview.bench.clip import Clip
from planview.bench.ellipse_speed import ellipse_to_mog2
from planview.single_camera import SingleCamera
from planview.tracking.base import ImageTracker
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.tracker import HumanModelTracker
from stereo.recording import VideoFrame

HUMAN_MODEL_SIZE = (320, 240)
"""(width, height) at which the human-model tracker is measured [px]."""


def human_model_to_mog2(clip: Clip, settled: int) -> tuple[float, dict[str, float]]:
    """Foreground and human-model tracker at 320x240 over MOG2: the ratio, and the times behind it."""
    camera = ground_camera(clip, HUMAN_MODEL_SIZE)
    return _beside_mog2(clip, HUMAN_MODEL_SIZE, HumanModelTracker(HumanModelParams(), camera), "human_model", settled)


def ellipse_particle_to_mog2(clip: Clip, settled: int) -> tuple[float, dict[str, float]]:
    """Detection and ellipse-particle tracker at 480x360, 1,000 particles, over MOG2: ratio and times.

    On eight painted people (see ``ellipse_speed``), as many frames as the clip has after ``settled``.
    """
    return ellipse_to_mog2(max(20, len(clip.pairs) - settled))


def ground_camera(clip: Clip, size: tuple[int, int]) -> GroundCamera:
    """The rectified left camera above its floor, for images of another size."""
    geometry, pose = clip.pipeline.setup.rectifier.geometry, clip.pipeline.setup.floor.world_SE3_left
    tilt = math.acos(float(np.clip(-pose.rotation[2, 2], -1, 1)))
    focal = geometry.focal_u_px * size[0] / geometry.width
    return GroundCamera(size[0], size[1], focal, float(pose.translation[2]), tilt)


def _beside_mog2(
    clip: Clip, size: tuple[int, int], tracker: ImageTracker, name: str, settled: int
) -> tuple[float, dict[str, float]]:
    mog2, source = cv2.createBackgroundSubtractorMOG2(), SingleCamera(clip.config.single_camera, size)
    ours, theirs, people = [], [], []
    for i, pair in enumerate(clip.pairs):
        image = _resized(clip.pipeline.setup.rectifier(pair.left, pair.right).left, size)
        start = time.perf_counter()
        mog2.apply(image)
        theirs.append(time.perf_counter() - start)
        frame = VideoFrame(i, pair.timestamp_s, image)
        start = time.perf_counter()
        tracks = tracker.update(source.observe(frame, tracker.feedback()))
        ours.append(time.perf_counter() - start)
        people.append(sum(track.state != "lost" for track in tracks))
    ours_ms, mog2_ms = (float(np.median(times[settled:])) * 1e3 for times in (ours, theirs))
    details = {f"{name}_ms": ours_ms, f"{name}_mog2_ms": mog2_ms, f"{name}_people": float(np.median(people[settled:]))}
    return ours_ms / mog2_ms, details


def _resized(image: U8, size: tuple[int, int]) -> U8:
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
