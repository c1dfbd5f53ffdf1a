"""Which left image belongs to which right one."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from calib.errors import InputError
from stereo.readers.images import frame_number

MAX_UNPAIRED_FRACTION = 0.1
"""Above this share the folders are two recordings, not one with missing frames (our choice)."""

Pair = tuple[Path | None, Path | None]


def pair_files(left: list[Path], right: list[Path], number: Callable[[Path], int | None] = frame_number) -> list[Pair]:
    """Pairs in order; None where a file is missing.

    Numbered files pair by number: a number that only one side has, or that both leave out of an otherwise even
    sequence, is a missing frame, so that indices (and times) keep the gap. Files without numbers pair in sorted
    order. Beyond a tenth of unpaired numbers, or with different counts of unnumbered files, any pairing would be
    a guess that silently mates wrong frames, so it is refused.

    Args:
        number: a file's number, None when it has none.
    Raises:
        InputError: the folders do not pair; the first frame without a mate is named.
    """
    left_by, right_by = _numbered(left, number), _numbered(right, number)
    if left_by is None or right_by is None:
        return _in_order(left, right)
    either = sorted(left_by.keys() | right_by.keys())
    unpaired = [n for n in either if (n in left_by) != (n in right_by)]
    if unpaired and len(left) == len(right) and len(unpaired) > MAX_UNPAIRED_FRACTION * len(either):
        return list(zip(left, right, strict=True))  # e.g. numbered by two clocks
    if len(unpaired) > max(1.0, MAX_UNPAIRED_FRACTION * len(either)):
        raise _unpaired(left_by.get(unpaired[0]) or right_by[unpaired[0]], left, right)
    return [(left_by.get(n), right_by.get(n)) for n in even_sequence(either)]


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


def _numbered(files: list[Path], number: Callable[[Path], int | None]) -> dict[int, Path] | None:
    numbers = [number(file) for file in files]
    found = {n: file for n, file in zip(numbers, files, strict=True) if n is not None}
    return found if len(found) == len(files) else None


def _in_order(left: list[Path], right: list[Path]) -> list[Pair]:
    if len(left) != len(right):
        stems = {file.stem for file in left} & {file.stem for file in right}
        first = next((file for file in [*left, *right] if file.stem not in stems), left[0])
        raise _unpaired(first, left, right)
    return list(zip(left, right, strict=True))


def _unpaired(file: Path, left: list[Path], right: list[Path]) -> InputError:
    return InputError(
        f"{file}: expected a mate in the other folder for every image, "
        f"found none ({len(left)} left, {len(right)} right images)"
    )
