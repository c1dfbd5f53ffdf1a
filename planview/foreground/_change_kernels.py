"""Where colour, activity or what is known of a pixel asks for its depth; tests/reference/foreground.py defines it.

Numba's cache of this file does not notice changes of the other kernel files here: change or touch all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import F32, U8
from planview.foreground._block_kernels import ACTIVITY, BLOCK, N_SCRATCH, load, observed, stage
from planview.foreground._gaussian_kernels import NO_MATCH, WEIGHT, UpdateConstants, match_kind


@njit(cache=True, nogil=True)
def find_changes(lead: F32, image: U8, channels: int, step: int, s: UpdateConstants, out: U8) -> None:
    """255 at every ``step``-th row and column whose leading Gaussian does not match by colour, is not background yet,
    or whose luma keeps changing; 0 elsewhere.

    Args:
        lead: (n_blocks, N_LEAD * BLOCK) leading Gaussians. image: (H, W * channels) uint8. out: (h, w) uint8.
    """
    rows, columns = out.shape
    width = image.shape[1] // channels
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    part = np.empty(BLOCK * channels, np.uint8)
    no_disparity, empty = np.zeros(0, np.float32), np.zeros(0, np.uint8)
    for row in range(rows):
        for start in range(0, columns, BLOCK):
            n = min(BLOCK, columns - start)
            for i in range(n):
                for c in range(channels):
                    part[channels * i + c] = image[step * row, channels * step * (start + i) + c]
            stage(part, no_disparity, empty, empty, 0, n, channels > 1, s, obs)
            for i in range(n):
                pixel = step * (row * width + start + i)
                block, k = pixel // BLOCK, pixel % BLOCK
                kind = match_kind(load(lead[block], k, BLOCK), observed(obs, i), s)
                young = lead[block, WEIGHT * BLOCK + k] <= s.background_weight
                active = lead[block, ACTIVITY * BLOCK + k] > s.active
                out[row, start + i] = 255 if (kind == NO_MATCH) | young | active else 0
