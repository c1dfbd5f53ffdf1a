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
from stereo.readers.images import Colour, frame_number, image_files, images_of
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
    have_table = (folder / "timestamps.csv").is_file()
    timed = []
    for at, files in zip(sides.folders, sides.files, strict=True):
        if not files:
            raise InputError(f"{at}: expected images of one camera, found {inside_text(at)}")
        stamps = None if have_table else stamps_of(files, at, folder)
        if stamps:
            timed.append(base.TimedFiles(at, files, stamps.ns))
    if len(timed) == 2:
        rig = partial(load_rig, options.calibration or folder)
        return base.timed_layout(path, timed[0], timed[1], options, rig, (), folder)
    pairs = pair_files(*sides.files, sides.number)
    return files_layout(path, pairs, options, folder, numbering_note(pairs, sides.number))


def files_layout(
    path: Path, pairs: Sequence[Pair], options: OpenOptions, folder: Path | None = None, notes: Sequence[str] = ()
) -> base.Layout:
    """Images that pair by their names, at the times of the folder's timestamps.csv."""
    place = folder or path
    clock = base.clock_of(place, options, len(pairs), files=images_there(pairs))
    left = [first for first, _ in pairs]
    right = [second for _, second in pairs]
    rig = partial(load_rig, options.calibration or place)
    return base.images_layout(path, left, right, clock, rig, notes, place)


def images_there(pairs: Sequence[Pair]) -> list[Path | None]:
    """An image of each pair, None where both are missing."""
    return [first or second for first, second in pairs]


def _sides(path: Path) -> Sides | None:
    if not path.is_dir():
        return None
    left = path / "left"
    right = path / "right"
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
    folders = [entry for entry in entries(path) if entry.is_dir()]
    depth = [folder for folder in folders if _DEPTH.search(folder.name)]
    colour = [folder for folder in folders if _COLOUR.search(folder.name) and folder not in depth]
    if len(depth) > 1:  # depth in the pixels of its image
        depth = [folder for folder in depth if _REGISTERED.search(folder.name)]
    if len(colour) == 1 and len(depth) == 1:
        return image_files(colour[0]), image_files(depth[0])
    files = image_files(path)
    of_depth = [file for file in files if _DEPTH.search(file.stem)] or _deep_files(files)
    of_colour = [file for file in files if file not in set(of_depth)]
    return (of_colour, of_depth) if of_colour and of_depth else None


def _deep_files(files: Sequence[Path]) -> list[Path]:
    """The images of the one kind of two, such as 0001.jpg and 0001.png, that has more than 8 bits; none elsewhere."""
    firsts = {file.suffix: file for file in reversed(files)}
    deep = [suffix for suffix, file in firsts.items() if _is_deep(file)] if len(firsts) == 2 else []
    return [file for file in files if deep == [file.suffix]]


def _is_deep(file: Path) -> bool:
    """True if an image has one channel of more than 8 bits, by its header."""
    with suppress(Exception), Image.open(file) as header:  # libraries raise whatever a damaged file provokes
        return header.mode.startswith(("I", "F"))
    return False


def _find_rgbd(path: Path, options: OpenOptions) -> base.Layout:
    sides = _colour_and_depth(path)
    if sides is None:
        raise InputError(f"{path}: expected images and depth, found neither")
    pairs, clock = (None, None) if (path / "timestamps.csv").is_file() else _pair_by_time(*sides, path)
    notes: tuple[str, ...] = ()
    if pairs is None:
        pairs = pair_files(*sides)
        notes = numbering_note(pairs)
    if clock is None or options.fps is not None:
        clock = base.clock_of(path, options, len(pairs), files=images_there(pairs))
    images = images_of([image for image, _ in pairs], Colour())
    depths = images_of([depth for _, depth in pairs], Depths())
    streams = (
        images.stream("image", len(sides[0]), clock.times_s),
        depths.stream("depth", len(sides[1]), clock.times_s),
    )
    rig = partial(load_rgbd, options.calibration or path, images.size, depths.size)
    return base.rgbd_layout(path, images, depths, streams, clock, rig, notes)


def _pair_by_time(
    images: list[Path], depths: list[Path], folder: Path
) -> tuple[list[Pair], FrameClock] | tuple[None, None]:
    """Images with the depth of their time, by files of times or the names; None where these number the frames."""
    stamps = stamps_of(images, images[0].parent, folder)
    depth_stamps = stamps_of(depths, depths[0].parent, folder)
    if stamps is None or depth_stamps is None:
        return None, None
    order = np.argsort(stamps.ns)
    ns = stamps.ns[order]
    mates = nearest_mates(ns, depth_stamps.ns)
    if not (mates >= 0).any():
        return None, None
    pairs: list[Pair] = []
    for image, depth in zip(order, mates, strict=True):
        pairs.append((images[image], depths[depth] if depth >= 0 else None))
    return pairs, base.clock_of_times(base.own_times(ns), depth_note(mates))


RGBD_FOLDERS = base.Reader(
    "rgbd", "images with depth", lambda path: all(_colour_and_depth(path) or (False,)), _find_rgbd
)
