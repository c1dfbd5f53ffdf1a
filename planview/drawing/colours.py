"""The colours of people and states, the same in reports, videos, pictures and rerun recordings."""

from __future__ import annotations

import colorsys
from typing import Literal

from planview.trajectories.state import State

Rgb = tuple[int, int, int]
GOLDEN = 0.618034
"""Step around the colour circle from id to id: neighbouring ids differ most."""
LUMA_MAX = 150.0
"""Colours are darkened to this luma, so that they are legible on white paper and on images [levels of 255]."""
GREY: Rgb = (150, 150, 150)
"""Of tentative people."""
TRUTH: Rgb = (20, 20, 20)
ERRORS: dict[str, Rgb] = {
    "lost": (214, 39, 40), "missed": (255, 127, 14), "swapped": (148, 103, 189), "false_track": (23, 140, 160),
}  # fmt: skip
"""Of the significant errors."""
TRIPWIRE: Rgb = (176, 0, 32)
ZONE: Rgb = (160, 127, 0)


def person_rgb(track_id: int, state: State | Literal[""] = "confirmed") -> Rgb:
    """One colour per id; grey while tentative, pale while lost."""
    if state == "tentative":
        return GREY
    red, green, blue = colorsys.hsv_to_rgb(GOLDEN * track_id % 1.0, 0.85, 0.95)
    darker = min(1.0, LUMA_MAX / max(1.0, 255 * (0.299 * red + 0.587 * green + 0.114 * blue)))
    rgb = [255 * darker * channel for channel in (red, green, blue)]
    if state == "lost":
        rgb = [0.55 * channel + 0.45 * 190 for channel in rgb]
    return round(rgb[0]), round(rgb[1]), round(rgb[2])


def as_bgr(rgb: Rgb) -> Rgb:
    """For OpenCV."""
    return rgb[::-1]


def as_hex(rgb: Rgb) -> str:
    """For pages and matplotlib: "#rrggbb"."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def person_hex(track_id: int, state: State | Literal[""] = "confirmed") -> str:
    """``person_rgb`` as "#rrggbb"."""
    return as_hex(person_rgb(track_id, state))
