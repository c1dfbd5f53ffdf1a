"""Checks of time: gaps, lags between cameras, and the speed at which people walk."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.carried import Carried
from calib.doubt import Finding, Score, best
from calib.times import rate_of_times
from calib.types import F64
from planview.checks.check import Check, limit_check
from stereo.doctor.hypotheses import LATE
from stereo.recording import Recording

MIN_LIKENESS = 0.5
"""Correlation of the cameras' movement below which their lag is not reported."""
LONGEST_LAG = 30
"""Longest lag searched [frames]: two seconds at 15 Hz."""
WINDOW = 120
"""Frames over which the mean movement is taken out."""
MIN_FRAMES = 12
GROUPS = 8
"""Parts of the time that are left out in turn to estimate deviations (jackknife)."""
SURELY = 2.0
"""Deviations by which a lag must make the movement of both cameras more alike than none does: less is chance."""
SPEEDS_MAX = 4096
"""Speeds that are remembered: those of two people in two minutes at 15 Hz."""
SPEEDS_MIN = 40
WALKING_MPS = 0.5
"""Fewest speeds of people who walk by which the rate is doubted, and the speed from which one does [m/s]."""
MAX_LAG = 0.5
"""Cameras may be apart by half a frame: at 15 fps a walker moves 4 cm in that time, which is 1 px at 4 m."""


class Lag(NamedTuple):
    """Frames of the right camera behind the left one at which their movement over time is most alike, NaN where it is
    not; its deviation; and how much more alike than without a lag, in deviations of that. Both by the jackknife over
    parts of the time, NaN where one part holds most of what moves."""

    frames: float = math.nan
    std: float = math.nan
    gain: float = math.nan

    @property
    def apart(self) -> bool:
        """True if the cameras are surely apart: it explains their movement better than no lag does."""
        return best(self, LATE.values(), lag_score, margin=math.exp(0.5 * SURELY**2)) is not None

    def check(self, name: str, what: str, against: str = "") -> Check:
        """The lag of ``what`` as a check."""
        apart = self.apart
        note = f"offset of the {what}, by movement"
        if math.isfinite(self.frames):
            note = f"{what} {'ahead' if self.frames < 0 else 'late'}{against}, by movement"
        if apart:
            note = str(Finding(LATE[what], note))
        return Check(name, not apart, abs(self.frames), "frames", MAX_LAG, "at most", note, std=self.std)


def lag_score(lag: Lag) -> Score:
    """Likelihood of the movement if there is no lag, for what speaks for one."""
    is_doubted = abs(lag.frames) > MAX_LAG and lag.gain > 0
    return Score(-0.5 * lag.gain**2 if is_doubted else 0.0)


def lag_of(left: F64, right: F64) -> Lag:
    """Lag at which the (T, bands) movement of both cameras correlates best, and how far it moves when parts of the
    time are left out."""
    if len(left) < MIN_FRAMES:
        return Lag()
    sums = _sums_at_lags(_less_mean(left), _less_mean(right))
    whole = sums.sum(axis=0)
    likeness = _likeness(whole)
    likest = int(np.argmax(likeness))
    if likeness[likest] < MIN_LIKENESS:
        return Lag()
    power = sums[:, LONGEST_LAG, 1:].sum(axis=1)
    if power.max() > 0.8 * power.sum():
        return Lag(_between(likeness, likest))
    lags = []
    gains = []
    for part in sums:
        without = _likeness(whole - part)
        lags.append(_between(without, int(np.argmax(without))))
        gains.append(float(without[likest] - without[LONGEST_LAG]))
    gain = float(likeness[likest] - likeness[LONGEST_LAG]) / max(_jackknife(gains), 1e-6)
    return Lag(_between(likeness, likest), _jackknife(lags), gain)


def _less_mean(signal: F64) -> F64:
    """A signal less its mean over every WINDOW frames."""
    parts = np.array_split(signal, max(1, round(len(signal) / WINDOW)))
    return np.concatenate([part - part.mean(axis=0) for part in parts])


def _sums_at_lags(left: F64, right: F64) -> F64:
    """(GROUPS, lags, 3) sums over parts of the time, of left by right that much later, and of each by itself."""
    frames = len(left)
    part_of = np.arange(frames) * GROUPS // frames
    sums = np.zeros((GROUPS, 2 * LONGEST_LAG + 1, 3))
    longest = min(LONGEST_LAG, frames // 3)
    for lag in range(-longest, longest + 1):
        at = np.arange(max(0, -lag), frames - max(0, lag))
        a = left[at]
        b = right[at + lag]
        for k, product in enumerate((a * b, a * a, b * b)):
            sums[:, LONGEST_LAG + lag, k] = np.bincount(part_of[at], product.sum(axis=1), GROUPS)
    return sums


def _jackknife(without: Sequence[float]) -> float:
    """Standard deviation of a value, from those with each part left out."""
    return float(np.sqrt((len(without) - 1) * np.var(without)))


def _likeness(sums: F64) -> F64:
    """Correlation at each lag."""
    power = np.sqrt(np.maximum(sums[:, 1] * sums[:, 2], 0.0))
    return np.asarray(np.where(power > 1e-9, sums[:, 0] / np.maximum(power, 1e-9), -1.0), dtype=np.float64)


def _between(likeness: F64, best: int) -> float:
    """The lag of the best score, between frames by the parabola through it and its neighbours."""
    shift = 0.0
    if 0 < best < len(likeness) - 1:
        before = likeness[best - 1]
        after = likeness[best + 1]
        bend = before - 2.0 * likeness[best] + after
        shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(best - LONGEST_LAG + shift)


def frame_checks(recording: Recording[Any], spread: int, run: Sequence[Any], asked: int) -> list[Check]:
    """Usable frames and gaps in the timestamps of any recording, from some spread over it and consecutive ones."""
    usable = (spread + len(run)) / max(1, asked)
    times_s = recording.times_s
    if times_s is None:
        times_s = np.array([frame.timestamp_s for frame in run])
    rate = rate_of_times(times_s[np.isfinite(times_s)])
    longest = math.nan if rate is None else max(1.0, rate.longest_gap_s * rate.fps)
    gap = "longest step between frames over the usual one"
    return [
        limit_check("usable frames", usable, "", "share of the frames read that can be decoded", least=0.9),
        # One dropped frame passes, two in a row do not.
        limit_check("timestamp gap", longest, "steps", gap, most=2.5, warns=True),
    ]


class SpeedWatch(Carried):
    """Measures walking speeds by the times of the frames, which shows a wrong rate or unit of length."""

    FRAMES = 5
    """Frames between two places of a person: less would measure jitter."""

    def __init__(self) -> None:
        self._places: deque[tuple[float, Mapping[int, tuple[float, float]]]] = deque(maxlen=self.FRAMES + 1)
        self._speeds: deque[float] = deque(maxlen=SPEEDS_MAX)

    def update(self, timestamp_s: float, places: Mapping[int, tuple[float, float]]) -> None:
        """Take the places of a frame [m], by id."""
        self._places.append((timestamp_s, places))
        then_s, before = self._places[0]
        if len(self._places) > self.FRAMES and timestamp_s > then_s:
            moves = [math.dist(places[k], before[k]) for k in places.keys() & before.keys()]
            self._speeds += [move / (timestamp_s - then_s) for move in moves]

    def check(self) -> Check:
        """The median of those who walk; some seconds of one person are too few."""
        walking = [speed for speed in self._speeds if speed > WALKING_MPS]
        value = float(np.median(walking)) if len(walking) >= SPEEDS_MIN else math.nan
        note = "median of people who walk: a wrong frame rate (fps) or unit of length, or they run"
        return limit_check("walking speed", value, "m/s", note, most=2.5, warns=True)
