"""Regions of foreground that stay together from one frame to the next."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F32, F64, Bool
from planview.foreground.blobs import find_blobs

ROW, LENGTH, WIDTH, AREA, CUT = range(5)
"""Columns of a region: row of the centre of its box, height, width and area [cells], 1 where the border cuts it."""
AREA_MIN = 12
"""Smaller regions are specks [cells]. Our choice."""
THINNEST = 0.2 * 0.75 * math.pi / 4
"""Least area over squared length: people are at least 0.2 times as wide as long, and fill three quarters of their
ellipse. Thinner are poles and their shadows."""
JOINED = 0.1
"""Regions nearer to each other than this share of the larger one's height are one: a person whose belt looks like the
wall behind. Our choice: 17 cm of a person."""
SAME_SIZE, SAME_PLACE = 1.25, 0.3
"""Largest ratio of lengths and least intersection over union of the boxes of one region in two frames. Our choice: at
7 frames per second a walker moves by a third of a width."""
MOVING = 0.05
"""Least share of a region's cells that move, unless that is not known: limbs and edges of a walker do."""


class RegionPairs:
    """Regions of each frame that the frame before had too."""

    def __init__(self) -> None:
        self._before: F64 = np.zeros((0, 4))

    def update(self, mask: F32, moving: Bool | None) -> F64:
        """(N, 5) float64 regions, columns ``ROW`` to ``CUT``.

        Args:
            mask: (R, C) float32 foreground share of each cell.
            moving: (R, C) cells that move; None where that is not known.
        """
        boxes, areas, moved = regions(mask, moving)
        together = _paired(boxes, self._before) & moved
        self._before = boxes
        boxes, areas = boxes[together], areas[together]
        n_rows, n_cols = mask.shape
        left, top, width, height = boxes.T
        sides = left <= 0, left + width >= n_cols
        cut = sides[0] | sides[1] | (top <= 0) | (top + height >= n_rows)
        samples = np.column_stack([top + (height - 1) / 2, height, width, areas, cut])
        # What reaches from side to side is a change of light.
        fits = ~(sides[0] & sides[1]) & (areas >= AREA_MIN) & (areas >= THINNEST * height**2)
        return np.asarray(samples[fits])


def regions(mask: F32, moving: Bool | None) -> tuple[F64, F64, Bool]:
    """Boxes (N, 4) left, top, width, height, areas (N,), and which move, of regions that are joined where near."""
    blobs = find_blobs((mask >= 0.5).astype(np.uint8))
    boxes, areas = blobs.box_px[1:].astype(np.float64), blobs.area_px[1:].astype(np.float64)
    shares = np.ones(len(areas))
    if moving is not None:
        shares = np.bincount(blobs.labels[moving], minlength=len(blobs))[1:] / np.maximum(areas, 1)
    moved = shares * areas
    kept = areas >= AREA_MIN / 3
    boxes, areas, moved = joined(boxes[kept], areas[kept], moved[kept])
    return boxes, areas, np.asarray(moved >= MOVING * areas)


def joined(boxes: F64, areas: F64, moved: F64) -> tuple[F64, F64, F64]:
    """Regions with those near a larger one added to it: its box grows, areas and moving areas add up."""
    order = np.argsort(-areas, kind="stable")
    boxes, areas, moved = boxes[order].copy(), areas[order].copy(), moved[order].copy()
    free = np.ones(len(areas), np.bool_)
    kept = []
    for k in range(len(areas)):
        if not free[k]:
            continue
        free[k] = False
        while True:
            near = free & (_gap(boxes[k], boxes) <= JOINED * boxes[k, 3])
            if not near.any():
                break
            free[near] = False
            members = np.concatenate([boxes[k : k + 1], boxes[near]])
            low, high = members[:, :2].min(axis=0), (members[:, :2] + members[:, 2:]).max(axis=0)
            boxes[k] = *low, *(high - low)
            areas[k] += areas[near].sum()
            moved[k] += moved[near].sum()
        kept.append(k)
    return boxes[kept], areas[kept], moved[kept]


def _gap(box: F64, others: F64) -> F64:
    """(N,) cells between a box and others, 0 where they overlap."""
    low, high = others[:, :2], others[:, :2] + others[:, 2:]
    apart = np.maximum(0.0, np.maximum(low - (box[:2] + box[2:]), box[:2] - high))
    return np.asarray(apart.max(axis=1))


def _paired(boxes: F64, before: F64) -> Bool:
    """(N,) whether a box of about the same size was in about the same place before."""
    if not len(boxes) or not len(before):
        return np.zeros(len(boxes), np.bool_)
    a, b = boxes[:, None], before[None]
    low = np.maximum(a[..., :2], b[..., :2])
    high = np.minimum(a[..., :2] + a[..., 2:], b[..., :2] + b[..., 2:])
    common = np.maximum(0.0, high - low).prod(axis=-1)
    union = a[..., 2:].prod(axis=-1) + b[..., 2:].prod(axis=-1) - common
    ratio = np.abs(np.log(a[..., 3] / b[..., 3]))
    return np.asarray(((common > SAME_PLACE * union) & (ratio < math.log(SAME_SIZE))).any(axis=1))
