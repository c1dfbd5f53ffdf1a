"""Whole people in foreground masks, apart from others, and the paths of those who walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.people.samples import HumanSample
from calib.types import F64, U8, Bool
from planview.foreground.ghosts import Blobs, find_blobs

MIN_SIZE = 0.06
"""A person is at least this share of the image's height [1]: smaller ones add nothing about a camera."""


@dataclass(eq=False)
class BodyPath:
    """Blobs of one walker."""

    samples: list[HumanSample]
    last_frame: int

    @property
    def walks(self) -> bool:
        """Whether it is of a person who goes somewhere."""
        boxes = np.array([s.box_px for s in self.samples])
        middles = boxes[:, :2] + boxes[:, 2:] / 2
        size = float(np.median([s.diagonal_px for s in self.samples]))
        # What moves by less than half a body, or is met in fewer frames, is furniture, light or a ghost.
        return len(self.samples) >= 4 and float(np.hypot(*np.ptp(middles, axis=0))) >= 0.5 * size


def bodies_of(mask: U8, frame: int) -> list[HumanSample]:
    """Whole people apart from others in a (H, W) foreground mask."""
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((7, 5), np.uint8))
    blobs = find_blobs(np.asarray(closed, dtype=np.uint8))
    large = [i for i in range(1, len(blobs)) if max(blobs.box_px[i][2:]) >= MIN_SIZE * mask.shape[0]]
    samples = (_whole_person(blobs, i, mask.shape, frame) for i in large if not _crowded(blobs, i))
    return [sample for sample in samples if sample is not None]


def continue_paths(paths: list[BodyPath], bodies: Sequence[HumanSample], frame: int) -> None:
    """Append every body to the path of the frame before that it overlaps most, or begin one."""
    open_paths = [path for path in paths if 0 < frame - path.last_frame <= 2]
    for body in bodies:
        overlaps, (a, b, w, h) = [], body.box_px
        for c, d, v, g in (path.samples[-1].box_px for path in open_paths):
            common = max(0.0, min(a + w, c + v) - max(a, c)) * max(0.0, min(b + h, d + g) - max(b, d))
            overlaps.append(common / (w * h + v * g - common))
        best = int(np.argmax(overlaps)) if overlaps else -1
        # Boxes of one walker in frames that follow each other overlap by this part of their union [1].
        if best >= 0 and overlaps[best] >= 0.3:
            path = open_paths.pop(best)
            path.samples.append(body)
            path.last_frame = frame
        else:
            paths.append(BodyPath([body], frame))


def _crowded(blobs: Blobs, label: int) -> bool:
    """Whether another blob that is not noise is near the box."""
    low = blobs.box_px[:, :2]
    high = blobs.box_px[:, :2] + blobs.box_px[:, 2:]
    # Nearer blobs may be pieces of one person, or hide each other [px]; above and below, within this share of the
    # body's height [1]: bodies break at belt and collar.
    gap = np.array([4.0, max(4.0, 0.35 * float(blobs.box_px[label][3]))])
    near = ((low < high[label] + gap) & (high > low[label] - gap)).all(axis=1)
    # A blob above this share of another's area is not noise [1].
    near &= blobs.area_px > 0.08 * blobs.area_px[label]
    near[[0, label]] = False
    return bool(near.any())


def _whole_person(blobs: Blobs, label: int, shape: tuple[int, ...], frame: int) -> HumanSample | None:
    """Sample of a blob in an image of (H, W), None where it is cut off or no body."""
    left, top, width, height = (int(v) for v in blobs.box_px[label])
    rows, columns = shape
    cut = left <= 1 or top <= 1 or left + width >= columns - 1 or top + height >= rows - 1
    fill = float(blobs.area_px[label]) / (width * height)
    if cut or not 0.3 <= fill <= 0.95:  # the share that a standing person fills; streaks and lit rectangles do not
        return None
    inside: Bool = np.asarray(blobs.labels[top : top + height, left : left + width] == label)
    ends = _ends(inside)
    (u, v), (foot_u, foot_v) = (ends + np.array([left, top])).tolist()
    # A box of pixels ends half a pixel beyond their centres.
    return HumanSample((left - 0.5, top - 0.5, float(width), float(height)), (u, v), (foot_u, foot_v), frame)


def _ends(inside: Bool) -> F64:
    """(2, 2) head and foot (u, v) within the box."""
    v, u = np.nonzero(inside)
    points = np.column_stack([u, v]).astype(np.float64)
    centre = points.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((points - centre).T))
    # Variance along a body over that across it from which head and feet are its ends [1].
    if spread[1] < 2.0 * spread[0]:
        return np.stack([centre, centre])
    axis = axes[:, 1] if axes[1, 1] > 0 else -axes[:, 1]
    along = (points - centre) @ axis
    low, high = np.quantile(along, (0.002, 0.998))
    return np.stack([centre + (low - 0.5) * axis, centre + (high + 0.5) * axis])
