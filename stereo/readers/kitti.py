"""KITTI: raw drives (image_00 to image_03 with timestamps.txt) and odometry sequences (image_0 to image_3)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.rig import StereoRig
from calib.text import read_text
from stereo.readers.images import frame_number, image_files
from stereo.readers.reader import OpenOptions, Reader
from stereo.readers.stamps import read_stamps
from stereo.readers.stereo_layout import Size, StereoLayout
from stereo.readers.timed_files import TimedFiles, timed_layout
from stereo.readers.timestamps import stamp_list

PAIRS = (("image_02", "image_03"), ("image_00", "image_01"))
"""The colour and the grey pair."""
SEQUENCE_PAIRS = (("image_2", "image_3"), ("image_0", "image_1"))
"""The same of an odometry sequence."""


def _fits(path: Path) -> bool:
    return path.is_dir() and any(_pair(drive) for drive in _drives(path))


def _find(path: Path, options: OpenOptions) -> StereoLayout:
    drives = [drive for drive in _drives(path) if _pair(drive)]
    if len(drives) > 1:
        names = ", ".join(drive.name for drive in drives[:6])
        raise InputError(f"{path}: expected one drive, found {len(drives)} ({names}): name the drive's folder")
    drive = drives[0]
    pair = _pair(drive) or PAIRS[0]
    left, right = (_camera(drive / name) for name in pair)
    calibration = options.calibration or _calibration(drive)

    def rig(size: Size) -> StereoRig:
        # Drives that end with _sync are rectified, those that end with _extract are not (KITTI raw data, readme.txt).
        rectified = True if drive.name.endswith("_sync") else False if drive.name.endswith("_extract") else None
        first, second = (name[-2:] for name in pair)
        cameras = (first, second) if calibration.name == "calib_cam_to_cam.txt" else None
        return load_rig(calibration, size, cameras=cameras, rectified=rectified)

    note = () if pair == PAIRS[0] or not _colour(drive) else ("the grey cameras are taken: a colour one lacks images",)
    return timed_layout(path, left, right, options, rig, note)


def _fits_sequence(path: Path) -> bool:
    return (path / "times.txt").is_file() and _sequence_pair(path) is not None


def _find_sequence(path: Path, options: OpenOptions) -> StereoLayout:
    pair = _sequence_pair(path) or SEQUENCE_PAIRS[0]
    left, right = (_listed_camera(path / name, path / "times.txt") for name in pair)

    def rig(size: Size) -> StereoRig:
        own = options.calibration is None
        cameras = (pair[0][-1], pair[1][-1]) if own else None
        return load_rig(options.calibration or path / "calib.txt", size, cameras=cameras, rectified=own or None)

    return timed_layout(path, left, right, options, rig, ())


def _sequence_pair(path: Path) -> tuple[str, str] | None:
    for pair in SEQUENCE_PAIRS:
        if all((path / name).is_dir() and image_files(path / name) for name in pair):
            return pair
    return None


def _listed_camera(folder: Path, times: Path) -> TimedFiles:
    """Image number n has the time of line n, in seconds with an exponent."""
    texts = [f"{_seconds(times, text):.9f}" for text in read_text(times, "times", 10_000_000).split()]
    return _timed(folder, image_files(folder), times, texts)


def _seconds(times: Path, text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not abs(seconds) < 1e9:
        raise InputError(f"{times}: expected times in seconds, found {text[:40]!r}")
    return seconds


def _drives(path: Path) -> Iterator[Path]:
    """The folder itself, its drives, and those of its days."""
    if _pair(path):
        yield path
        return
    for folder in (f for f in sorted(path.iterdir()) if f.is_dir()):
        if _pair(folder):
            yield folder
        elif folder.name.count("_") == 2:
            yield from (f for f in sorted(folder.iterdir()) if f.is_dir() and "_drive_" in f.name)


def _pair(drive: Path) -> tuple[str, str] | None:
    for pair in PAIRS:
        if all((drive / name / "data").is_dir() and image_files(drive / name / "data") for name in pair):
            return pair
    return None


def _colour(drive: Path) -> bool:
    return any((drive / name).is_dir() for name in PAIRS[0])


def _camera(folder: Path) -> TimedFiles:
    """Image number n has the time of line n, counted from 0; numbers may be missing."""
    files = image_files(folder / "data")
    listed = stamp_list(folder)
    if listed is None:
        raise InputError(f"{folder / 'timestamps.txt'}: expected the times of the images, found no such file")
    return _timed(folder, files, listed.path, listed.texts)


def _timed(folder: Path, files: Sequence[Path], times: Path, texts: Sequence[str]) -> TimedFiles:
    """Images with the times of their numbers."""
    try:
        ns = read_stamps(texts).ns
    except ValueError as error:
        raise InputError(f"{times}: {error}") from error
    numbers = [frame_number(file) for file in files]
    if any(number is None or number >= len(ns) for number in numbers):
        raise InputError(f"{times}: expected a time for each of {len(files)} images, found {len(ns)}")
    return TimedFiles(folder, files, np.asarray(ns[np.array(numbers)], dtype=np.int64))


def _calibration(drive: Path) -> Path:
    places = [folder / "calib_cam_to_cam.txt" for folder in (drive, drive.parent)]
    return next((place for place in places if place.is_file()), drive)


READER = Reader(
    "kitti",
    "a KITTI raw drive",
    "image_00 and image_01 with timestamps.txt (KITTI)",
    _fits,
    _find,
)
SEQUENCE = Reader(
    "kitti-sequence",
    "a KITTI odometry sequence",
    "image_0 and image_1 with times.txt (KITTI odometry)",
    _fits_sequence,
    _find_sequence,
)
