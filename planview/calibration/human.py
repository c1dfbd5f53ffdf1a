"""Samples for ``planview calibrate human``, collected from a video of one person walking alone (Zhang 2008, 3.3)."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from calib.errors import WorkError
from calib.human.choice import choose_spread
from calib.human.samples import MIN_SAMPLES, HumanSample
from calib.types import F64, U8, Bool
from planview.foreground.blobs import find_blobs
from planview.pipeline.single_camera import SingleCamera, SingleCameraParams
from stereo.recording import Video

WARM_UP_S = 1.0
"""The background is learned for so long before anybody is believed."""
MIN_HEIGHT_SHARE = 0.06
"""A person is at least this share of the image's height [1]: smaller ones say nothing about a camera."""
RIVAL_SHARE = 0.25
"""Another blob above this share of the largest is somebody else, or the person in two pieces: the frame is passed."""
MIN_FILL, MAX_FILL = 0.3, 0.95
"""A standing person fills this share of the box [1]; streaks and lit rectangles do not."""


def collect_samples(
    video: Video, count: int = 12, params: SingleCameraParams | None = None, done: Callable[[], None] = lambda: None
) -> tuple[HumanSample, ...]:
    """Follow the only moving thing and take samples where it stands apart from the image's edge.

    Head and foot are the ends of the blob's longest axis, the head the upper one; of a blob without a longest axis
    (seen from above) both are its middle.

    Args:
        video: of one person walking alone.
        count: how many samples to take.
        done: called after every frame.
    Raises:
        WorkError: fewer than 3 usable sightings.
    """
    camera = SingleCamera(params or SingleCameraParams(), video.size)
    sightings = []
    for frame in video:
        observation = camera.observe(frame)
        if frame.timestamp_s >= WARM_UP_S and observation.foreground is not None:
            sample = sample_of(observation.foreground, frame.index)
            if sample is not None:
                sightings.append(sample)
        done()
    usual = _usual(sightings)
    if len(usual) < MIN_SAMPLES:
        raise WorkError(
            f"{video.path}: expected one person walking alone, found {len(usual)} frames in which a single whole "
            f"person is seen (at least {MIN_SAMPLES} needed)"
        )
    return choose_spread(usual, count)


def sample_of(mask: U8, frame: int) -> HumanSample | None:
    """The only person of a (H, W) foreground mask, None where there is none, several, or one cut off."""
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((7, 5), np.uint8))
    blobs = find_blobs(np.asarray(closed, dtype=np.uint8))
    if len(blobs) < 2:
        return None
    order = np.argsort(blobs.area_px[1:])[::-1] + 1
    best = int(order[0])
    left, top, width, height = (int(v) for v in blobs.box_px[best])
    rows, columns = mask.shape
    cut = left <= 1 or top <= 1 or left + width >= columns - 1 or top + height >= rows - 1
    rival = len(order) > 1 and blobs.area_px[order[1]] > RIVAL_SHARE * blobs.area_px[best]
    fill = float(blobs.area_px[best]) / (width * height)
    if cut or rival or height < MIN_HEIGHT_SHARE * rows or not MIN_FILL <= fill <= MAX_FILL:
        return None
    inside: Bool = np.asarray(blobs.labels[top : top + height, left : left + width] == best)
    head, foot = _ends(inside)
    return HumanSample(
        (float(left), float(top), float(width), float(height)),
        (left + float(head[0]), top + float(head[1])),
        (left + float(foot[0]), top + float(foot[1])),
        frame,
    )


def _ends(inside: Bool) -> tuple[F64, F64]:
    """Head and foot (u, v) within the box."""
    v, u = np.nonzero(inside)
    points = np.column_stack([u, v]).astype(np.float64)
    centre = points.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((points - centre).T))
    if spread[1] < 2.0 * spread[0]:
        return centre, centre
    axis = axes[:, 1] if axes[1, 1] > 0 else -axes[:, 1]
    along = (points - centre) @ axis
    low, high = np.quantile(along, (0.005, 0.995))
    return centre + low * axis, centre + high * axis


def _usual(sightings: list[HumanSample]) -> list[HumanSample]:
    """Without the odd ones: boxes much larger or smaller than others near them are parts, shadows or two people."""
    if len(sightings) < 5:
        return sightings
    feet = np.array([s.foot_px for s in sightings])
    heights = np.array([s.box_px[3] for s in sightings])
    kept = []
    for sample, foot, height in zip(sightings, feet, heights, strict=True):
        near = np.argsort(np.hypot(*(feet - foot).T))[: max(5, len(sightings) // 10)]
        if abs(height - np.median(heights[near])) < 0.15 * height:
            kept.append(sample)
    return kept
