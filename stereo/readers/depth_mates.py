"""Which depth image belongs to which image, by their times."""

from __future__ import annotations

import numpy as np

from calib.types import I64

MAX_APART_S = 0.02
"""The tool of the TUM RGB-D benchmark associates an image and a depth image up to 20 ms apart; a quarter of the frame
period, as for the pairs of two cameras, where that is more."""


def nearest_mates(images: I64, depths: I64) -> I64:
    """Position of each image's depth image, -1 without one: nearest to each other, and near enough.

    Args:
        images, depths: (n,) and (m,) int64 [ns], increasing.
    """
    mates = np.full(len(images), -1)
    if not len(images) or not len(depths):
        return mates
    period = float(np.median(np.diff(images))) if len(images) > 1 else 0.0
    nearest, back = _nearest(images, depths), _nearest(depths, images)
    near = np.abs(images - depths[nearest]) <= max(MAX_APART_S * 1e9, 0.25 * period)
    mutual = near & (back[nearest] == np.arange(len(images)))
    mates[mutual] = nearest[mutual]
    return mates


def _nearest(of: I64, among: I64) -> I64:
    after = np.clip(np.searchsorted(among, of), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    return np.asarray(np.where(np.abs(of - among[before]) <= np.abs(among[after] - of), before, after), dtype=np.int64)


def depth_note(mates: I64, where: str = "") -> list[str]:
    """How many images have no depth image.

    Args:
        where: they were looked for; by their times when empty.
    """
    alone = int((mates < 0).sum())
    where = where or f"within {MAX_APART_S * 1e3:g} ms"
    return [f"{alone} of {len(mates)} images without a depth image {where}, skipped"] if alone else []
