"""Colours of foreground points as small codes: enough to distinguish clothes, too little to make a picture of.

A code is a cell of luma and chroma (YUV). People are compared by histograms of codes, smoothed over neighbouring cells
so that a slightly other light moves little mass (our choice; the cells are as wide as a sensor's noise and the
difference of light within a room leave room for).
"""

from __future__ import annotations

import numpy as np

from calib.types import F32, I32, U8
from planview.foreground.gain import Exposure
from planview.maps._kernels import encode_colours

LUMA_CELLS = 8
CHROMA_EDGES = (-24.0, -8.0, 8.0, 24.0)
"""Edges of the cells of U and V around grey [levels of 255]; noise of grey clothes is below 8."""
CHROMA_CELLS = len(CHROMA_EDGES) + 1
_EDGES = np.array(CHROMA_EDGES, np.float32)
CODES = LUMA_CELLS * CHROMA_CELLS**2
LUMA_SPREAD, CHROMA_SPREAD = 0.75, 0.4
"""Deviation of the smoothing, in cells: light differs by a fifth within a room, chroma hardly."""


def colour_codes(image: U8, pixels: I32, exposure: Exposure) -> U8:
    """Codes of some pixels.

    Args:
        image: (H, W) grey or (H, W, 3) BGR.
        pixels: (N,) int32, row * W + column.
        exposure: of the image; codes are those of the reference exposure.
    Returns:
        (N,) uint8, luma cell * CHROMA_CELLS^2 + U cell * CHROMA_CELLS + V cell.
    """
    codes = np.empty(len(pixels), np.uint8)
    channels = 1 if image.ndim == 2 else image.shape[2]
    flat = np.ascontiguousarray(image).reshape(-1)
    encode_colours(flat, channels, pixels, *exposure, LUMA_CELLS, _EDGES, codes)
    return codes


def smoothing() -> F32:
    """(CODES, CODES) float32 matrix that spreads a histogram of codes over neighbouring cells; rows sum to 1."""

    def spread(n: int, deviation: float) -> F32:
        steps = np.arange(n)
        kernel = np.exp(-0.5 * ((steps[:, None] - steps[None, :]) / deviation) ** 2)
        return np.asarray(kernel / kernel.sum(axis=1, keepdims=True), dtype=np.float32)

    chroma = spread(CHROMA_CELLS, CHROMA_SPREAD)
    return np.kron(spread(LUMA_CELLS, LUMA_SPREAD), np.kron(chroma, chroma))
