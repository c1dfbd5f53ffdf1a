"""Colours, labels and legends of all pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from calib.images import as_colour
from calib.types import F32, F64, U8

Rgb = tuple[int, int, int]
TRUTH: Rgb = (20, 20, 20)
ERRORS: dict[str, Rgb] = {
    "lost": (214, 39, 40), "missed": (255, 127, 14), "swapped": (148, 103, 189), "transferred": (227, 119, 194),
    "false_track": (23, 140, 160),
}  # fmt: skip
"""Of the significant errors."""
TRIPWIRE: Rgb = (176, 0, 32)
ZONE: Rgb = (160, 127, 0)


def as_bgr(rgb: Rgb) -> Rgb:
    """For OpenCV."""
    return rgb[::-1]


def as_hex(rgb: Rgb) -> str:
    """For pages and matplotlib: "#rrggbb"."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def disparity_colours(disparity: F32, smallest_px: float, largest_px: float) -> U8:
    """(H, W, 3) uint8 BGR of (H, W) disparity [px]: near red, far blue, unknown (NaN) black."""
    scaled = (np.nan_to_num(disparity) - smallest_px) * (255.0 / (largest_px - smallest_px))
    picture = cv2.applyColorMap(np.clip(scaled, 0, 255).astype(np.uint8), cv2.COLORMAP_TURBO)
    return np.where(np.isnan(disparity)[..., None], 0, picture).astype(np.uint8)


FONT = cv2.FONT_HERSHEY_SIMPLEX
_PAD_PX = 3


class Labels:
    """Puts labels into an (H, W, 3) uint8 BGR picture, each where no earlier one is; size 1 is 11 px high capitals."""

    def __init__(self, picture: U8, size: float = 1.0) -> None:
        self._picture, self._size = picture, 0.45 * size
        self._taken: list[tuple[int, int, int, int]] = []

    def put(self, text: str, at_px: Sequence[float] | F64, background: Rgb) -> None:
        """Text in a box whose lower left corner is at a pixel or, where that is occupied or outside, as near above as
        possible."""
        (width, height), base = cv2.getTextSize(text, FONT, self._size, 1)
        width, height = width + 2 * _PAD_PX, height + base + _PAD_PX
        left = int(np.clip(at_px[0], 0, max(0, self._picture.shape[1] - width)))
        top = int(np.clip(at_px[1] - height, 0, max(0, self._picture.shape[0] - height)))
        for place in [*range(top, -1, -2), *range(top, self._picture.shape[0] - height, 2)]:
            box = a = left, place, left + width, place + height
            if not any(a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for b in self._taken):
                break
        else:
            box = left, top, left + width, top + height
        self._taken.append(box)
        at = box[0] + _PAD_PX, box[3] - base
        cv2.rectangle(self._picture, box[:2], box[2:], as_bgr(background), -1)
        # Text is white on backgrounds darker than this [levels of 255].
        dark = float(np.dot(background, (0.299, 0.587, 0.114))) < 152.0
        colour = (255, 255, 255) if dark else (0, 0, 0)
        cv2.putText(self._picture, text, at, FONT, self._size, colour, 1, cv2.LINE_AA)


STRIP_PX = 26
_SIZE, _INK, _PAPER = 0.42, (40, 40, 40), (255, 255, 255)


class Entry(NamedTuple):
    """A colour and its meaning."""

    colour: Rgb
    text: str


def with_legend(picture: U8, entries: Sequence[Entry]) -> U8:
    """(h, W, 3) uint8 BGR: the (H, W[, 3]) picture, and below it squares of colour with their meaning."""
    strip, x = _strip(picture), 8
    for colour, text in entries:
        width = _width(text)
        if x > 8 and x + 20 + width > strip.shape[1]:
            strip, x = np.vstack([strip, _strip(picture)]), 8
        top = strip.shape[0] - STRIP_PX
        cv2.rectangle(strip, (x, top + 6), (x + 13, top + 19), as_bgr(colour), -1)
        cv2.putText(strip, text, (x + 19, top + 17), FONT, _SIZE, _INK, 1, cv2.LINE_AA)
        x += 19 + width + 16
    return np.vstack([as_colour(picture), strip])


def with_colour_bar(picture: U8, colormap: int, low: str, high: str, entries: Sequence[Entry] = ()) -> U8:
    """The picture, and below it the scale of OpenCV's colormap with its ends in words, then other colours' meaning."""
    strip = _strip(picture)
    start = 14 + _width(low)
    stop = max(start + 40, min(strip.shape[1] - 14 - _width(high), start + 256))
    levels = np.tile(np.linspace(0, 255, stop - start).astype(np.uint8), (13, 1))
    shown = np.asarray(cv2.applyColorMap(levels, colormap), dtype=np.uint8)[:, : max(0, strip.shape[1] - start)]
    strip[6:19, start : start + shown.shape[1]] = shown
    for text, x in ((low, 8), (high, stop + 6)):
        cv2.putText(strip, text, (x, 17), FONT, _SIZE, _INK, 1, cv2.LINE_AA)
    whole = np.vstack([as_colour(picture), strip])
    return with_legend(whole, entries) if entries else whole


def _strip(picture: U8) -> U8:
    return np.full((STRIP_PX, picture.shape[1], 3), _PAPER, dtype=np.uint8)


def _width(text: str) -> int:
    return int(cv2.getTextSize(text, FONT, _SIZE, 1)[0][0])


def page_of(package: str, template: str, **values: Any) -> str:
    """A template of a package, which may include style.css.j2, filled in; everything is escaped."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    loader = ChoiceLoader([PackageLoader(package, "."), PackageLoader("planview.drawing", ".")])
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return environment.get_template(template).render(**values)
