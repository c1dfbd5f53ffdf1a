"""Pairing of images: by the sides in their names, by numbers of files, and by times."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.times import clock_is_set
from calib.types import F64, I64, Bool
from stereo.readers.images import frame_number

_WORD = re.compile(r"()()(left|right|(?<![a-z])[lr](?![a-z]))", re.IGNORECASE)
_NUMBERS = [
    re.compile(rf"(?<![a-z])({words})([_-]?)(\d{{1,2}})(?!\d)", re.IGNORECASE)
    for words in ("cam|camera|view|infra|infrared|ir|c|eye|sensor|lens|device", "im|img|image|i")
]
"""A side, a number of what can only be a camera, and of what can be a frame too: each the third group."""


class Sided(NamedTuple):
    """Names of two cameras: positions of the left and the right ones in the list of names, and of every name what is
    left without the side; empty where it has none."""

    left: list[int]
    right: list[int]
    rest: list[str]


def split_sides(names: Sequence[str]) -> Sided | None:
    """Left and right by these words (or L and R) in names without folder and ending, else by two camera numbers, the
    lower one left; names without a side are passed over. None when the names have no two sides."""
    for pattern in (_WORD, *_NUMBERS):
        side_of = [_side_in(name, pattern) for name in names]
        sides = sorted({side for side in side_of if side}, key=lambda side: (len(side), side))
        if len(sides) == 2:
            left = [i for i, side in enumerate(side_of) if side == sides[0]]
            right = [i for i, side in enumerate(side_of) if side == sides[1]]
            rest = [
                "" if side == "" else pattern.sub(r"\1\2*", name) for side, name in zip(side_of, names, strict=True)
            ]
            return Sided(left, right, rest)
    return None


def _side_in(name: str, pattern: re.Pattern[str]) -> str:
    """The one side that a name holds, "l", "r" or a number; empty where it holds none, or several."""
    words = {match[3].lower() for match in pattern.finditer(name)}
    sides = {word if word.isdecimal() else word[0] for word in words}
    return sides.pop() if len(sides) == 1 else ""


def one_of_each(paths: Sequence[Path]) -> tuple[Path, Path] | None:
    """The one path of the left and the one of the right camera, by their names; None unless there is one of each."""
    sided = split_sides([path.name for path in paths])
    if sided is None or len(sided.left) != 1 or len(sided.right) != 1:
        return None
    return paths[sided.left[0]], paths[sided.right[0]]


Pair = tuple[Path | None, Path | None]


def pair_files(left: list[Path], right: list[Path], number: Callable[[Path], int | None] = frame_number) -> list[Pair]:
    """Pairs in order; None where a file is missing.

    Numbered files pair by number: a number that only one side has, or that both leave out of an otherwise even
    sequence, is a missing frame, so that indices (and times) keep the gap. Files without numbers pair in sorted
    order, and so do as many files on both sides that are numbered from two starts, or by two clocks, which share few
    numbers. Beyond a tenth of unpaired numbers, or with different counts of unnumbered files, any other pairing
    would be a guess that silently mates wrong frames, so it is refused.

    Args:
        number: a file's number, None when it has none.
    """
    left_by = _by_number(left, number)
    right_by = _by_number(right, number)
    in_order: list[Pair] = list(zip(left, right, strict=False))
    if left_by is None or right_by is None:
        if len(left) != len(right):
            stems = {file.stem for file in left} & {file.stem for file in right}
            alone = [file for file in [*left, *right] if file.stem not in stems]
            raise _no_mate((alone + left)[0], left, right)
        return in_order
    either = sorted(left_by.keys() | right_by.keys())
    unpaired = sorted(left_by.keys() ^ right_by.keys())
    most = 0.1 * len(either)
    are_alike = np.array_equal(np.diff(sorted(left_by)), np.diff(sorted(right_by)))
    if len(left) == len(right) and len(unpaired) > (most if are_alike else 5 * most):
        return in_order  # numbered from two starts, or by two clocks
    if len(unpaired) > max(1.0, most):
        raise _no_mate(left_by.get(unpaired[0]) or right_by[unpaired[0]], left, right)
    return [(left_by.get(number), right_by.get(number)) for number in even_sequence(either)]


def numbering_note(pairs: Sequence[Pair], number: Callable[[Path], int | None] = frame_number) -> tuple[str, ...]:
    """A note on two cameras whose images are numbered from different starts, and how ``pair_files`` paired them."""
    left = next(first for first, _ in pairs if first)
    right = next(second for _, second in pairs if second)
    starts = number(left), number(right)
    if None in starts or starts[0] == starts[1]:
        return ()
    how = "in order" if (left, right) == pairs[0] else "by number"
    return (
        f"the first images are {left.parent.name}/{left.name} and {right.parent.name}/{right.name}: paired {how}; "
        "if that is wrong, renumber those of one",
    )


def even_sequence(numbers: list[int]) -> list[int]:
    """The numbers with those filled in that an even sequence would have; unchanged when it is not even."""
    steps = Counter(b - a for a, b in itertools.pairwise(numbers))
    if not steps:
        return numbers
    step, _ = steps.most_common(1)[0]
    # Numbers of any length may stand in names: the length of a range would have to fit a machine word.
    if any(s % step for s in steps) or (numbers[-1] - numbers[0]) // step + 1 > 2 * len(numbers):
        return numbers
    return list(range(numbers[0], numbers[-1] + 1, step))


def _by_number(files: list[Path], number: Callable[[Path], int | None]) -> dict[int, Path] | None:
    numbers = [number(file) for file in files]
    found = {n: file for n, file in zip(numbers, files, strict=True) if n is not None}
    return found if len(found) == len(files) else None


def _no_mate(file: Path, left: list[Path], right: list[Path]) -> InputError:
    counts = " and ".join(f"{len(own)} in {own[0].parent.name}" for own in (left, right) if own)
    return InputError(
        f"{file}: expected a mate in the other folder for every image, found none ({counts}): add a file of times for "
        "each camera, or delete images without a mate"
    )


PAIRED_WITHIN = 0.25
"""Times of a pair differ at most by this share of the frame period (a walker of 2 m/s moves 1.7 cm in a
quarter of 1/30 s; a mate that is farther off may as well be that of the next frame)."""
ONE_TIME = "no two frames have different times"


@dataclass(frozen=True, eq=False)
class TimePairs:
    """Frames in order; each has an image of the left camera, of the right one, or of both.

    Attributes:
        left, right: (n,) int64, positions in the cameras' own recording order; -1 where there is no mate.
        times_s: (n,) float64 [s] since the first frame, increasing.
        fps: nominal rate, of the camera that has more frames; NaN where all have one time, and they pair in order.
        notes: what was found on the way: unpaired frames, order, jumps.
    """

    left: I64
    right: I64
    times_s: F64
    fps: float
    notes: tuple[str, ...]

    @property
    def unpaired(self) -> int:
        """Frames without an image of one camera."""
        return int(np.count_nonzero((self.left < 0) | (self.right < 0)))


def pair_stamps(
    left_ns: I64, right_ns: I64, names: tuple[str, str] = ("left", "right"), *, one_clock: bool = False
) -> TimePairs:
    """Pair frames that are nearest to each other and at most ``PAIRED_WITHIN`` frame periods apart.

    Times run on at the nominal rate where the clock was set meanwhile; frames that arrive late are put in their place.

    Args:
        left_ns, right_ns: (n,) and (m,) int64 [ns], in the order of the recording.
        names: of the two, for the notes.
        one_clock: whether times that differ by a constant are those of one clock.
    """
    longer = max(left_ns, right_ns, key=len)
    steps = np.diff(np.sort(longer))
    steps = steps[steps > 0]
    if not steps.size:
        order = np.arange(len(longer))
        left = np.where(order < len(left_ns), order, -1)
        right = np.where(order < len(right_ns), order, -1)
        return TimePairs(left, right, np.zeros(len(order)), math.nan, (ONE_TIME,))
    period = float(np.median(steps))  # of the camera that has more frames [ns]
    tolerance = period * PAIRED_WITHIN
    offset = 0 if one_clock else _ahead(left_ns, right_ns, tolerance)
    left_mate, right_mate = _mates(left_ns, right_ns - offset, tolerance)
    left_eras = _eras(left_ns, period)
    right_eras = _eras(right_ns, period)
    # Frames of the left camera with their mates, then those that only the right one has; in order of their times.
    alone = np.flatnonzero(right_mate < 0)
    stamps = np.concatenate([left_ns, right_ns[alone] - offset])
    eras = np.concatenate([left_eras, right_eras[alone]])
    order = np.lexsort((stamps, eras))
    left = np.concatenate([np.arange(len(left_ns)), np.full(len(alone), -1)])[order]
    right = np.concatenate([left_mate, alone])[order]
    steps_ns = np.diff(stamps[order]).astype(np.float64)
    jumps = np.flatnonzero(np.diff(eras[order]))
    jumps_s = steps_ns[jumps] / 1e9
    steps_ns[jumps] = period
    times = np.concatenate([[0.0], np.cumsum(steps_ns)])[: len(stamps)] / 1e9
    again = np.diff(times, prepend=-1.0) <= 0
    left[again] = -1
    right[again] = -1
    notes = _alone_notes(left, right, names, tolerance)
    if offset:
        notes.append(
            f"the clock of {names[1]} is {_span(offset / 1e9)} from that of {names[0]}: paired in order; if that "
            "camera began later instead, leave out the frames that the other one lacks"
        )
    notes += _note_on(again, "with the time of the frame before, skipped")
    for name, stamps_ns, of_era in ((names[0], left_ns, left_eras), (names[1], right_ns, right_eras)):
        is_late = (np.diff(stamps_ns) < 0) & (np.diff(of_era) == 0)
        notes += _note_on(is_late, f"of {name} recorded out of order, put in order of their times")
    for after, jump_s in zip(jumps, jumps_s, strict=True):
        notes.append(f"the clock jumps by {_span(jump_s)} after frame {after}: times run on at the nominal rate")
    return TimePairs(left, right, times, 1e9 / period, tuple(notes))


def _alone_notes(left: I64, right: I64, names: tuple[str, str], tolerance_ns: float) -> list[str]:
    """A note on frames that only one of the cameras has."""
    counts = np.count_nonzero([(left >= 0) & (right < 0), (right >= 0) & (left < 0)], axis=1)
    if not counts.any():
        return []
    each = ", ".join(f"{count} of {name}" for count, name in zip(counts, names, strict=True) if count)
    return [
        f"{counts.sum()} of {len(left)} frames without a mate within {tolerance_ns / 1e6:.1f} ms, a quarter of the "
        f"frame period, skipped ({each})"
    ]


def _note_on(frames: Bool, what: str) -> list[str]:
    """A note on frames, with their number; none where there are none."""
    count = int(frames.sum())
    return [f"{count} frame{'s' * (count > 1)} {what}"] if count else []


def _ahead(left_ns: I64, right_ns: I64, tolerance_ns: float) -> int:
    """By how much the clock of the right camera is ahead [ns]: all frames are as far apart. 0 with other counts, where
    which belong together would be a guess."""
    if len(left_ns) != len(right_ns) or not len(left_ns):
        return 0
    ahead = int(np.median(right_ns - left_ns))
    constant = np.all(np.abs(right_ns - left_ns - ahead) <= tolerance_ns)
    return ahead if constant and abs(ahead) > tolerance_ns else 0


def _mates(left_ns: I64, right_ns: I64, tolerance_ns: float) -> tuple[I64, I64]:
    """Position of each frame's mate in the other camera, -1 without one; mates are nearest to each other."""
    left_mate = np.full(len(left_ns), -1)
    right_mate = np.full(len(right_ns), -1)
    if len(left_ns) and len(right_ns):
        to_right = _nearest(left_ns, right_ns)
        to_left = _nearest(right_ns, left_ns)
        near = np.abs(left_ns - right_ns[to_right]) <= tolerance_ns
        mutual = near & (to_left[to_right] == np.arange(len(left_ns)))
        left_mate[mutual] = to_right[mutual]
        right_mate[to_right[mutual]] = np.flatnonzero(mutual)
    return left_mate, right_mate


def _nearest(of: I64, among: I64) -> I64:
    order = np.argsort(among, kind="stable")
    ordered = among[order]
    after = np.clip(np.searchsorted(ordered, of), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(np.abs(of - ordered[before]) <= np.abs(ordered[after] - of), before, after)
    return np.asarray(order[nearer], dtype=np.int64)


def _eras(stamps: I64, period: float) -> I64:
    """Number of times that the clock was set before each frame."""
    was_set = clock_is_set(np.diff(stamps) / 1e9, period / 1e9)
    return np.concatenate([[0], np.cumsum(was_set)]).astype(np.int64)[: len(stamps)]


def _span(seconds: float) -> str:
    return f"{seconds / 86400:+.1f} days" if abs(seconds) >= 86400 else f"{seconds:+.3g} s"


MAX_APART_S = 0.02
"""The tool of the TUM RGB-D benchmark associates an image and a depth image up to 20 ms apart; a quarter of the frame
period, as for the pairs of two cameras, where that is more."""


def nearest_mates(images: I64, depths: I64) -> I64:
    """Position of the depth image of each of (n,) images among (m,) int64 [ns], -1 without one: nearest to each other,
    and near enough."""
    period = float(np.median(np.diff(np.sort(images)))) if len(images) > 1 else 0.0
    return _mates(images, depths, max(MAX_APART_S * 1e9, PAIRED_WITHIN * period))[0]


def depth_note(mates: I64, where: str = "") -> list[str]:
    """Note on images without a depth image; ``where`` they were searched, by their times when empty."""
    alone = int((mates < 0).sum())
    where = where or f"within {MAX_APART_S * 1e3:g} ms"
    return [f"{alone} of {len(mates)} images without a depth image {where}, skipped"] if alone else []
