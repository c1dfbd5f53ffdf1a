"""Images as files, in a folder for each camera or all in one, with left and right in their names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from calib.errors import InputError
from calib.formats import load_rig
from calib.io import entries
from stereo.readers.base import (
    FramePairs,
    Layout,
    Reader,
    TimedFiles,
    clock_of,
    other_state,
    same_size,
    stereo_layout,
    timed_layout,
    together,
)
from stereo.readers.images import Colour, bits_note, bits_of, frame_number, image_files, images_of
from stereo.readers.pairing import Pair, one_of_each, pair_files, split_sides
from stereo.readers.times import stamps_of
from stereo.readers.unknown import inside_text
from stereo.recording import OpenOptions


class Sides(NamedTuple):
    """Folder and files of each camera, and a file's number where its own name is not enough."""

    folders: tuple[Path, Path]
    files: tuple[list[Path], list[Path]]
    number: Callable[[Path], int | None] = frame_number


def in_folders(left: Path, right: Path) -> Sides:
    """The images of two folders."""
    return Sides((left, right), (image_files(left), image_files(right)))


def sides_layout(path: Path, sides: Sides, folder: Path, options: OpenOptions) -> Layout:
    """Images of two cameras by the times in lists next to them or in their names, else, and where there is a
    timestamps.csv, by their names; that, calibration and world.toml lie in ``folder``."""
    each = list(zip(sides.folders, sides.files, strict=True))
    for side, found in each:
        if not found:
            raise InputError(f"{side}: expected images of one camera, found {inside_text(side)}")
    if not (folder / "timestamps.csv").is_file():
        timed = [TimedFiles(at, files, own.ns) for at, files in each if (own := stamps_of(files, at, folder))]
        if len(timed) == 2:
            given = options.calibration or folder
            return timed_layout(path, timed[0], timed[1], options, partial(load_rig, given), (), folder, given)
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
        source.stream(name, sum(file is not None for file in files), clock.times_s)
        for name, files, source in zip(("left", "right"), sides, (a, b), strict=True)
    )
    return stereo_layout(
        path, FramePairs(together(a, b), len(pairs), sum(None in pair for pair in pairs)), streams, clock,
        partial(load_rig, options.calibration or folder, size), bits_note(bits), folder,
        other_state(options.calibration or folder, size),
    )  # fmt: skip


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


READER = Reader(
    "folders",
    "images of two cameras",
    lambda path: _sides(path) is not None,
    lambda path, options: sides_layout(path, _sides(path) or in_folders(path, path), path, options),
)
