"""Times of frames, of recordings and of tables: how they are written, and their rate, gaps, bursts and jumps."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64, Bool

NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""Nanoseconds of a unit of time."""
UNITS = {**dict(zip(NS, NS, strict=True)), "sec": "s", "msec": "ms", "usec": "us", "nsec": "ns"}
"""Units by the names that columns have for them."""
EARLIEST_S = 9.0e8
LATEST_S = 4.2e9
"""Seconds since 1970 of the years 1998 and 2103: between them lies the time of every clock that was set."""

JUMP_S = 3600.0
"""A step this long, or ten frame periods back, is a clock that was set, not a pause."""
PAUSE_S = 600.0
"""A longer step of a table's times is named [s]: no recorder pauses for longer unnoticed."""
SLOW_S = 2.0
"""Steps from which nobody can be followed from frame to frame [s]: at a walking pace they are three metres. No buffer
of a camera holds frames for longer."""
WRONG_UNIT_S = 5.0
"""Milliseconds read as seconds make a frame last longer at up to 200 frames per second."""
FASTEST_FPS = 1e4
"""Nobody records people at a higher rate: such times are days, as spreadsheets count them."""
EVEN_SHARE = 0.5
"""Share of the steps within half of their mean from which frames come one by one; of those in bursts none are."""
BUFFERED_S = 0.01
"""Steps within a burst are shorter [s]: the frames were taken before and arrive as fast as they can be read."""
UNEVEN = 0.25
"""Deviation of the steps over the frame period from which times are called uneven."""


_LONGEST_STEP = {"s": 2, "ms": 2_000, "us": 2_000_000}
"""Steps between frames up to 2 s give the unit of a clock that counts from the start of the machine: two units differ
by a factor of 1000, the periods of cameras (1 to 250 Hz) by 250."""
_NUMBER = re.compile(r"[+-]?\d{1,20}(\.\d{0,30})?([eE][+-]?\d{1,2})?")
_DATE = re.compile(
    r"(?:((?:19|20)\d\d)[-/]?(\d\d)[-/]?(\d\d)[T _]*)?(\d\d)(?(1):?|:)(\d\d)(?(1):?|:)(\d\d)(?:[.,]?(\d+))?"
    r" *(?:Z|UTC|([+-])(\d\d):?(\d\d)?)?",
    re.IGNORECASE,
)
COUNTED = 1.25
"""Numbers within a second that go up to this many times the frames in it count them: decimals go up to the whole."""


class Stamps(NamedTuple):
    """Times of frames: (n,) int64 [ns] by the recorder's clock, and the unit in which they were written, "s", "ms",
    "us", "ns" or "date"."""

    ns: I64
    unit: str


def read_stamps(source: Path | str, texts: Sequence[str], unit: str | None = None) -> Stamps:
    """Times as recorders write them, to the last digit.

    All are numbers, whose unit is that of ``unit_of``, or all are dates or times of day as ISO 8601 writes them, in UTC
    where they have no offset. Raises InputError, which begins with the source: other text, or a time that no clock
    shows.
    """
    dates = [_match_date(text) for text in texts]
    if any(dates):
        unit = "date"
        values = [_ns_of_date(source, text, date) for text, date in zip(texts, dates, strict=True)]
    else:
        numbers = [_number(source, text) for text in texts]
        unit = unit_of(np.array(numbers, dtype=np.float64), unit)
        values = [int(number * NS[unit]) for number in numbers]
    for text, value in zip(texts, values, strict=True):
        if abs(value) > 2**62:
            raise InputError(f"{source}: expected times, found {text[:40]!r} ({unit})")
    return Stamps(np.array(values, dtype=np.int64), unit)


def unit_of(numbers: F64, named: str | None = None) -> str:
    """The unit of (n,) times: the one that is named, unless no clock counts that many of it; that in which they are
    times since 1970; else that of their usual step."""
    finite = numbers[np.isfinite(numbers)]
    largest_s = float(np.abs(finite).max(initial=0.0)) / NS["s"]
    if named is not None and largest_s * NS[named] <= LATEST_S:
        return named
    steps = np.abs(np.diff(finite))
    steps = steps[steps > 0]
    step = float(np.median(steps)) if len(steps) else 0.0
    for unit, ns in NS.items():
        if EARLIEST_S <= largest_s * ns <= LATEST_S and step * ns < JUMP_S * NS["s"]:
            return unit
    if not step:
        return "s"
    return next((unit for unit, longest in _LONGEST_STEP.items() if step <= longest), "ns")


def seconds_of(source: Path | str, values: np.ndarray, unit: str = "s") -> F64:
    """(n,) times [s] of the cells of a table, NaN where there is none: numbers in a unit, unless no clock counts so
    many of it, or dates. Raises InputError: see ``read_stamps``."""
    if values.dtype.kind in "biuf":
        numbers = np.asarray(values, dtype=np.float64)
        return numbers * (NS[unit_of(numbers, unit)] / NS["s"])
    texts = [str(value).strip() for value in values]
    rows = [row for row, text in enumerate(texts) if text.lower() not in ("", "nan", "nat", "none")]
    seconds = np.full(len(texts), np.nan)
    seconds[rows] = read_stamps(source, [texts[row] for row in rows], unit).ns / NS["s"]
    return seconds


def is_time(text: str) -> bool:
    """True for a number, a date or a time of day."""
    text = text.strip()
    return bool(_NUMBER.fullmatch(text) or _match_date(text))


def _match_date(text: str) -> re.Match[str] | None:
    """A date, the day first where dots separate it from month and year, or a time of day."""
    return _DATE.fullmatch(re.sub(r"^(\d\d)\.(\d\d)\.(\d{4})\b", r"\3-\2-\1", text.strip()))


def _number(source: Path | str, text: str) -> Decimal:
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        raise _no_time(source, text)
    return Decimal(text)


def _no_time(source: Path | str, text: str) -> InputError:
    expected = "a time (a number, or a date such as 2023-10-29T02:59:59.3+01:00)"
    return InputError(f"{source}: expected {expected}, found {text[:40]!r}")


def _ns_of_date(source: Path | str, text: str, match: re.Match[str] | None) -> int:
    """Nanoseconds since 1970 of a date, or since midnight of a time of day."""
    if match is None:
        raise _no_time(source, text)
    year, month, day, hour, minute, second, decimals, sign, offset_h, offset_min = match.groups()
    date = int(year or 1970), int(month or 1), int(day or 1)
    try:
        moment = datetime(*date, int(hour), int(minute), int(second), tzinfo=UTC)
    except ValueError as error:
        raise _no_time(source, text) from error
    offset_s = 3600 * int(offset_h or 0) + 60 * int(offset_min or 0)
    if sign == "-":
        offset_s = -offset_s
    nanoseconds = int((decimals or "0")[:9].ljust(9, "0"))
    return (round(moment.timestamp()) - offset_s) * NS["s"] + nanoseconds


def within_seconds(seconds: Sequence[int], parts: Sequence[str], *, may_count: bool = True) -> list[str] | None:
    """Decimals of the times of frames, whose whole seconds and number within the second are written apart.

    The number holds the decimals, or counts milliseconds, microseconds, nanoseconds or, where it ``may_count`` these,
    frames. None where it counts frames and no whole second shows how many there are.
    """
    runs = [[int(parts[i]) for i in run] for _, run in groupby(range(len(parts)), key=seconds.__getitem__)]
    if may_count and _count_frames(runs):
        return _decimals_of_counts(runs)
    longest = max(map(len, parts))
    width = next((digits for digits in (3, 6, 9) if digits >= longest), longest)
    padded = [part.zfill(width) for part in parts]
    if len(set(map(len, parts))) == 1:
        return list(parts)

    def unevenness(decimals: Sequence[str]) -> float:
        times = [second - seconds[0] + float(f"0.{part}") for second, part in zip(seconds, decimals, strict=True)]
        return float(np.std(np.diff(np.sort(times))))

    return min(list(parts), padded, key=unevenness)


def _count_frames(runs: Sequence[Sequence[int]]) -> bool:
    """True if the numbers of each second count its frames, from 0 or 1 and nearly without a gap."""
    first = min(map(min, runs))
    largest = max(map(max, runs))
    most = max(map(len, runs))
    rising = all((np.diff(run) > 0).all() for run in runs)
    return rising and first <= 1 < most and largest - first < COUNTED * most


def _decimals_of_counts(runs: Sequence[Sequence[int]]) -> list[str] | None:
    """Decimals of frames that are counted in each second: those between the first and the last second are whole."""
    first = min(map(min, runs))
    counts = [run[-1] - first + 1 for run in runs]
    if len(runs) < 3:
        return None
    usual = float(np.median(counts[1:-1]))
    decimals = []
    for run, count in zip(runs, counts, strict=True):
        rate = max(usual, count)
        begins_late = run is runs[0] and run[0] == first  # the recording begins within its first second
        begin = first - (rate - count) * begins_late
        decimals += [f"{(number - begin) / rate:.9f}"[2:] for number in run]
    return decimals


@dataclass(frozen=True)
class Rate:
    """Rate and evenness of frames.

    Attributes:
        fps: frames per second, from the mean step without gaps; with bursts, from all steps.
        jitter_ms: standard deviation of the steps without gaps [ms].
        duration_s: from the first frame to the last, without jumps of the clock [s].
        gaps: steps longer than 1.5 frame periods.
        dropped: frames that would have fallen into them.
        longest_gap_s: the longest of them [s]; 0 without any.
        burst: frames that come at once, as where a buffer is read; 1 where each comes by itself.
    """

    fps: float
    jitter_ms: float
    duration_s: float
    gaps: int
    dropped: int
    longest_gap_s: float
    burst: int = 1

    @property
    def note(self) -> str:
        """Warning about uneven, rare or impossible frames, else empty."""
        if self.fps > FASTEST_FPS:
            return f"a frame lasts {1.0 / self.fps:.3g} s: are the times days?"
        if self.fps < 1.0 / SLOW_S:
            return f"a frame every {1.0 / self.fps:.3g} s, at which nobody can be followed"
        if self.burst == 1 and self.jitter_ms * self.fps > 1e3 * UNEVEN:
            return f"times are uneven: steps of {1e3 / self.fps:.3g} ms deviate by {self.jitter_ms:.3g} ms"
        return ""


def rate_of_times(times_s: F64) -> Rate | None:
    """Rate and gaps of (n,) times [s] in any order; None of fewer than two different ones."""
    steps = np.diff(np.sort(times_s[np.isfinite(times_s)]))
    steps = steps[(steps > 0) & (steps < JUMP_S)]
    if not steps.size:
        return None
    period = float(np.median(steps))
    mean = float(steps.mean())
    even = float(np.mean(np.abs(steps - mean) < 0.5 * mean))
    if even < EVEN_SHARE and steps.max() < SLOW_S and np.median(steps[steps <= mean]) < BUFFERED_S:
        begins = np.flatnonzero(steps > mean) + 1
        if len(begins) > 2:
            mean = float(steps[: begins[-1]].mean())
            burst = int(np.median(np.diff(begins)))
            return Rate(1.0 / mean, float(np.std(steps)) * 1e3, float(steps.sum()), 0, 0, 0.0, burst)
    wide = steps > 1.5 * period
    return Rate(
        fps=1.0 / float(np.mean(steps[~wide])),
        jitter_ms=float(np.std(steps[~wide])) * 1e3,
        duration_s=float(steps.sum()),
        gaps=int(wide.sum()),
        dropped=int(np.sum(np.round(steps[wide] / period) - 1)),
        longest_gap_s=float(steps[wide].max(initial=0.0)),
    )


def spread_bursts(times_s: F64, rate: Rate) -> tuple[F64, tuple[str, ...]]:
    """(n,) times [s] of frames that came in bursts, spread evenly from each burst to the next, as they are where each
    frame came by itself; and a note on times that are not even."""
    if rate.burst == 1:
        return times_s, (rate.note,) if rate.note else ()
    timed = np.flatnonzero(np.isfinite(times_s))
    begins = timed[np.diff(times_s[timed], prepend=-math.inf) > 1.0 / rate.fps]
    last = times_s[begins[-1]] + (timed[-1] - begins[-1]) / rate.fps
    # From each burst to the next, and from the last one at the usual rate.
    anchors = np.append(begins, timed[-1] + 1)
    anchors_s = np.append(times_s[begins], last + 1.0 / rate.fps)
    even_s = np.full(len(times_s), np.nan)
    even_s[timed] = np.interp(timed, anchors, anchors_s)
    note = f"frames come in bursts of about {rate.burst}"
    return even_s, (f"{note}: their times of arrival are spread to {rate.fps:.4g} per second",)


def clock_is_set(steps_s: F64, period_s: F64 | float) -> Bool:
    """(n,) mask of the steps from frame to frame [s] that are a clock that was set, or segments that were joined: hours
    ahead, or back by more than frames come out of order."""
    far = np.maximum(JUMP_S, 100.0 * np.asarray(period_s))
    back = -10.0 * np.maximum(period_s, 0.1)
    return np.asarray((steps_s > far) | (steps_s < back), dtype=np.bool_)


class RunningClock:
    """Times of frames as they come, in order: where the clock was set they run on at the nominal rate."""

    def __init__(self, fps: float) -> None:
        self._period_s = 1.0 / fps
        self._index = 0
        self._last_s = -math.inf
        self._offset_s = 0.0

    def time(self, index: int, own_s: float) -> tuple[float, str]:
        """The time [s] of a frame by its own one, and why it cannot be used, empty where it can: such a time does not
        count for the frames after it."""
        now_s = own_s + self._offset_s
        before_s = self._last_s
        usual_s = self._period_s * (index - self._index)
        is_timed = math.isfinite(now_s) and math.isfinite(before_s)
        if is_timed and clock_is_set(np.array([now_s - before_s]), usual_s)[0]:
            self._offset_s += before_s + usual_s - now_s
            now_s = before_s + usual_s
        why = unusable_time(now_s, before_s)
        if not why:
            self._index = index
            self._last_s = now_s
        return now_s, why


def unusable_time(now_s: float, before_s: float) -> str:
    """Reason for which a frame cannot have the time ``now_s`` after one at ``before_s`` [s]; empty where it can."""
    if not math.isfinite(now_s):
        return f"its time is {now_s}"
    if now_s <= before_s:
        return f"its time, {now_s:.9g} s, is not after {before_s:.9g} s of the frame before"
    return ""


def run_on(times_s: F64, frames: I64 | None = None) -> tuple[F64, tuple[str, ...]]:
    """(n,) times [s] of frames in order, which run on at the usual rate where they begin again or the clock was set
    back, and a note on each such place. Frames with numbers are a table's, of which none is out of order."""
    numbers = np.arange(len(times_s)) if frames is None else frames
    if len(times_s) < 2:
        return times_s, ()
    steps = np.diff(times_s)
    apart = np.diff(numbers)
    ahead = steps > 0
    period = float(np.median(steps[ahead] / apart[ahead])) if ahead.any() else 0.0
    back = steps < 0
    if frames is None:
        back &= clock_is_set(steps, period)
    if not back.any():
        return times_s, ()
    forward = np.where(back, period * apart, steps)
    continued_s = times_s[0] + np.concatenate([[0.0], np.cumsum(forward)])
    notes = []
    for frame in numbers[1:][back].tolist():
        notes.append(f"times begin again at frame {frame}: they run on at the usual rate")
    return continued_s, tuple(notes[:3])


def period_of(frames: I64, times_s: F64, fallback_s: float) -> float:
    """Median time per frame [s] of (n,) ascending frames with times: the mean where most frames share one,
    ``fallback_s`` where fewer than two have one or time stands."""
    if len(frames) < 2 or times_s[-1] <= times_s[0]:
        return fallback_s
    period = float(np.median(np.diff(times_s) / np.diff(frames)))
    return period if period > 0 else float((times_s[-1] - times_s[0]) / (frames[-1] - frames[0]))


def doubts(frames: I64, times_s: F64) -> Sequence[str]:
    """Sentences about odd times [s] of (n,) ascending frames: jumps, another unit, bursts."""
    steps = np.diff(times_s)
    apart = np.diff(frames)
    if not len(steps):
        return ()
    if steps.max() > PAUSE_S:
        n = int(np.argmax(steps))
        return (jump_note(int(frames[n]), int(frames[n + 1]), float(steps[n])),)
    if (steps >= WRONG_UNIT_S * apart).all():
        return (f"a frame lasts {period_of(frames, times_s, 0.0):.3g} s: are the times milliseconds?",)
    next_to = np.cumsum(np.append(0.0, steps[apart == 1]))
    rate = rate_of_times(next_to)
    if rate and rate.fps > FASTEST_FPS:
        return (rate.note,)
    if rate and rate.burst > 1:
        return (f"frames come in bursts of about {rate.burst}: are these times of arrival? Speeds are off",)
    return ()


def jump_note(before_frame: int, frame: int, step_s: float) -> str:
    """A jump of the clock in words."""
    size = timedelta(seconds=round(step_s))
    return f"the clock jumps by {size} from frame {before_frame} to {frame}: durations and rates include the jump"
