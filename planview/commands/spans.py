"""Spans of frames on the command line."""

from __future__ import annotations

from calib.errors import InputError


def frame_span(text: str) -> tuple[int, int]:
    """First and last frame of "FIRST:LAST".

    Raises:
        InputError: anything else.
    """
    first, _, last = text.partition(":")
    try:
        span = int(first or 0), int(last)
    except ValueError:
        raise InputError(f"--frames: expected FIRST:LAST, e.g. 0:399, found {text!r}") from None
    if not 0 <= span[0] <= span[1]:
        raise InputError(f"--frames: expected FIRST:LAST with FIRST not after LAST, found {text!r}")
    return span
