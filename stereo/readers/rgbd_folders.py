"""Folders of images and of their depth, as datasets, Open3D and the tools of Kinect and RealSense write them."""

from __future__ import annotations

import math
import re
from collections.abc import Generator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.formats.rgbd import load_rgbd
from stereo.readers.depth_files import DepthFiles, read_depth
from stereo.readers.depth_mates import depth_note, nearest_mates
from stereo.readers.images import ImageFiles, image_files
from stereo.readers.paired import both, rate_of
from stereo.readers.pairing import pair_files
from stereo.readers.reader import OpenOptions, Reader, Stream
from stereo.readers.rgbd_layout import RgbdLayout
from stereo.readers.source import Decoded, DecodedDepth
from stereo.readers.stamps import stamps_in_names
from stereo.readers.stereo_layout import FrameClock, clock_of

_COLOUR = re.compile(r"(?<![a-z])(rgb|colou?r|image|images|img|left)(?![a-z])|^(rgb|colou?r)", re.IGNORECASE)
_DEPTH = re.compile(r"depth", re.IGNORECASE)


def rgbd_pairs(
    images: ImageFiles, depths: DepthFiles, units_per_m: float | None, indices: Sequence[int] | None
) -> Generator[tuple[Decoded, DecodedDepth], None, None]:
    """Decodes images and their depth.

    Args:
        units_per_m: depth values per metre; those of ``depths`` when None.
        indices: of the frames, ascending; None for all.
    """
    return both(images, depths if units_per_m is None else depths.scaled(units_per_m), indices)


def _sides(path: Path) -> tuple[list[Path], list[Path]] | None:
    """Images and depth at a path: in two folders, or side by side in one, told apart by their names."""
    if not path.is_dir():
        return None
    folders = [f for f in path.iterdir() if f.is_dir()]
    colour = [f for f in folders if _COLOUR.search(f.name) and not _DEPTH.search(f.name)]
    depth = [f for f in folders if _DEPTH.search(f.name)]
    if len(colour) == 1 and len(depth) == 1:
        return image_files(colour[0]), image_files(depth[0])
    files = image_files(path)
    of_depth = [f for f in files if _DEPTH.search(f.stem)]
    of_colour = [f for f in files if not _DEPTH.search(f.stem)]
    return (of_colour, of_depth) if of_colour and of_depth else None


def _fits(path: Path) -> bool:
    sides = _sides(path)
    return sides is not None and all(sides) and read_depth(sides[1][0]) is not None


def _find(path: Path, options: OpenOptions) -> RgbdLayout:
    sides = _sides(path)
    if sides is None:
        raise InputError(f"{path}: expected images and depth, found neither")
    timed = None if (path / "timestamps.csv").is_file() else _timed(*sides)
    pairs = timed.pairs if timed else pair_files(*sides)
    clock = clock_of(path, options, math.nan) if timed is None or options.fps is not None else timed.clock
    images, depths = ImageFiles([pair[0] for pair in pairs]), DepthFiles([pair[1] for pair in pairs])
    return RgbdLayout(
        path, path, partial(rgbd_pairs, images, depths),
        (Stream("image", images.size, len(sides[0]), clock.times_s),
         Stream("depth", depths.size, len(sides[1]), clock.times_s)),
        len(pairs), clock.fps, clock.times_s, partial(load_rgbd, options.calibration or path, images.size, depths.size),
        clock.notes, clock.even, assumed=() if clock.times_s is not None else clock.notes,
    )  # fmt: skip


class _Timed(NamedTuple):
    """Images with the depth of their times."""

    pairs: list[tuple[Path | None, Path | None]]
    clock: FrameClock


def _timed(images: list[Path], depths: list[Path]) -> _Timed | None:
    """Pairs by the times that the names of the files hold; None where they number the frames."""
    stamps = stamps_in_names([file.stem for file in images]), stamps_in_names([file.stem for file in depths])
    if stamps[0] is None or stamps[1] is None:
        return None
    order, depth_order = np.argsort(stamps[0].ns), np.argsort(stamps[1].ns)
    ns, depth_ns = stamps[0].ns[order], stamps[1].ns[depth_order]
    mates = nearest_mates(ns, depth_ns)
    if not (mates >= 0).any():
        return None
    times = np.asarray((ns - ns[0]) / 1e9, dtype=np.float64)
    pairs: list[tuple[Path | None, Path | None]] = [
        (images[i], depths[depth_order[mate]] if mate >= 0 else None) for i, mate in zip(order, mates, strict=True)
    ]
    return _Timed(pairs, FrameClock(rate_of(times), times, tuple(depth_note(mates))))


READER = Reader("rgbd", "images with depth", "rgb/ (or color/) and depth/ with images of 16 bits", _fits, _find)
