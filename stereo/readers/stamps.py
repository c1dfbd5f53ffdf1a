"""Times of frames as recorders write them: numbers of any unit, dates, and the numbers in file names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal
from typing import NamedTuple

import numpy as np

from calib.types import I64

NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
"""Nanoseconds of a unit."""
_EPOCH_S = 9.0e8, 4.2e9
"""Seconds since 1970 of the years 1998 to 2103: what a clock that was set shows."""
_MAX_STEP = {"s": 2, "ms": 2_000, "us": 2_000_000}
"""Steps between frames up to 2 s tell the unit of a clock that counts from the start of the machine: two units differ
by a factor of 1000, the periods of cameras (1 to 250 Hz) by 250 (our choice)."""
_NUMBER = re.compile(r"[+-]?\d{1,20}(\.\d{0,30})?([eE][+-]?\d{1,2})?")
_DATE = re.compile(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?\d*(?:Z|\+00:?00)?")
_MAX_NS = 2**62
_NAME = re.compile(r"(?<![\d.])(\d{7,20}(?:\.\d{1,9}|_\d{6,9})?|\d{1,6}\.\d{2,9})(?![\d.])")


class Stamps(NamedTuple):
    """Times of one camera's frames in the order of the recording.

    Attributes:
        ns: (n,) int64 [ns] by the recorder's clock.
        unit: in which they were written: "ns", "us", "ms", "s" or "date".
    """

    ns: I64
    unit: str


def read_stamps(texts: Sequence[str], unit: str | None = None) -> Stamps:
    """Times from text, exactly.

    Args:
        texts: all numbers, or all dates as ISO 8601 writes them (UTC).
        unit: of the numbers, when the file names it; else it is recognised from their magnitude and steps.
    Raises:
        ValueError: neither, or out of range.
    """
    dates = [_DATE.fullmatch(text.strip()) for text in texts]
    if texts and all(dates):
        return Stamps(np.array([_date_ns(match) for match in dates if match], dtype=np.int64), "date")
    numbers = [_number(text) for text in texts]
    unit = unit or unit_of(numbers)
    values = [int(number * NS[unit]) for number in numbers]
    if values and max(map(abs, values)) > _MAX_NS:
        raise ValueError(f"expected times, found {texts[int(np.argmax([abs(v) for v in values]))][:40]!r} ({unit})")
    return Stamps(np.array(values, dtype=np.int64), unit)


def unit_of(numbers: Sequence[Decimal]) -> str:
    """The unit of times: of a clock that was set by their magnitude, else by their median step."""
    largest = max((abs(number) for number in numbers), default=Decimal(0))
    for unit, ns in NS.items():
        if _EPOCH_S[0] <= float(largest) * ns / 1e9 <= _EPOCH_S[1]:
            return unit
    steps = np.abs(np.diff(np.array([float(number) for number in numbers])))
    steps = steps[steps > 0]
    if not steps.size:
        return "s"
    step = float(np.median(steps))
    return next((unit for unit, most in _MAX_STEP.items() if step <= most), "ns")


def stamps_in_names(stems: Sequence[str]) -> Stamps | None:
    """Times that the names of files hold: one number each, with a decimal part or as large as only a clock counts.

    Returns:
        None where the names number the frames instead, or hold no number.
    """
    found = [_NAME.findall(stem) for stem in stems]
    if len(stems) < 2 or any(len(numbers) != 1 for numbers in found):
        return None
    texts = [numbers[0].replace("_", ".") for numbers in found]
    if any(text.startswith("00") for text in texts):
        return None  # a counter with leading zeros
    numbers = [Decimal(text) for text in texts]
    steps = {b - a for a, b in zip(sorted(numbers), sorted(numbers)[1:], strict=False)}
    if steps == {Decimal(1)} or max(numbers) == min(numbers):
        return None
    return read_stamps(texts)


def _number(text: str) -> Decimal:
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"expected a time, found {text[:40]!r}")
    number = Decimal(text)
    if abs(number) > 10**19:
        raise ValueError(f"expected a time, found {text[:40]!r}")
    return number


def _date_ns(match: re.Match[str]) -> int:
    seconds = datetime.fromisoformat(match[1]).replace(tzinfo=UTC).timestamp()
    return round(seconds) * NS["s"] + int((match[2] or "0").ljust(9, "0"))
