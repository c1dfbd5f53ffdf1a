"""The ellipse-particle tracker, detection included, beside OpenCV's mixture of Gaussians on the same frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import cv2
import numpy as np

from calib.types import U8
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle import EllipseParticleTracker

SIZE = (480, 360)
"""Width and height of the frames [px] (our choice: between a QVGA and a VGA camera)."""
PEOPLE = 8
SETTLED = 80
"""Frames before anything is timed: backgrounds and sizes are learned, kernels compiled."""


def ellipse_to_mog2(n_frames: int = 200) -> tuple[float, dict[str, float]]:
    """Processor time of ``EllipseParticleTracker.update`` over MOG2's, in turns on each frame of a painted clip.

    Eight people walk to and fro before a textured scene with pixel noise and cross one another; 1,000 particles.

    Args:
        n_frames: medians over so many frames.
    Returns:
        the ratio of the medians; and times of both and the number of people tracked, medians.
    """
    alone = cv2.createBackgroundSubtractorMOG2()
    tracker = EllipseParticleTracker()
    ours: list[float] = []
    theirs: list[float] = []
    people: list[int] = []
    for i, image in enumerate(painted_clip(SETTLED + n_frames)):
        theirs.append(_seconds(lambda frame: alone.apply(frame), image))
        seen = Observation(i, i / 10, image=image)
        start = time.process_time()
        tracks = tracker.update(seen)
        ours.append(time.process_time() - start)
        people.append(sum(track.state == "confirmed" for track in tracks))
    medians = [1e3 * float(np.median(spent[SETTLED:])) for spent in (ours, theirs)]
    details = {
        "ellipse_particle_ms": round(medians[0], 3),
        "ellipse_particle_mog2_ms": round(medians[1], 3),
        "ellipse_particle_people": float(np.median(people[SETTLED:])),
    }
    return medians[0] / medians[1], details


def painted_clip(n_frames: int) -> Iterator[U8]:
    """(360, 480, 3) uint8 frames; nobody in the first 20."""
    rng = np.random.default_rng(7)
    width, height = SIZE
    texture = cv2.GaussianBlur(rng.uniform(40, 215, (height, width, 3)), (7, 7), 2)
    noise = rng.normal(0, 2.5, (4, height, width, 3))
    clothes = rng.uniform(0, 255, (PEOPLE, 3))
    feet = np.linspace(140, 340, PEOPLE)
    speed = rng.uniform(1.5, 3.5, PEOPLE) * np.where(np.arange(PEOPLE) % 2, 1, -1)
    start = rng.uniform(0, width, PEOPLE)
    for i in range(n_frames):
        frame = texture + noise[i % 4]
        for k in range(PEOPLE if i >= 20 else 0):
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


def _seconds(run: Callable[[U8], object], image: U8) -> float:
    start = time.process_time()
    run(image)
    return time.process_time() - start
