"""Regions of foreground that stay together from one frame to the next."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F32, F64, I64, Bool
from planview.foreground.blobs import find_blobs
from planview.tracking.ellipse_particle._region_kernels import region_sums

ROW, LENGTH, WIDTH, AREA, CUT, MAJOR, MINOR, LEAN, TRACK, TIME_S = range(10)
"""Columns of a region: row of the centre of its box, height, width and area [cells], 1 where the border cuts it; axes
of the ellipse with its second moments [cells], and cosine of twice the long one's angle from the rows' direction;
number of the track of regions that it continues, and time of its frame [s]."""
AREA_MIN = 12
"""Smaller regions are specks [cells]. Our choice."""
THINNEST = 0.2 * 0.75 * math.pi / 4
"""Least area over squared length: people are at least 0.2 times as wide as long, and fill three quarters of their
ellipse. Thinner are poles and their shadows."""
JOINED = 0.1
"""Regions above one another and nearer to each other than this share of the larger one's height are one: a person whose
belt looks like the wall behind. Our choice: 17 cm of a person."""
BESIDE = 0.03
"""The same of regions beside one another, unless one is a piece: people who walk side by side leave a gap, and a body
has none upwards. Our choice: 5 cm of a person."""
PIECE = 0.3
"""A region of less than this share of the area of one beside it is a piece of that: an arm. Our choice."""
SAME_SIZE, SAME_PLACE = 1.25, 0.3
"""Largest ratio of lengths and least intersection over union of the boxes of one region in two frames. Our choice: at
7 frames per second a walker moves by a third of a width."""
MOVING = 0.05
"""Least share of a region's cells that move, unless that is not known: limbs and edges of a walker do."""


class RegionPairs:
    """Regions of each frame that the frame before had too."""

    def __init__(self) -> None:
        self._before: F64 = np.zeros((0, 4))
        self._tracks: I64 = np.zeros(0, np.int64)
        self._next = 0

    def update(self, mask: F32, time_s: float, moving: Bool | None, beside: float = BESIDE) -> F64:
        """(N, 10) float64 regions, columns ``ROW`` to ``TIME_S``.

        Args:
            mask: (R, C) float32 foreground share of each cell.
            time_s: of the frame [s].
            moving: (R, C) cells that move; None where that is not known.
            beside: largest gap between regions side by side that are one, as a share of the larger one's height.
        """
        boxes, sums, moved = regions(mask, moving, beside)
        before = _continued(boxes, self._before)
        tracks = self._continue_tracks(before)
        self._before, self._tracks = boxes, tracks
        together = (before >= 0) & moved
        boxes, sums, tracks = boxes[together], sums[together], tracks[together]
        areas = sums[:, 0]
        n_rows, n_cols = mask.shape
        left, top, width, height = boxes.T
        sides = left <= 0, left + width >= n_cols
        cut = sides[0] | sides[1] | (top <= 0) | (top + height >= n_rows)
        times = np.full(len(boxes), time_s)
        samples = np.column_stack([top + (height - 1) / 2, height, width, areas, cut, axes_of(sums), tracks, times])
        # What reaches from side to side is a change of light.
        fits = ~(sides[0] & sides[1]) & (areas >= AREA_MIN) & (areas >= THINNEST * height**2)
        return np.asarray(samples[fits])

    def _continue_tracks(self, before: I64) -> I64:
        """Track numbers of regions that continue those of the frame before (N,), new ones where that is -1."""
        tracks = np.concatenate([self._tracks, [-1]])[before]
        new = before < 0
        tracks[new] = self._next + np.arange(new.sum())
        self._next += int(new.sum())
        return np.asarray(tracks, dtype=np.int64)


def in_one_box(boxes: F64, cell: F64, others: F64) -> Bool:
    """(M,) which of the others (M, 2) are in the same one of the boxes (N, 4) as a cell (2,): x, y."""
    low, size = np.split(boxes, 2, axis=1)
    places = np.concatenate([cell[None], others])[:, None]
    inside: Bool = np.all((places >= low - 1) & (places <= low + size), axis=2)
    return np.asarray((inside[0] & inside[1:]).any(axis=1))


def regions(mask: F32, moving: Bool | None, beside: float = BESIDE) -> tuple[F64, F64, Bool]:
    """Boxes (N, 4) left, top, width, height, sums (N, 6), and which move, of regions that are joined where near.

    The sums are over cells: their number, x, y, x^2, x y, y^2.
    """
    blobs = find_blobs((mask >= 0.5).astype(np.uint8))
    boxes, count = blobs.box_px[1:].astype(np.float64), len(blobs)
    sums, moved = np.zeros((count, 6)), np.zeros(count)
    region_sums(blobs.labels, np.zeros((0, 0), np.bool_) if moving is None else moving, sums, moved)
    sums, moved = sums[1:], (sums[1:, 0] if moving is None else moved[1:])
    kept = sums[:, 0] >= AREA_MIN / 3
    boxes, sums, moved = joined(boxes[kept], sums[kept], moved[kept], beside)
    return boxes, sums, np.asarray(moved >= MOVING * sums[:, 0])


def joined(boxes: F64, sums: F64, moved: F64, beside: float) -> tuple[F64, F64, F64]:
    """Regions with those near a larger one added to it: its box grows, sums and moving areas add up."""
    order = np.argsort(-sums[:, 0], kind="stable")
    boxes, sums, moved = boxes[order].copy(), sums[order].copy(), moved[order].copy()
    free = np.ones(len(sums), np.bool_)
    kept = []
    for k in range(len(sums)):
        if not free[k]:
            continue
        free[k] = False
        while True:
            aside, above = _gaps(boxes[k], boxes).T
            wide = np.where(sums[:, 0] < PIECE * sums[k, 0], JOINED, beside)
            near = free & (aside <= wide * boxes[k, 3]) & (above <= JOINED * boxes[k, 3])
            if not near.any():
                break
            free[near] = False
            members = np.concatenate([boxes[k : k + 1], boxes[near]])
            low, high = members[:, :2].min(axis=0), (members[:, :2] + members[:, 2:]).max(axis=0)
            boxes[k] = *low, *(high - low)
            sums[k] += sums[near].sum(axis=0)
            moved[k] += moved[near].sum()
        kept.append(k)
    return boxes[kept], sums[kept], moved[kept]


def axes_of(sums: F64) -> F64:
    """(N, 3) columns ``MAJOR``, ``MINOR``, ``LEAN`` of regions with sums (N, 6) over their cells."""
    x, y, xx, xy, yy = (sums[:, 1:] / sums[:, :1]).T
    # A cell is a square of its own: its second moments are 1/12.
    xx, xy, yy = xx - x * x + 1 / 12, xy - x * y, yy - y * y + 1 / 12
    half = np.hypot((yy - xx) / 2, xy)
    mean = (xx + yy) / 2
    lean = (yy - xx) / 2 / np.maximum(half, 1e-9)
    return np.column_stack([4 * np.sqrt(mean + half), 4 * np.sqrt(np.maximum(mean - half, 1 / 12)), lean])


def _gaps(box: F64, others: F64) -> F64:
    """(N, 2) cells across and down between a box and others, 0 where they overlap."""
    low, high = others[:, :2], others[:, :2] + others[:, 2:]
    return np.asarray(np.maximum(0.0, np.maximum(low - (box[:2] + box[2:]), box[:2] - high)))


def _continued(boxes: F64, before: F64) -> I64:
    """(N,) which of the boxes before (M, 4) a box continues: one of about its size and place, -1 where none is."""
    if not len(boxes) or not len(before):
        return np.full(len(boxes), -1)
    a, b = boxes[:, None], before[None]
    low = np.maximum(a[..., :2], b[..., :2])
    high = np.minimum(a[..., :2] + a[..., 2:], b[..., :2] + b[..., 2:])
    common = np.maximum(0.0, high - low).prod(axis=-1)
    union = a[..., 2:].prod(axis=-1) + b[..., 2:].prod(axis=-1) - common
    is_alike = np.abs(np.log(a[..., 3] / b[..., 3])) < math.log(SAME_SIZE)
    overlap = np.where(is_alike, common / union, 0.0)
    best = overlap.argmax(axis=1)
    return np.where(overlap[np.arange(len(boxes)), best] > SAME_PLACE, best, -1)
