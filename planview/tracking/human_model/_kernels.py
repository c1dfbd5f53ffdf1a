"""Compiled kernels that look for newcomers among the hulls of the model map."""

from __future__ import annotations

from numba import njit

from calib.types import F32, F64, I32, Bool

TILE_PX = 16
"""Side of the squares in which newcomers are looked for first [px]."""


@njit(cache=True, nogil=True, error_model="numpy")
def promising(total: F64, bands: I32, scale: F32, least: float, found: I32, wanted: Bool) -> int:
    """Fill the places whose hull may gain ``least``, and the tiles in which these are; the number of places.

    ``total``: integral image of the tiles' gains; ``bands``, ``scale``: see ``hull_scores``.
    """
    n = 0
    for i in range(len(bands)):
        left, top, right, down = bands[i, 0, 0], bands[i, 0, 1], bands[i, 0, 2], bands[i, -1, 3]
        for k in range(1, bands.shape[1]):
            left, right = min(left, bands[i, k, 0]), max(right, bands[i, k, 2])
        c0, r0, c1, r1 = left // TILE_PX, top // TILE_PX, (right - 1) // TILE_PX + 1, (down - 1) // TILE_PX + 1
        empty = right <= left or down <= top
        if not empty and scale[i] * (total[r1, c1] - total[r0, c1] - total[r1, c0] + total[r0, c0]) >= least:
            found[n], n = i, n + 1
            wanted[r0:r1, c0:c1] = True
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def hull_scores(total: F64, bands: I32, places: I32, scores: F32) -> None:
    """What people at some places of the model map would gain: the residual's sum in the bands of their hulls.

    ``total`` (H + 1, W + 1): the residual's integral image; ``bands`` (N, K, 4) left, top, right, bottom, clipped.
    """
    for j, i in enumerate(places):
        scores[j] = 0.0
        for k in range(bands.shape[1]):
            left, top, right, down = bands[i, k]
            if right > left and down > top:
                scores[j] += total[down, right] - total[top, right] - total[down, left] + total[top, left]
