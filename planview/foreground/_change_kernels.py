"""Where colour, activity or what is known of a pixel asks for its depth; tests/reference/foreground.py defines it.

Numba's cache of this file does not notice changes of the other kernel files here: change or touch all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import F32, U8
from planview.foreground._block_kernels import ACTIVITY, BLOCK, KIND_LEADER, N_SCRATCH, stage
from planview.foreground._gaussian_kernels import NO_MATCH, WEIGHT, UpdateConstants
from planview.foreground._leader_kernels import match_colours


@njit(cache=True, nogil=True)
def find_changes(lead: F32, image: U8, channels: int, step: int, s: UpdateConstants, out: U8) -> None:
    """255 at every ``step``-th row and column whose leading Gaussian does not match by colour, is not background yet,
    or whose luma keeps changing; 0 elsewhere.

    Args:
        lead: (n_blocks, N_LEAD * BLOCK) leading Gaussians. image: (H, W * channels) uint8. out: (h, w) uint8.
    """
    rows, columns = out.shape
    width, flat = image.shape[1] // channels, image.reshape(-1)
    n_pixels = image.shape[0] * width
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    no_disparity, empty = np.zeros(0, np.float32), np.zeros(0, np.uint8)
    for row in range(rows):
        first, column = step * row * width, 0
        for block in range(first // BLOCK, (first + width - 1) // BLOCK + 1):
            start = block * BLOCK
            # All of a block, on vector registers, is faster than a part of it.
            stage(flat, no_disparity, empty, empty, start, min(BLOCK, n_pixels - start), channels > 1, s, obs)
            leaders = lead[block]
            match_colours(leaders, obs, s)
            while column < columns and first + step * column < start + BLOCK:
                i = first + step * column - start
                young = leaders[WEIGHT * BLOCK + i] <= s.background_weight
                active = leaders[ACTIVITY * BLOCK + i] > s.active
                out[row, column] = 255 if (obs[KIND_LEADER * BLOCK + i] == NO_MATCH) | young | active else 0
                column += 1
