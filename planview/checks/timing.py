"""Checks of time: gaps, frozen cameras, and cameras whose movement is out of step."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from calib.carried import Carried
from calib.images import as_grey
from calib.times import rate_of_times
from calib.types import F32, F64, U8
from planview.checks.check import Check, limited
from stereo.depth import Depth
from stereo.doctor.explain import Explained
from stereo.doctor.hypotheses import LATE
from stereo.floor import DepthFrames, PairFrames
from stereo.recording import Frame, Recording, Shot

COMPARED_STEP_PX = 2
"""Every n-th row and column is compared: a person at 8 m still has 100 pixels."""
OWN_VIEW = 8
"""The outer 1/n of each image, which the other camera may not show, is left out: a disparity of 80 px of 640."""
BANDS = 24
"""Bands of rows in which movement is summed: rows of a rectified pair show the same part of the scene."""
MOVED_LEVEL = 14
"""Grey levels by which a pixel must change to count as moved: above sensor noise and coding artefacts."""
ACTIVE_SHARE = 0.001
"""Share of moved pixels from which a picture moves: half of what a person at 8 m takes."""
MIN_LIKENESS = 0.5
"""Correlation of the cameras' movement below which their lag is not reported."""
LONGEST_LAG = 30
"""Longest lag searched [frames]: two seconds at 15 Hz."""
WINDOW = 120
"""Frames over which the mean movement is taken out."""
MIN_FRAMES = 12
FRAMES_MAX = 4096
"""Frames with movement, or soon after it, that are remembered: four minutes at 15 Hz, in 1.5 MB."""
GROUPS = 8
"""Parts of the time that are left out in turn to estimate deviations (jackknife)."""
SURELY = 2.0
"""Deviations by which a lag must make the movement of both cameras more alike than none does: less is chance."""
MIN_TAIL = 48
"""Frames from which on a lag is searched in the last part of the time alone."""
MAX_REPEATED = 0.1
"""Share of pairs that repeat the one before while people move: a tenth spoils every velocity."""
JUMPED = 1.5
"""Images that stood still go on with this many times the movement of the frame before: people walked on meanwhile, and
who stood starts slowly."""
MAX_LAG = 0.5
"""Cameras may be apart by half a frame: at 15 fps a walker moves 4 cm in that time, which is 1 px at 4 m."""


class Thumbnails(NamedTuple):
    """Every second pixel of a rectified pair where both cameras see the scene: (h, w) uint8 each; or of an image and of
    the disparity that its depth has, (h, w) float32, 0 where unknown."""

    left: U8
    right: U8 | F32


def thumbnails(left: U8, right: U8) -> Thumbnails:
    """Of rectified (H, W) grey images; rows of both still show the same part of the scene."""
    own = left.shape[1] // OWN_VIEW
    inside = (
        left[::COMPARED_STEP_PX, own::COMPARED_STEP_PX],
        right[::COMPARED_STEP_PX, : right.shape[1] - own : COMPARED_STEP_PX],
    )
    return Thumbnails(*(np.ascontiguousarray(image) for image in inside))


def thumbnails_of(depth: Depth) -> Thumbnails:
    """Of what a head measured: the pair, or its image and depth."""
    if depth.greys is not None:
        return thumbnails(*depth.greys)
    steps = slice(None, None, COMPARED_STEP_PX)
    return Thumbnails(as_grey(depth.image)[steps, steps].copy(), np.nan_to_num(depth.disparity[steps, steps]))


class Lag(NamedTuple):
    """Frames of the right camera behind the left one at which their movement over time is most alike, NaN where it is
    not; its deviation; and how much more alike than without a lag, in deviations of that. Both by the jackknife over
    parts of the time, NaN where one part holds most of what moves."""

    frames: float = math.nan
    std: float = math.nan
    gain: float = math.nan

    @property
    def apart(self) -> bool:
        """Whether the cameras are surely apart: it explains their movement better than no lag does."""
        return self.gain >= SURELY and abs(self.frames) > MAX_LAG

    def check(self, name: str, what: str, against: str = "", *, apart: bool) -> Check:
        """The lag of ``what`` as a check."""
        which = "ahead" if self.frames < 0 else "late"
        known = f"{what} {which}{against}" if math.isfinite(self.frames) else f"offset of the {what}"
        note = f"{known}, by movement"
        note = str(Explained(LATE[what], note)) if apart else note
        return Check(name, not apart, abs(self.frames), "frames", MAX_LAG, "at most", note, std=self.std)


class MotionWatch(Carried):
    """Follows the movement in both images of a pair, or in an image and its depth."""

    RECORDS = (Thumbnails,)

    def __init__(self) -> None:
        self._sides = "left camera", "right camera"
        self._standing = ""
        self._last: Thumbnails | None = None
        self._bands: deque[F64] = deque(maxlen=FRAMES_MAX)
        self._active = self._frozen = self._stall = self._longest = self._repeated = 0
        self._still_for, self._calm_for, self._moved_share = math.inf, 0, 0.0
        self._stall_s = self._still_s = math.nan
        self._is_copy = False
        self._behind = self._bands_since = 0

    def update(self, pair: Thumbnails, timestamp_s: float = 0.0) -> None:
        """Take the next pair. What moves shows in images only: the edges of depth flicker."""
        before, self._last = self._last, pair
        is_pair = pair.right.dtype == np.uint8
        self._sides = ("left camera", "right camera") if is_pair else ("image", "depth")
        if before is None:
            return
        both = list(zip(before, pair, strict=True))
        moved = [np.asarray(cv2.absdiff(a, b) > MOVED_LEVEL, dtype=np.bool_) for a, b in both]
        moved_share = max(float(m.mean()) for m in moved[: 1 + is_pair])
        active = moved_share >= ACTIVE_SHARE
        same = [bool((a == b).all() and a.any()) for a, b in both]  # without any depth nothing stands still
        # A camera that stands still repeats its image to the last bit; one in which nobody moves has noise.
        frozen = active and any(same)
        self._active += active
        self._frozen += frozen
        self._stall = self._stall + 1 if frozen else 0 if active else self._stall
        if frozen:  # a picture written twice leaves its camera one frame behind, from here on
            self._behind, self._bands_since = self._behind + same[1] - same[0], 0
        self._stall_s = timestamp_s if self._stall <= 1 else self._stall_s
        if self._stall > self._longest:
            which = self._sides[0 if same[0] else 1]
            self._name_stall(self._stall, f"the {which} stands", self._stall_s, timestamp_s)
        if all(same) if is_pair else same[0]:
            self._still_for += 1
            self._still_s, self._is_copy = timestamp_s if self._still_for == 1 else self._still_s, all(same)
        else:
            # Copies of a pair between moving ones; a scene in which nothing moves may repeat for hours.
            self._repeated += int(self._still_for) if active and self._is_copy and self._still_for in (1, 2) else 0
            jumped = active and moved_share > JUMPED * self._moved_share
            if jumped and max(2, self._longest) < self._still_for < math.inf:
                who = f"the {self._sides[0]}{f' and the {self._sides[1]} stand' if self._is_copy else ' stands'}"
                self._name_stall(int(self._still_for), who, self._still_s, timestamp_s)
            self._still_for, self._moved_share = 0 if active else math.inf, moved_share
        self._calm_for = 0 if active else self._calm_for + 1
        if is_pair and self._calm_for <= LONGEST_LAG:
            # The root of the share of pixels that changed, so that near walkers do not drown far ones.
            rows = moved[0].shape[0] // BANDS * BANDS
            self._bands.append(np.stack([np.sqrt(m[:rows].reshape(BANDS, -1).mean(axis=1)) for m in moved]))
            self._bands_since += 1

    def _name_stall(self, frames: int, who: str, from_s: float, to_s: float) -> None:
        self._longest, self._standing = frames, f": {who} still from {from_s:.1f} to {to_s:.1f} s"

    def checks(self) -> list[Check]:
        """Cameras that do not move together in time, by all pairs so far; NaN where too little moves."""
        active, (lag, apart) = self._active or math.nan, self._lag()
        longest = float(self._longest) if self._active else math.nan
        first, second = self._sides
        alone = f"share of frames in which the {first} or the {second} alone stands still"
        longest_one, copies = f"longest such time{self._standing}", "share of pairs that repeat the one before"
        return [
            limited("frozen camera", self._frozen / active, "", alone + self._standing * (self._frozen > 0), most=0.1),
            # Half a second at 15 Hz [frames]; what both cameras show moves in both.
            limited("stalled camera", longest, "frames", longest_one, most=8, warns=True),
            limited("repeated pairs", self.repeated, "", copies, most=MAX_REPEATED),
            *([lag.check("synchronisation", second, apart=apart)] if second == "right camera" else []),
        ]

    @property
    def repeated(self) -> float:
        """Share of the frames with movement around them that repeat the pair before."""
        return self._repeated / ((self._active or math.nan) + self._repeated)

    def _lag(self) -> tuple[Lag, bool]:
        """The lag over all the time, or over its first half or its end where that leaves less doubt; and whether the
        cameras are apart by it, or as far apart as pictures that were written twice leave them."""
        if not self._active or not self._bands:
            return Lag(), False
        signals = np.stack(self._bands)
        count, half = len(signals), len(signals) // 2
        parts = [signals, *([signals[:half]] if half >= WINDOW else [])]
        # A camera may lose its step on the way, and stays behind to the end.
        parts += [tail for k in range(2, GROUPS - 1) if len(tail := signals[count * k // GROUPS :]) >= MIN_TAIL]
        lags = [lag_of(part[:, 0], part[:, 1]) for part in parts]
        lag = max(lags[1:], key=lambda lag: lag.gain if lag.gain >= SURELY else -1.0, default=lags[0])
        lag = lag if lag.gain >= SURELY > lags[0].gain else lags[0]
        if not lag.apart and self._behind and MIN_FRAMES <= self._bands_since < count:
            since = lag_of(*signals[count - self._bands_since :].transpose(1, 0, 2))
            if math.isfinite(since.frames) and round(since.frames) == self._behind:
                return since, True
        return lag, lag.apart


def lag_of(left: F64, right: F64) -> Lag:
    """Lag at which the (T, bands) movement of both cameras correlates best, and how far it moves when parts of the
    time are left out."""
    frames = len(left)
    if frames < MIN_FRAMES:
        return Lag()
    # Each less its mean over every WINDOW frames.
    parts = (np.array_split(signal, max(1, round(frames / WINDOW))) for signal in (left, right))
    left, right = (np.concatenate([part - part.mean(axis=0) for part in each]) for each in parts)
    longest, part_of = min(LONGEST_LAG, frames // 3), np.arange(frames) * GROUPS // frames
    # Of every part and lag: left by right that much later, and each by itself.
    sums = np.zeros((GROUPS, 2 * LONGEST_LAG + 1, 3))
    for lag in range(-longest, longest + 1):
        at = np.arange(max(0, -lag), frames - max(0, lag))
        a, b = left[at], right[at + lag]
        for k, product in enumerate((a * b, a * a, b * b)):
            sums[:, LONGEST_LAG + lag, k] = np.bincount(part_of[at], product.sum(axis=1), GROUPS)
    whole, power = sums.sum(axis=0), sums[:, LONGEST_LAG, 1:].sum(axis=1)
    likeness = _likeness(whole)
    best = int(np.argmax(likeness))
    if likeness[best] < MIN_LIKENESS:
        return Lag()
    if power.max() > 0.8 * power.sum():
        return Lag(_between(likeness, best))
    without = [_likeness(whole - part) for part in sums]
    gains = [float(one[best] - one[LONGEST_LAG]) for one in without]
    gain = float(likeness[best] - likeness[LONGEST_LAG]) / max(jackknife(gains), 1e-6)
    return Lag(_between(likeness, best), jackknife([_between(one, int(np.argmax(one))) for one in without]), gain)


def jackknife(without: Sequence[float]) -> float:
    """Standard deviation of a value, from those with each part left out."""
    own = np.asarray(without)
    return float(np.sqrt((len(own) - 1) / len(own) * np.sum((own - own.mean()) ** 2)))


def _likeness(sums: F64) -> F64:
    """Correlation at each lag."""
    power = np.sqrt(np.maximum(sums[:, 1] * sums[:, 2], 0.0))
    return np.asarray(np.where(power > 1e-9, sums[:, 0] / np.maximum(power, 1e-9), -1.0), dtype=np.float64)


def _between(likeness: F64, best: int) -> float:
    """The lag of the best score, between frames by the parabola through it and its neighbours."""
    shift = 0.0
    if 0 < best < len(likeness) - 1:
        before, after = likeness[best - 1], likeness[best + 1]
        bend = before - 2.0 * likeness[best] + after
        shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(best - LONGEST_LAG + shift)


def frame_checks(recording: Recording[Any], spread: Sequence[Any], run: Sequence[Any], asked: int) -> list[Check]:
    """Usable frames and gaps in the timestamps of any recording, from frames spread over it and consecutive ones."""
    usable = (len(spread) + len(run)) / max(1, asked)
    times = recording.times_s
    known = np.array([f.timestamp_s for f in run]) if times is None else times[np.isfinite(times)]
    gap, rate = "longest step between frames over the usual one", rate_of_times(known)
    longest = math.nan if rate is None else max(1.0, rate.longest_gap_s * rate.fps)
    return [
        limited("usable frames", usable, "", "share of the frames read that can be decoded", least=0.9),
        # One dropped frame passes, two in a row do not.
        limited("timestamp gap", longest, "steps", gap, most=2.5, warns=True),
    ]


def still_checks(seen: PairFrames | DepthFrames, frames: Sequence[Frame[Shot]]) -> list[Check]:
    """Of recorded frames in order: images and depth that stand still or repeat, and cameras that are out of step."""
    watch = MotionWatch()
    for frame in frames:
        if isinstance(seen, PairFrames):
            pair = seen.rectifier(*frame.images)
            watch.update(thumbnails(pair.left_grey, pair.right_grey), frame.timestamp_s)
        else:
            image, depth_m = seen.rectifier(*frame.images)
            depth = Depth.of_whole(image, seen.rectifier.disparity(depth_m), 1)
            watch.update(thumbnails_of(depth), frame.timestamp_s)
    return watch.checks()


class SpeedWatch(Carried):
    """How fast people walk by the times of the frames, which shows a wrong rate or unit of length."""

    FRAMES = 5
    """Between two places of a person: what places jitter by from frame to frame is no walk."""

    def __init__(self) -> None:
        self._places: deque[tuple[float, Mapping[int, tuple[float, float]]]] = deque(maxlen=self.FRAMES + 1)
        self._speeds: deque[float] = deque(maxlen=FRAMES_MAX)

    def update(self, timestamp_s: float, places: Mapping[int, tuple[float, float]]) -> None:
        """Take the places of a frame [m], by id."""
        self._places.append((timestamp_s, places))
        then_s, before = self._places[0]
        if len(self._places) > self.FRAMES and timestamp_s > then_s:
            moves = [math.dist(places[k], before[k]) for k in places.keys() & before.keys()]
            self._speeds += [move / (timestamp_s - then_s) for move in moves]

    def check(self) -> Check:
        """The median of those who walk; some seconds of one person are too few."""
        walking = [speed for speed in self._speeds if speed > 0.5]
        value = float(np.median(walking)) if len(walking) >= 40 else math.nan
        note = "median of people who walk: a wrong frame rate (fps) or unit of length, or they run"
        return limited("walking speed", value, "m/s", note, most=2.5, warns=True)


def repeated_check(images: Sequence[U8]) -> Check:
    """Consecutive images of one camera that repeat the one before while something moves."""
    watch = MotionWatch()
    for image in images:
        small = as_grey(image)[::COMPARED_STEP_PX, ::COMPARED_STEP_PX]
        watch.update(Thumbnails(small, small))
    note = "share of frames that repeat the one before"
    return limited("repeated frames", watch.repeated, "", note, most=MAX_REPEATED, warns=True)
