"""Folders of images, one for each camera."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

from calib.errors import InputError
from stereo.readers import images
from stereo.readers.images import ImageFiles, image_files
from stereo.readers.pair import both
from stereo.readers.pairing import pair_files
from stereo.readers.reader import OpenOptions, Reader
from stereo.readers.stereo_layout import StereoLayout, clock_of, rig_in, same_size, stream


def _fits(path: Path) -> bool:
    return (path / "left").is_dir() and (path / "right").is_dir()


def _find(path: Path, options: OpenOptions) -> StereoLayout:
    left, right = path / "left", path / "right"
    files = image_files(left), image_files(right)
    for folder, found in zip((left, right), files, strict=True):
        if not found:
            raise InputError(f"{folder}: expected images ({', '.join(sorted(images.SUFFIXES))}), found none")
    pairs = pair_files(*files)
    a, b = ImageFiles([pair[0] for pair in pairs]), ImageFiles([pair[1] for pair in pairs])
    size, clock = same_size(a, b, left, right), clock_of(path, options, math.nan)
    return StereoLayout(
        path, path, size, partial(both, a, b), (stream("left", a), stream("right", b)), len(pairs), clock.fps,
        clock.times_s, rig_in(path, options, size), clock.notes,
    )  # fmt: skip


READER = Reader("folders", "folders of images", "left/ and right/ with images", _fits, _find)
