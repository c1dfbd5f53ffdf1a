"""The human-model tracker beside OpenCV's MOG2 on the same frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np

from benchmarks.beside_mog2 import PaintedVideo, TimesBesideMog2, beside_mog2
from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.types import U8
from planview.engine.single_camera_pipeline import SingleCameraPipeline
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.tracker import HumanModelTracker

CAMERA = GroundCamera(320, 240, 260.0, 3.5, math.radians(60))
"""320x240 as in Zhang et al. 2008, section 5; its view covers the floor from 2 to 10 m."""
LARGE = GroundCamera(640, 480, 520.0, 3.5, math.radians(60))
"""The same view in four times the pixels."""
FPS = 15.0
SETTLED = 60
"""Frames before anything is timed: the background is learned, people are confirmed, kernels compiled."""


def human_model_beside_mog2(camera: GroundCamera, people: int, n_frames: int) -> TimesBesideMog2:
    """Foreground and human-model tracker beside MOG2 on people who walk to and fro.

    Args:
        camera: of the painted view.
        people: so many are painted; where they hide one another fewer are confirmed.
        n_frames: timed after SETTLED.
    """
    video = PaintedVideo(partial(walking_people, camera, people), SETTLED + n_frames, camera.size, FPS)
    engine = SingleCameraPipeline(video, HumanModelTracker(HumanModelParams(), camera), camera=camera)
    return beside_mog2(engine, SETTLED)


def walking_people(camera: GroundCamera, people: int, n_frames: int) -> Iterator[U8]:
    """(H, W, 3) uint8 frames of people of the model's shape who cross the view; no person in the first 10."""
    rng = np.random.default_rng(5)
    width, height = camera.size
    texture = cv2.GaussianBlur(rng.uniform(40, 215, (height, width, 3)), (7, 7), 2)
    noise = rng.normal(0, 2.5, (4, height, width, 3))
    clothes = rng.uniform(0, 255, (people, 2, 3))
    far = np.linspace(7.5, 3.5, people)
    reach = 0.55 * far
    speed = rng.uniform(0.8, 1.4, people) * np.where(np.arange(people) % 2, 1, -1)
    start = rng.uniform(-reach, reach)
    for i in range(n_frames):
        frame = texture + noise[i % 4]
        for k in range(people if i >= 10 else 0):
            # To and fro between the two sides.
            x = abs((start[k] + reach[k] + speed[k] * i / FPS) % (4 * reach[k]) - 2 * reach[k]) - reach[k]
            _paint(frame, camera, x, float(far[k]), clothes[k])
        yield np.clip(frame, 0, 255).astype(np.uint8)


def _paint(frame: np.ndarray, camera: GroundCamera, x_m: float, y_m: float, clothes: np.ndarray) -> None:
    """The model's outline, in one colour above the hip and another below."""
    hull = np.round(HumanModel().hull(camera, x_m, y_m)).astype(np.int32)
    hip = int(np.mean(hull[:, 1]))
    body = np.zeros(frame.shape[:2], np.uint8)
    cv2.fillPoly(body, [hull], 1)
    rows = np.arange(len(body))[:, None]
    frame[(body > 0) & (rows < hip)] = clothes[0]
    frame[(body > 0) & (rows >= hip)] = clothes[1]
