"""Images as files, in a folder for each camera or all in one, with left and right in their names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from calib.errors import InputError
from calib.formats import load_rig
from calib.io import entries
from stereo.readers import images
from stereo.readers.base import (
    Layout,
    Reader,
    Stream,
    TimedFiles,
    clock_of,
    pixel_text,
    rig_in,
    same_size,
    stereo_layout,
    timed_layout,
    together,
)
from stereo.readers.images import Colour, bits_note, bits_of, frame_number, image_files, images_of
from stereo.readers.pairing import Pair, one_of_each, pair_files, split_sides
from stereo.readers.times import stamps_of
from stereo.recording import OpenOptions


class _Sides(NamedTuple):
    """Folder and files of each camera, and a file's number where its own name is not enough."""

    folders: tuple[Path, Path]
    files: tuple[list[Path], list[Path]]
    number: Callable[[Path], int | None] = frame_number


def _find(path: Path, options: OpenOptions) -> Layout:
    folders, flat = _folders(path), _flat(path)
    if folders is not None or flat is None:
        return folder_pair(path, *(folders or (path, path)), path, options)
    return _sides_layout(path, flat, path, options)


def folder_pair(path: Path, left: Path, right: Path, folder: Path, options: OpenOptions) -> Layout:
    """Images in two folders; calibration, times and world.toml lie in a third."""
    sides = _Sides((left, right), (image_files(left), image_files(right)))
    for side, found in zip(sides.folders, sides.files, strict=True):
        if not found:
            raise InputError(f"{side}: expected images ({', '.join(sorted(images.SUFFIXES))}), found none")
    return _sides_layout(path, sides, folder, options)


def _sides_layout(path: Path, sides: _Sides, folder: Path, options: OpenOptions) -> Layout:
    timed = _timed(folder, sides)
    if timed is not None:
        return timed_layout(path, *timed, options, partial(load_rig, options.calibration or folder), folder=folder)
    return files_layout(path, pair_files(*sides.files, sides.number), options, folder)


def files_layout(path: Path, pairs: Sequence[Pair], options: OpenOptions, folder: Path | None = None) -> Layout:
    """Images that pair by their names, at the times of the folder's timestamps.csv."""
    folder, sides = folder or path, ([pair[0] for pair in pairs], [pair[1] for pair in pairs])
    bits = bits_of(*sides)
    a, b = (images_of(files, Colour(bits)) for files in sides)
    left, right = (next(file for file in files if file) for files in sides)
    names = (left, right) if left.parent == right.parent else (left.parent, right.parent)
    size, clock = same_size(a, b, *names), clock_of(folder, options, len(pairs))
    streams = tuple(
        Stream(name, size, sum(file is not None for file in files), clock.times_s, pixel_text(source.is_grey, bits))
        for name, files, source in zip(("left", "right"), sides, (a, b), strict=True)
    )
    return stereo_layout(
        path, together(a, b), streams, len(pairs), clock, rig_in(folder, options, size), bits_note(bits),
        unpaired=sum(None in pair for pair in pairs), folder=folder,
    )  # fmt: skip


def _folders(path: Path) -> tuple[Path, Path] | None:
    left, right = path / "left", path / "right"
    if left.is_dir() and right.is_dir():
        return left, right
    subfolders = [f for f in entries(path) if f.is_dir()]
    sides = one_of_each(subfolders)
    return sides if sides and all(map(image_files, sides)) else None


def _flat(path: Path) -> _Sides | None:
    files = image_files(path)
    sided = split_sides([file.stem for file in files])
    if sided is None or len(sided.left) + len(sided.right) < len(files):
        return None
    numbers = {file: frame_number(Path(rest)) for file, rest in zip(files, sided.rest, strict=True)}
    return _Sides((path, path), ([files[i] for i in sided.left], [files[i] for i in sided.right]), numbers.get)


def _timed(path: Path, sides: _Sides) -> tuple[TimedFiles, TimedFiles] | None:
    """Times in lists next to the images, or in their names; None without, or with a timestamps.csv of the recording."""
    if (path / "timestamps.csv").is_file():
        return None
    each = zip(sides.folders, sides.files, strict=True)
    timed = [TimedFiles(at, files, own.ns) for at, files in each if (own := stamps_of(files, at, path))]
    return (timed[0], timed[1]) if len(timed) == 2 else None


READER = Reader(
    "folders",
    "images of two cameras",
    "folders left/ and right/ of images, or images with left and right in their names",
    lambda path: path.is_dir() and (_folders(path) is not None or _flat(path) is not None),
    _find,
)
