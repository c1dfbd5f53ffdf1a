"""What the last update of the joint tracker looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.types import F32, U8
from planview.tracking.base import Drawing, TrackerDebug
from planview.tracking.body import TORSO
from planview.tracking.joint.explanation import Owned
from planview.tracking.joint.person import Person

CIRCLE = np.linspace(0.0, 2.0 * math.pi, 25)


TEMPLATE_CELLS, CELL_M = 16, 0.05
"""A template is 2 W_avg = 0.8 m wide (Harville 2002, section 4)."""


def draw(people: Sequence[Person], seen: Sequence[tuple[tuple[int, ...], Owned, F32]]) -> TrackerDebug:
    """Circles of bodies labelled with existence and visible share, an image of the owners of all pixels, and the
    templates of everybody.

    Args:
        seen: of each view the image's shape, the owners of its pixels, and their points (``points_of``).
    """
    circle = TORSO.torso_radius_m * np.stack([np.cos(CIRCLE), np.sin(CIRCLE)], axis=1)
    strips = tuple(np.asarray(circle + q.at_m, dtype=np.float32) for q in people)
    labels = tuple(f"{q.track_id}: existence {q.existence:.2f}, visible {q.share:.2f}" for q in people)
    grey = np.full(len(people) + 1, 40, np.uint8)
    grey[1:] = [80 + (37 * q.track_id) % 176 for q in people]
    tiles: dict[str, F32 | U8] = {}
    for k, (shape, of, _) in enumerate(seen):
        tile: U8 = np.zeros(shape, np.uint8)
        tile.reshape(-1)[of.pixels] = grey[np.minimum(of.owner + 1, len(people))]
        tiles[f"owners/{k}"] = tile
    for i, q in enumerate(people):
        height, occupancy = templates_of(i, q, seen)
        tiles[f"template/{q.track_id}/height"], tiles[f"template/{q.track_id}/occupancy"] = height, occupancy
    return TrackerDebug((Drawing("bodies", "floor", strips, labels),), tiles)


def templates_of(i: int, q: Person, seen: Sequence[tuple[tuple[int, ...], Owned, F32]]) -> tuple[F32, F32]:
    """T_H and T_O, (TEMPLATE_CELLS, TEMPLATE_CELLS) float32 [m] and [patches]: the pixels that person ``i`` owns, seen
    from above; rows go along x."""
    height, occupancy = np.zeros((2, TEMPLATE_CELLS, TEMPLATE_CELLS), np.float32)
    for _, o, points in seen:
        mine = o.owner == i
        cells = np.floor((points[:2, mine].T - q.at_m) / CELL_M).astype(np.int64) + TEMPLATE_CELLS // 2
        inside = ((cells >= 0) & (cells < TEMPLATE_CELLS)).all(axis=1)
        at = cells[inside, 0], cells[inside, 1]
        np.maximum.at(height, at, points[2, mine][inside])
        np.add.at(occupancy, at, o.patches[mine][inside])
    return height, occupancy
