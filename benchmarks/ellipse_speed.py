"""The ellipse-particle tracker, detection included, beside OpenCV's mixture of Gaussians on the same frames."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np

from benchmarks.beside_mog2 import PaintedVideo, TimesBesideMog2, beside_mog2
from calib.types import U8
from planview.engine.single_camera_pipeline import SingleCameraPipeline
from planview.tracking.ellipse_particle import EllipseParticleParams, ImagePlaneParams, image_ellipse_tracker

SMALL, LARGE = (480, 360), (640, 480)
"""Width and height of the frames [px] (our choice: between a QVGA and a VGA camera, and the latter)."""
FPS = 10.0
SETTLED = 80
"""Frames before anything is timed: backgrounds and sizes are learned, kernels compiled."""


def ellipse_beside_mog2(
    people: int, size: tuple[int, int], person_height_px: float | None, n_frames: int
) -> TimesBesideMog2:
    """The ellipse-particle tracker, detection included, beside MOG2.

    People walk to and fro before a textured scene with pixel noise and cross one another; 1,000 particles.

    Args:
        people: so many are painted; where they hide one another fewer are confirmed.
        size: width and height of the frames [px].
        person_height_px: given by hand; None learns it, which a crowd that never parts does not allow.
        n_frames: timed after SETTLED.
    """
    video = PaintedVideo(partial(painted_clip, people, size), SETTLED + n_frames, size, FPS)
    params = EllipseParticleParams(image=ImagePlaneParams(person_height_px=person_height_px))
    return beside_mog2(SingleCameraPipeline(video, image_ellipse_tracker(params)), SETTLED)


def painted_clip(people: int, size: tuple[int, int], n_frames: int) -> Iterator[U8]:
    """(H, W, 3) uint8 frames; no person in the first 20.

    More than ten people leave the upper part of the image free, which tells that the camera stands still.
    """
    rng = np.random.default_rng(7)
    width, height = size
    texture = cv2.GaussianBlur(rng.uniform(40, 215, (height, width, 3)), (7, 7), 2)
    noise = rng.normal(0, 2.5, (4, height, width, 3))
    clothes = rng.uniform(0, 255, (people, 3))
    feet = np.linspace((140 if people <= 10 else 190) / 360 * height, 340 / 360 * height, people)
    speed = rng.uniform(1.5, 3.5, people) * np.where(np.arange(people) % 2, 1, -1)
    start = rng.uniform(0, width, people)
    for i in range(n_frames):
        frame = texture + noise[i % 4]
        for k in range(people if i >= 20 else 0):
            # To and fro between the two sides.
            x = abs((start[k] + speed[k] * i + width) % (2 * width) - width)
            paint_person(frame, float(np.clip(x, 20, width - 20)), float(feet[k]), clothes[k])
        yield np.clip(frame, 0, 255).astype(np.uint8)


def paint_person(frame: np.ndarray, x: float, foot: float, colour: np.ndarray) -> None:
    """A head, a body and two legs in one colour, in place; larger towards the bottom of the frame."""
    length = 25 + 0.13 * foot
    bgr = tuple(float(c) for c in colour)
    body = (round(x), round(foot - 0.6 * length))
    cv2.circle(frame, (round(x), round(foot - 0.92 * length)), round(0.08 * length), bgr, -1)
    cv2.ellipse(frame, body, (round(0.14 * length), round(0.26 * length)), 0, 0, 360, bgr, -1)
    for side in (-1, 1):
        hip, toe = (round(x), round(foot - 0.45 * length)), (round(x + side * 0.1 * length), round(foot))
        cv2.line(frame, hip, toe, bgr, round(0.1 * length))
