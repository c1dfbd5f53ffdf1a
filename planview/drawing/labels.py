"""Text on pictures that stays legible and does not cover other text."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calib.types import F64, U8
from planview.drawing.colours import Rgb, as_bgr

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_PAD_PX = 3
DARK_LUMA = 140.0
"""Text is white on backgrounds darker than this [levels of 255]."""


class Labels:
    """Puts labels into a picture, each where no earlier one is.

    Args:
        picture: (H, W, 3) uint8 BGR, drawn into.
        size: of the text, 1 for 11 px high capitals.
    """

    def __init__(self, picture: U8, size: float = 1.0) -> None:
        self._picture, self._size = picture, 0.45 * size
        self._taken: list[tuple[int, int, int, int]] = []

    def put(self, text: str, at_px: Sequence[float] | F64, background: Rgb | None) -> None:
        """Text whose lower left corner is at a pixel or, where that is taken or outside, as near above as possible.

        Args:
            background: of the box behind the text; None for dark text with a light outline.
        """
        (width, height), base = cv2.getTextSize(text, _FONT, self._size, 1)
        width, height = width + 2 * _PAD_PX, height + base + _PAD_PX
        left = int(np.clip(at_px[0], 0, max(0, self._picture.shape[1] - width)))
        top = int(np.clip(at_px[1] - height, 0, max(0, self._picture.shape[0] - height)))
        for place in [*range(top, -1, -2), *range(top, self._picture.shape[0] - height, 2)]:
            box = left, place, left + width, place + height
            if not any(_overlap(box, other) for other in self._taken):
                break
        else:
            box = left, top, left + width, top + height
        self._taken.append(box)
        self._draw(text, box, box[3] - base, background)

    def _draw(self, text: str, box: tuple[int, int, int, int], baseline: int, background: Rgb | None) -> None:
        at = box[0] + _PAD_PX, baseline
        if background is None:
            cv2.putText(self._picture, text, at, _FONT, self._size, (255, 255, 255), 3, cv2.LINE_AA)
            cv2.putText(self._picture, text, at, _FONT, self._size, (30, 30, 30), 1, cv2.LINE_AA)
            return
        cv2.rectangle(self._picture, box[:2], box[2:], as_bgr(background), -1)
        dark = float(np.dot(background, (0.299, 0.587, 0.114))) < DARK_LUMA + 12
        colour = (255, 255, 255) if dark else (0, 0, 0)
        cv2.putText(self._picture, text, at, _FONT, self._size, colour, 1, cv2.LINE_AA)


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
