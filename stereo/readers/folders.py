"""Images as files, in a folder for each camera or all in one: of two cameras, or of one and its depth."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.rgbd import load_rgbd
from calib.io import entries
from stereo.depth import Depths
from stereo.readers import base
from stereo.readers.images import Colour, bits_note, bits_of, frame_number, image_files, images_of
from stereo.readers.pairing import (
    Pair,
    depth_note,
    nearest_mates,
    numbering_note,
    one_of_each,
    pair_files,
    split_sides,
)
from stereo.readers.times import stamps_of
from stereo.readers.unknown import inside_text
from stereo.recording import FrameClock, OpenOptions


class Sides(NamedTuple):
    """Folder and files of each camera, and a file's number where its own name is not enough."""

    folders: tuple[Path, Path]
    files: tuple[list[Path], list[Path]]
    number: Callable[[Path], int | None] = frame_number


def in_folders(left: Path, right: Path) -> Sides:
    """The images of two folders."""
    return Sides((left, right), (image_files(left), image_files(right)))


def sides_layout(path: Path, sides: Sides, folder: Path, options: OpenOptions) -> base.Layout:
    """Images of two cameras by the times in lists next to them or in their names, else, and where there is a
    timestamps.csv, by their names; that, calibration and world.toml lie in ``folder``."""
    each = list(zip(sides.folders, sides.files, strict=True))
    for side, found in each:
        if not found:
            raise InputError(f"{side}: expected images of one camera, found {inside_text(side)}")
    if not (folder / "timestamps.csv").is_file():
        timed = [base.TimedFiles(at, files, own.ns) for at, files in each if (own := stamps_of(files, at, folder))]
        if len(timed) == 2:
            given = options.calibration or folder
            return base.timed_layout(path, timed[0], timed[1], options, partial(load_rig, given), (), folder)
    pairs = pair_files(*sides.files, sides.number)
    return files_layout(path, pairs, options, folder, numbering_note(pairs, sides.number))


def files_layout(
    path: Path, pairs: Sequence[Pair], options: OpenOptions, folder: Path | None = None, notes: Sequence[str] = ()
) -> base.Layout:
    """Images that pair by their names, at the times of the folder's timestamps.csv."""
    folder, sides = folder or path, ([pair[0] for pair in pairs], [pair[1] for pair in pairs])
    bits = bits_of(*sides)
    a, b = (images_of(files, Colour(bits)) for files in sides)
    left, right = (next(file for file in files if file) for files in sides)
    names = (left, right) if left.parent == right.parent else (left.parent, right.parent)
    size, clock = base.same_size(a, b, *names), base.clock_of(folder, options, len(pairs), files=images_there(pairs))
    streams = tuple(
        source.stream(name, sum(file is not None for file in files), clock.times_s)
        for name, files, source in zip(("left", "right"), sides, (a, b), strict=True)
    )
    each = base.FramePairs(base.together(a, b), len(pairs), sum(None in pair for pair in pairs))
    rig = partial(load_rig, options.calibration or folder, size)
    return base.stereo_layout(path, each, streams, clock, rig, (*notes, *bits_note(bits)), folder)


def images_there(pairs: Sequence[Pair]) -> list[Path | None]:
    """An image of each pair, None where both are missing."""
    return [first or second for first, second in pairs]


def _sides(path: Path) -> Sides | None:
    if not path.is_dir():
        return None
    left, right = path / "left", path / "right"
    if left.is_dir() and right.is_dir():
        return in_folders(left, right)
    folders = one_of_each([f for f in entries(path) if f.is_dir()])
    if folders and all(map(image_files, folders)):
        return in_folders(*folders)
    files = image_files(path)
    sided = split_sides([file.stem for file in files])
    if sided is None or len(sided.left) + len(sided.right) < len(files):
        return None
    numbers = {file: frame_number(Path(rest)) for file, rest in zip(files, sided.rest, strict=True)}
    return Sides((path, path), ([files[i] for i in sided.left], [files[i] for i in sided.right]), numbers.get)


FOLDERS = base.Reader(
    "folders",
    "images of two cameras",
    lambda path: _sides(path) is not None,
    lambda path, options: sides_layout(path, _sides(path) or in_folders(path, path), path, options),
)


_COLOUR = re.compile(r"(?<![a-z])(rgb|colou?r|image|images|img|left)(?![a-z])|^(rgb|colou?r)", re.IGNORECASE)
_DEPTH = re.compile(r"depth", re.IGNORECASE)
_REGISTERED = re.compile(r"registered|aligned|depth_?(to|2|in)_?(rgb|colou?r)", re.IGNORECASE)


def _colour_and_depth(path: Path) -> tuple[list[Path], list[Path]] | None:
    """Images and depth at a path: in two folders, or side by side in one, distinguished by their names."""
    if not path.is_dir():
        return None
    folders = [f for f in entries(path) if f.is_dir()]
    colour = [f for f in folders if _COLOUR.search(f.name) and not _DEPTH.search(f.name)]
    depth = [f for f in folders if _DEPTH.search(f.name)]
    if len(depth) > 1:  # depth in the pixels of its image
        depth = [f for f in depth if _REGISTERED.search(f.name)]
    if len(colour) == 1 and len(depth) == 1:
        return image_files(colour[0]), image_files(depth[0])
    files = image_files(path)
    of_depth = [f for f in files if _DEPTH.search(f.stem)]
    of_colour = [f for f in files if not _DEPTH.search(f.stem)]
    if not of_depth:  # 0001.jpg and 0001.png
        kinds = {suffix: [f for f in files if f.suffix == suffix] for suffix in {f.suffix for f in files}}
        deep = {suffix for suffix, own in kinds.items() if _is_deep(own[0])}
        if len(kinds) == 2 and len(deep) == 1:
            (of_depth,) = (kinds[suffix] for suffix in deep)
            (of_colour,) = (kinds[suffix] for suffix in kinds.keys() - deep)
    return (of_colour, of_depth) if of_colour and of_depth else None


def _is_deep(file: Path) -> bool:
    """Whether an image has one channel of more than 8 bits, by its header."""
    with suppress(Exception), Image.open(file) as header:  # libraries raise whatever a damaged file provokes
        return header.mode.startswith(("I", "F"))
    return False


def _find_rgbd(path: Path, options: OpenOptions) -> base.Layout:
    sides = _colour_and_depth(path)
    if sides is None:
        raise InputError(f"{path}: expected images and depth, found neither")
    timed = None if (path / "timestamps.csv").is_file() else _timed(*sides, path)
    pairs = timed[0] if timed else pair_files(*sides)
    notes = () if timed else numbering_note(pairs)
    clock = (
        timed[1]
        if timed and options.fps is None
        else base.clock_of(path, options, len(pairs), files=images_there(pairs))
    )
    images, depths = images_of([pair[0] for pair in pairs], Colour()), images_of([pair[1] for pair in pairs], Depths())
    streams = (
        images.stream("image", len(sides[0]), clock.times_s),
        depths.stream("depth", len(sides[1]), clock.times_s),
    )
    rig = partial(load_rgbd, options.calibration or path, images.size, depths.size)
    return base.rgbd_layout(path, images, depths, streams, clock, rig, notes)


def _timed(images: list[Path], depths: list[Path], folder: Path) -> tuple[list[Pair], FrameClock] | None:
    """Images with the depth of their time, by files of times or the names; None where these number the frames."""
    stamps, depth_stamps = (stamps_of(files, files[0].parent, folder) for files in (images, depths))
    if stamps is None or depth_stamps is None:
        return None
    order = np.argsort(stamps.ns)
    ns, mates = stamps.ns[order], nearest_mates(stamps.ns[order], depth_stamps.ns)
    if not (mates >= 0).any():
        return None
    times = np.asarray((ns - ns[0]) / 1e9, dtype=np.float64)
    pairs = [(images[i], depths[mate] if mate >= 0 else None) for i, mate in zip(order, mates, strict=True)]
    return list(pairs), base.clock_of_times(times, depth_note(mates))


RGBD_FOLDERS = base.Reader(
    "rgbd", "images with depth", lambda path: all(_colour_and_depth(path) or (False,)), _find_rgbd
)
