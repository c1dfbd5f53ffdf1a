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


def draw(people: Sequence[Person], seen: Sequence[tuple[tuple[int, ...], Owned]]) -> TrackerDebug:
    """Circles of bodies labelled with existence and visible share, and an image of the owners of all pixels.

    Args:
        seen: of each view the image's shape, and the owners of its pixels.
    """
    circle = TORSO.torso_radius_m * np.stack([np.cos(CIRCLE), np.sin(CIRCLE)], axis=1)
    strips = tuple(np.asarray(circle + q.at_m, dtype=np.float32) for q in people)
    labels = tuple(f"{q.track_id}: existence {q.existence:.2f}, visible {q.share:.2f}" for q in people)
    grey = np.full(len(people) + 1, 40, np.uint8)
    grey[1:] = [80 + (37 * q.track_id) % 176 for q in people]
    tiles: dict[str, F32 | U8] = {}
    for k, (shape, of) in enumerate(seen):
        tile: U8 = np.zeros(shape, np.uint8)
        tile.reshape(-1)[of.pixels] = grey[np.minimum(of.owner + 1, len(people))]
        tiles[f"owners/{k}"] = tile
    return TrackerDebug((Drawing("bodies", "floor", strips, labels),), tiles)
