"""Middlebury: one rectified pair, im0 and im1 (2014, 2021), view1 and view5 (2005, 2006), im2 and im6 (2001, 2003)."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

from stereo.readers.bits import bits_note
from stereo.readers.images import ImageFiles, bits_of, image_files
from stereo.readers.pair import both
from stereo.readers.reader import OpenOptions, Reader, Stream
from stereo.readers.stereo_layout import StereoLayout, clock_of, rig_in, same_size
from stereo.readers.timed_files import pixel_text

NAMES = (("im0", "im1"), ("view1", "view5"), ("im2", "im6"))
"""Left and right of each year's data sets (vision.middlebury.edu/stereo/data)."""


def _fits(path: Path) -> bool:
    return path.is_dir() and _pair(path) is not None


def _find(path: Path, options: OpenOptions) -> StereoLayout:
    left, right = _pair(path) or (path, path)
    bits = bits_of([left], [right])
    a, b = ImageFiles([left], bits), ImageFiles([right], bits)
    size, clock = same_size(a, b, left, right), clock_of(path, options, math.nan)
    streams = tuple(
        Stream(name, size, 1, None, pixel_text(source.is_grey, bits))
        for name, source in (("left", a), ("right", b))
    )  # fmt: skip
    return StereoLayout(
        path, path, size, partial(both, a, b), streams, 1, clock.fps, clock.times_s, rig_in(path, options, size),
        bits_note(bits),
    )  # fmt: skip


def _pair(path: Path) -> tuple[Path, Path] | None:
    by_stem = {file.stem: file for file in image_files(path)}
    for left, right in NAMES:
        if {left, right} <= by_stem.keys():
            return by_stem[left], by_stem[right]
    return None


READER = Reader("middlebury", "a Middlebury pair", "im0 and im1 with calib.txt (Middlebury)", _fits, _find)
