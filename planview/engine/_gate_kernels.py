"""Compiled kernels of matching in part; ``tests/reference/gate.py`` defines them in plain numpy."""

import numpy as np
from numba import njit

from calib.types import U8


@njit(cache=True, nogil=True)
def forgive_known(image: U8, background: U8, step: int, levels: int, changed: U8) -> None:
    """Set ``changed`` (h, w) to 0 where samples of an image differ from ``background`` by at most so many levels.

    Args:
        image: (H, W, C) uint8, of which every ``step``-th row and column is a sample. background: (h, w, C) uint8.
    """
    for row in range(changed.shape[0]):
        for col in range(changed.shape[1]):
            alike = True
            for c in range(image.shape[2]):
                apart = np.int64(image[step * row, step * col, c]) - np.int64(background[row, col, c])
                alike = alike and bool(abs(apart) <= levels)
            if alike:
                changed[row, col] = 0


@njit(cache=True, nogil=True)
def remember_known(image: U8, measured: U8, foreground: U8, step: int, background: U8) -> None:
    """Copy samples of an image to ``background`` (h, w, C) where disparity was measured and is not foreground.

    Args:
        image: (H, W, C) uint8. measured, foreground: (H, W) uint8, not zero where they are so.
    """
    for row in range(background.shape[0]):
        for col in range(background.shape[1]):
            r, c = step * row, step * col
            if measured[r, c] and not foreground[r, c]:
                for k in range(background.shape[2]):
                    background[row, col, k] = image[r, c, k]
