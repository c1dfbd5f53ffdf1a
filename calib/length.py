"""Lengths and image sizes as text: 24.23mm, 2.5cm, 0.1m, 1in; 1280x720."""

from __future__ import annotations

import math
import re

from calib.errors import InputError

UNITS_M: dict[str, float] = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
_LENGTH = re.compile(r"\s*([0-9.,eE+-]*?)\s*([a-zA-Zµ]+)\s*")


def parse_length(text: str, what: str = "length") -> float:
    """A positive length in metres.

    Args:
        text: a number with its unit; a unit alone means one of it.
        what: name of the option, for the message.
    Raises:
        InputError: no unit, an unknown one, or no positive finite number.
    """
    match = _LENGTH.fullmatch(text.replace("µ", "u"))
    known = ", ".join(UNITS_M)
    if match is None or match[2].lower() not in UNITS_M:
        raise InputError(f"{what}: expected a length with its unit ({known}), e.g. 24.23mm, found {text!r}")
    try:
        value = float(match[1]) if match[1] else 1.0
    except ValueError:
        raise InputError(f"{what}: expected a length such as 24.23mm, found {text!r}") from None
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{what}: expected a positive length, found {text!r}")
    return value * UNITS_M[match[2].lower()]


def parse_size(text: str, what: str = "size") -> tuple[int, int]:
    """Width and height from text such as 1280x720.

    Raises:
        InputError: other text.
    """
    match = re.fullmatch(r"\s*(\d{1,5})\s*[xX×]\s*(\d{1,5})\s*", text)
    if match is None or int(match[1]) < 1 or int(match[2]) < 1:
        raise InputError(f"{what}: expected WIDTHxHEIGHT, e.g. 1280x720, found {text!r}")
    return int(match[1]), int(match[2])


def size_text(size: tuple[int, int]) -> str:
    """Width and height as ``parse_size`` reads them."""
    return f"{size[0]}x{size[1]}"
