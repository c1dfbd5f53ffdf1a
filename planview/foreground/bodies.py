"""Whole people in foreground masks, apart from others, and the paths of those who walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.people.samples import HumanSample
from calib.types import F64, U8, Bool
from planview.foreground.ghosts import Blobs, find_blobs

Box = tuple[float, float, float, float]
"""Left, top, width, height [px]."""
MIN_SIZE = 0.06
"""A person is at least this share of the image's height [1]: smaller ones add nothing about a camera."""


@dataclass(eq=False)
class BodyPath:
    """Blobs of one walker."""

    samples: list[HumanSample]
    last_frame: int

    @property
    def walks(self) -> bool:
        """True for a person who goes somewhere."""
        # What moves by less than half a body, or is met in fewer frames, is furniture, light or a ghost.
        if len(self.samples) < 4:
            return False
        boxes = np.array([sample.box_px for sample in self.samples])
        middles = boxes[:, :2] + boxes[:, 2:] / 2
        extent = float(np.hypot(*np.ptp(middles, axis=0)))
        return extent >= 0.5 * float(np.median([sample.diagonal_px for sample in self.samples]))


def bodies_of(mask: U8, frame: int) -> list[HumanSample]:
    """Whole people apart from others in a (H, W) foreground mask."""
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((7, 5), np.uint8))
    blobs = find_blobs(np.asarray(closed, dtype=np.uint8))
    samples = []
    for label in range(1, len(blobs)):
        length = max(blobs.box_px[label][2:])
        if length < MIN_SIZE * mask.shape[0] or _is_crowded(blobs, label):
            continue
        sample = _whole_person(blobs, label, mask.shape, frame)
        if sample is not None:
            samples.append(sample)
    return samples


def continue_paths(paths: list[BodyPath], bodies: Sequence[HumanSample], frame: int) -> None:
    """Append every body to the path of the frame before that it overlaps most, or begin one."""
    open_paths = [path for path in paths if 0 < frame - path.last_frame <= 2]
    for body in bodies:
        overlaps = [_overlap(body.box_px, path.samples[-1].box_px) for path in open_paths]
        # Boxes of one walker in frames that follow each other overlap by this part of their union [1].
        if max(overlaps, default=0.0) < 0.3:
            paths.append(BodyPath([body], frame))
            continue
        path = open_paths.pop(int(np.argmax(overlaps)))
        path.samples.append(body)
        path.last_frame = frame


def _overlap(first: Box, second: Box) -> float:
    """Intersection over union of two boxes."""
    left, top, width, height = first
    other_left, other_top, other_width, other_height = second
    common_width = min(left + width, other_left + other_width) - max(left, other_left)
    common_height = min(top + height, other_top + other_height) - max(top, other_top)
    common = max(0.0, common_width) * max(0.0, common_height)
    return common / (width * height + other_width * other_height - common)


def _is_crowded(blobs: Blobs, label: int) -> bool:
    """True if another blob that is not noise is near the box."""
    low = blobs.box_px[:, :2]
    high = blobs.box_px[:, :2] + blobs.box_px[:, 2:]
    # Nearer blobs may be pieces of one person, or hide each other [px]; above and below, within this share of the
    # body's height [1]: bodies break at belt and collar.
    gap = np.array([4.0, max(4.0, 0.35 * float(blobs.box_px[label][3]))])
    is_near = ((low < high[label] + gap) & (high > low[label] - gap)).all(axis=1)
    # A blob above this share of another's area is not noise [1].
    is_near &= blobs.area_px > 0.08 * blobs.area_px[label]
    is_near[[0, label]] = False
    return bool(is_near.any())


def _whole_person(blobs: Blobs, label: int, shape: tuple[int, ...], frame: int) -> HumanSample | None:
    """Sample of a blob in an image of (H, W), None where it is cut off or no body."""
    left, top, width, height = map(int, blobs.box_px[label])
    rows, columns = shape
    if min(left, top) <= 1 or left + width >= columns - 1 or top + height >= rows - 1:
        return None
    fill = float(blobs.area_px[label]) / (width * height)
    # The share that a standing person fills; streaks and lit rectangles do not.
    if not 0.3 <= fill <= 0.95:
        return None
    inside: Bool = np.asarray(blobs.labels[top : top + height, left : left + width] == label)
    head, foot = _ends(inside) + np.array([left, top])
    # A box of pixels ends half a pixel beyond their centres.
    box = (left - 0.5, top - 0.5, float(width), float(height))
    return HumanSample(box, (float(head[0]), float(head[1])), (float(foot[0]), float(foot[1])), frame)


def _ends(inside: Bool) -> F64:
    """(2, 2) head and foot (u, v) within the box."""
    v, u = np.nonzero(inside)
    points = np.column_stack([u, v]).astype(np.float64)
    centre = points.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((points - centre).T))
    # Variance along a body over that across it from which head and feet are its ends [1].
    if spread[1] < 2.0 * spread[0]:
        return np.stack([centre, centre])
    axis = axes[:, 1]
    if axis[1] <= 0:
        axis = -axis
    low, high = np.quantile((points - centre) @ axis, (0.002, 0.998))
    head = centre + (low - 0.5) * axis
    foot = centre + (high + 0.5) * axis
    return np.stack([head, foot])
