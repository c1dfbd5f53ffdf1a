"""What the colours of a picture mean, in a strip below it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from calib.images import as_colour
from calib.types import U8
from planview.drawing.colours import Rgb, as_bgr

STRIP_PX = 26
_FONT, _SIZE, _INK, _PAPER = cv2.FONT_HERSHEY_SIMPLEX, 0.42, (40, 40, 40), (255, 255, 255)


class Entry(NamedTuple):
    """A colour and its meaning."""

    colour: Rgb
    text: str


def with_legend(picture: U8, entries: Sequence[Entry]) -> U8:
    """(h, W, 3) uint8 BGR: the picture, and below it squares of colour with their meaning.

    Args:
        picture: (H, W[, 3]) uint8 BGR.
    """
    strip, x = _strip(picture), 8
    for colour, text in entries:
        width = _width(text)
        if x > 8 and x + 20 + width > strip.shape[1]:
            strip, x = np.vstack([strip, _strip(picture)]), 8
        top = strip.shape[0] - STRIP_PX
        cv2.rectangle(strip, (x, top + 6), (x + 13, top + 19), as_bgr(colour), -1)
        cv2.putText(strip, text, (x + 19, top + 17), _FONT, _SIZE, _INK, 1, cv2.LINE_AA)
        x += 19 + width + 16
    return np.vstack([as_colour(picture), strip])


def with_colour_bar(picture: U8, colormap: int, low: str, high: str, entries: Sequence[Entry] = ()) -> U8:
    """The picture, and below it the scale of its colours, then other colours' meaning.

    Args:
        colormap: of OpenCV.
        low, high: the ends of the scale in words.
    """
    strip = _strip(picture)
    start = 14 + _width(low)
    stop = max(start + 40, min(strip.shape[1] - 14 - _width(high), start + 256))
    levels = np.tile(np.linspace(0, 255, stop - start).astype(np.uint8), (13, 1))
    shown = np.asarray(cv2.applyColorMap(levels, colormap), dtype=np.uint8)[:, : max(0, strip.shape[1] - start)]
    strip[6:19, start : start + shown.shape[1]] = shown
    for text, x in ((low, 8), (high, stop + 6)):
        cv2.putText(strip, text, (x, 17), _FONT, _SIZE, _INK, 1, cv2.LINE_AA)
    whole = np.vstack([as_colour(picture), strip])
    return with_legend(whole, entries) if entries else whole


def _strip(picture: U8) -> U8:
    return np.full((STRIP_PX, picture.shape[1], 3), _PAPER, dtype=np.uint8)


def _width(text: str) -> int:
    return int(cv2.getTextSize(text, _FONT, _SIZE, 1)[0][0])
