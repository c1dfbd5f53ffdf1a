"""Two cameras whose images are files with times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.rig import StereoRig
from calib.types import F64, I64
from stereo.readers.bits import bits_note
from stereo.readers.images import ImageFiles, bits_of
from stereo.readers.pair import both
from stereo.readers.reader import OpenOptions, Stream
from stereo.readers.stereo_layout import Size, StereoLayout, same_size
from stereo.readers.time_pairs import TimePairs, pair_stamps


class TimedFiles(NamedTuple):
    """One camera.

    Attributes:
        folder: for messages.
        files: in the order of the recording.
        ns: (n,) int64 [ns], when each was taken.
    """

    folder: Path
    files: Sequence[Path]
    ns: I64


def timed_layout(
    path: Path,
    left: TimedFiles,
    right: TimedFiles,
    options: OpenOptions,
    rig: Callable[[Size], StereoRig],
    notes: Sequence[str] = (),
) -> StereoLayout:
    """Pair the images by their times.

    Args:
        rig: reads the calibration for images of a size.
    Raises:
        InputError: no image of a camera can be decoded, sizes differ, or nothing pairs.
    """
    for side in (left, right):
        if not side.files:
            raise InputError(f"{side.folder}: expected images, found none")
    pairs = pair_stamps(left.ns, right.ns)
    check_paired(pairs, path)
    bits = bits_of(left.files, right.files)
    a, b = (
        ImageFiles([side.files[i] if i >= 0 else None for i in order], bits)
        for side, order in ((left, pairs.left), (right, pairs.right))
    )
    size = same_size(a, b, left.folder, right.folder)
    streams = tuple(
        Stream(name, size, len(side.files), own_times(side.ns), pixel_text(source.is_grey, bits))
        for name, side, source in (("left", left, a), ("right", right, b))
    )
    times, fps = times_of(pairs, options)
    return StereoLayout(
        path, path, size, partial(both, a, b), streams, len(pairs.left), fps, times, partial(rig, size),
        (*notes, *pairs.notes, *bits_note(bits)),
        unpaired=pairs.unpaired,
    )  # fmt: skip


def check_paired(pairs: TimePairs, path: Path) -> None:
    """Refuse two recordings of different times.

    Raises:
        InputError: not one frame has a mate.
    """
    if not np.any((pairs.left >= 0) & (pairs.right >= 0)):
        raise InputError(
            f"{path}: expected frames of the two cameras within a quarter of the frame period ({250 / pairs.fps:.1f} "
            f"ms), found none: their clocks differ, or they are two recordings"
        )


def times_of(pairs: TimePairs, options: OpenOptions) -> tuple[F64, float]:
    """Times by frame index [s] and nominal rate; even ones where the caller gives a rate."""
    if options.fps is None:
        return pairs.times_s, pairs.fps
    return np.arange(len(pairs.left)) / options.fps, options.fps


def own_times(ns: I64) -> F64:
    """(n,) float64 [s] since the first."""
    return np.asarray((ns - ns[0]) / 1e9, dtype=np.float64) if len(ns) else np.empty(0)


def pixel_text(grey: bool, bits: int | None) -> str:
    """What a pixel is, for people."""
    kind = "grey" if grey else "colour"
    return kind if bits is None else f"{kind}, {bits} bits in 16"
