"""Images of more than 8 bits: their true depth, found from the data, and their 8 most significant bits."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calib.types import U8, AnyArray

DEPTHS = (8, 10, 12, 14, 16)
"""Bits that sensors give."""
FRAMES = 5
"""Frames of each camera in which the largest value is looked for (our choice)."""


def true_bits(images: Iterable[AnyArray]) -> int | None:
    """Bits that the values of 16-bit images use.

    Values that fill the upper bits (a 12-bit sensor's times 16) count as 16: their scale is that of 16 bits.

    Args:
        images: several frames, since one may be dark.
    Returns:
        The smallest of ``DEPTHS`` that holds the largest value; None when no image has more than 8 bits per value.
    """
    largest = [int(image.max()) for image in images if image.dtype == np.uint16 and image.size]
    if not largest:
        return None
    return next(bits for bits in DEPTHS if max(largest) < 1 << bits)


def to_8_bits(image: AnyArray, bits: int | None) -> U8:
    """The image with 8 bits per value.

    Args:
        image: uint8 as it is; uint16 with values of ``bits`` bits, larger ones are clipped.
    """
    if image.dtype == np.uint8:
        return np.asarray(image, dtype=np.uint8)
    shifted = image >> max(0, (bits or 16) - 8)
    return np.asarray(np.minimum(shifted, 255), dtype=np.uint8)


def bits_note(bits: int | None) -> tuple[str, ...]:
    """What is said once about such images."""
    if bits is None:
        return ()
    return (f"images of 16 bits whose values use {bits}: their upper 8 bits are taken",)
