"""Colours, labels and legends of all pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from calib.images import as_colour
from calib.types import F32, F64, I32, U8

Rgb = tuple[int, int, int]
TRUTH: Rgb = (20, 20, 20)
ERRORS: dict[str, Rgb] = {
    "lost": (214, 39, 40), "missed": (255, 127, 14), "swapped": (148, 103, 189), "transferred": (227, 119, 194),
    "false_track": (23, 140, 160),
}  # fmt: skip
"""Colours of the significant errors."""
TRIPWIRE: Rgb = (176, 0, 32)
ZONE: Rgb = (160, 127, 0)


def as_bgr(rgb: Rgb) -> Rgb:
    """Colour for OpenCV."""
    return rgb[::-1]


def as_hex(rgb: Rgb) -> str:
    """Colour for pages and matplotlib: "#rrggbb"."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def paint_line(picture: U8, pixels: I32, colour: Rgb, width: int = 2, closed: bool = False) -> None:
    """Draw a line through (N, 2) pixels, or around an area."""
    cv2.polylines(picture, [pixels], closed, as_bgr(colour), width, cv2.LINE_AA)


def disparity_colours(disparity: F32, smallest_px: float, largest_px: float) -> U8:
    """(H, W, 3) uint8 BGR of (H, W) disparity [px]: near red, far blue, unknown (NaN) black."""
    scaled = (np.nan_to_num(disparity) - smallest_px) * (255.0 / (largest_px - smallest_px))
    picture = cv2.applyColorMap(np.clip(scaled, 0, 255).astype(np.uint8), cv2.COLORMAP_TURBO)
    return np.where(np.isnan(disparity)[..., None], 0, picture).astype(np.uint8)


FONT = cv2.FONT_HERSHEY_SIMPLEX
_PAD_PX = 3
WHITE_TEXT_BELOW = 152.0
"""Text is white on backgrounds darker than this grey level, else black."""


class Labels:
    """Puts labels into an (H, W, 3) uint8 BGR picture, each where no earlier one is; size 1 is 11 px high capitals."""

    def __init__(self, picture: U8, size: float = 1.0) -> None:
        self._picture = picture
        self._size = 0.45 * size
        self._boxes: list[tuple[int, int, int, int]] = []

    def put(self, text: str, at_px: Sequence[float] | F64, background: Rgb) -> None:
        """Text in a box whose lower left corner is at a pixel or, where that is occupied or outside, as near above as
        possible."""
        (text_width, text_height), base = cv2.getTextSize(text, FONT, self._size, 1)
        width = text_width + 2 * _PAD_PX
        height = text_height + base + _PAD_PX
        free_columns = max(0, self._picture.shape[1] - width)
        free_rows = max(0, self._picture.shape[0] - height)
        left = int(np.clip(at_px[0], 0, free_columns))
        nearest_top = int(np.clip(at_px[1] - height, 0, free_rows))
        top = self._free_top(left, nearest_top, width, height)
        right = left + width
        bottom = top + height
        self._boxes.append((left, top, right, bottom))
        cv2.rectangle(self._picture, (left, top), (right, bottom), as_bgr(background), cv2.FILLED)
        grey_level = np.dot(background, (0.299, 0.587, 0.114))
        colour = (255, 255, 255) if grey_level < WHITE_TEXT_BELOW else (0, 0, 0)
        at = (left + _PAD_PX, bottom - base)
        cv2.putText(self._picture, text, at, FONT, self._size, colour, 1, cv2.LINE_AA)

    def _free_top(self, left: int, top: int, width: int, height: int) -> int:
        """The row nearest above, else below, at which a box covers no earlier one; the same row where there is none."""
        above = range(top, -1, -2)
        below = range(top, self._picture.shape[0] - height, 2)
        rows: list[int] = [*above, *below]
        for row in rows:
            if not any(_overlap((left, row, left + width, row + height), box) for box in self._boxes):
                return row
        return top


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


STRIP_PX = 26
_SIZE = 0.42
_INK = (40, 40, 40)
_PAPER = (255, 255, 255)


class Entry(NamedTuple):
    """A colour and its meaning."""

    colour: Rgb
    text: str


def with_legend(picture: U8, entries: Sequence[Entry]) -> U8:
    """(h, W, 3) uint8 BGR: the (H, W[, 3]) picture, and below it squares of colour with their meaning."""
    strip = _strip(picture)
    x = 8
    for colour, text in entries:
        width = _width(text)
        if x > 8 and x + 20 + width > strip.shape[1]:
            strip = np.vstack([strip, _strip(picture)])
            x = 8
        top = strip.shape[0] - STRIP_PX
        cv2.rectangle(strip, (x, top + 6), (x + 13, top + 19), as_bgr(colour), -1)
        _write(strip, text, (x + 19, top + 17))
        x += 19 + width + 16
    return np.vstack([as_colour(picture), strip])


def _strip(picture: U8) -> U8:
    return np.full((STRIP_PX, picture.shape[1], 3), _PAPER, dtype=np.uint8)


def _write(strip: U8, text: str, at: tuple[int, int]) -> None:
    cv2.putText(strip, text, at, FONT, _SIZE, _INK, 1, cv2.LINE_AA)


def _width(text: str) -> int:
    return int(cv2.getTextSize(text, FONT, _SIZE, 1)[0][0])


def page_of(package: str, template: str, **values: Any) -> str:
    """A template of a package, which may include style.css.j2, filled in; everything is escaped."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    loader = ChoiceLoader([PackageLoader(package, "."), PackageLoader("planview.drawing", ".")])
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return environment.get_template(template).render(**values)
