"""Published data sets in their own layout: EuRoC, KITTI, Middlebury and TUM RGB-D.

TUM RGB-D: Sturm et al. 2012, A Benchmark for the Evaluation of RGB-D SLAM Systems, and its page on file formats:
rgb.txt and depth.txt with ``timestamp filename``, depth of 16 bits with 5000 values per metre, registered to the
images.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.rgbd import find_rgbd, load_rgbd
from calib.io import entries, read_text
from calib.rig import RgbdRig
from calib.times import is_time, read_stamps
from calib.types import I64
from stereo.depth import Depths
from stereo.readers.base import Layout, Reader, TimedFiles, clock_of_times, own_times, rgbd_layout, timed_layout
from stereo.readers.folders import files_layout
from stereo.readers.images import Colour, frame_number, image_files, images_of
from stereo.readers.pairing import MAX_APART_S, depth_note, nearest_mates
from stereo.readers.times import MAX_BYTES, list_in, read_rows
from stereo.recording import FrameClock, OpenOptions


def _euroc_root(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def _euroc_find(path: Path, options: OpenOptions) -> Layout:
    root = _euroc_root(path)
    left, right = (_euroc_camera(root / name) for name in ("cam0", "cam1"))
    return timed_layout(path, left, right, options, partial(load_rig, options.calibration or root))


def _euroc_camera(folder: Path) -> TimedFiles:
    data = folder / "data"
    listed = folder / "data.csv"
    if not listed.is_file():
        files = image_files(data)
        return TimedFiles(data, files, read_stamps(data, [file.stem for file in files]).ns)
    times, names = _read_list(listed)
    # The format gives nanoseconds; converted recordings hold seconds under the same name.
    return TimedFiles(data, [data / Path(name).name for name in names], read_stamps(listed, times).ns)


class _ImageList(NamedTuple):
    """Columns of a list: times as they are written, and names of files."""

    times: list[str]
    names: list[str]


def _read_list(file: Path) -> _ImageList:
    """The rows of a list with a time and the name of an image in each; Windows writes names with backslashes. Raises
    InputError: a row without these, or no row."""
    rows = read_rows(file, "rows of timestamp and file name")
    if rows and "time" in rows[0].cells[0].lower():  # names of the columns
        rows = rows[1:]
    for line, cells in rows:
        if len(cells) < 2 or not is_time(cells[0]):
            found = " ".join(cells)[:80]
            raise InputError(f"{file}: expected timestamp and file name in line {line}, found {found!r}")
    if not rows:
        raise InputError(f"{file}: expected lines of timestamp and file name, found none")
    names = [row.cells[1].replace("\\", "/") for row in rows]
    return _ImageList([row.cells[0] for row in rows], names)


EUROC = Reader(
    "euroc",
    "an EuRoC ASL folder",
    lambda path: all((_euroc_root(path) / camera / "data").is_dir() for camera in ("cam0", "cam1")),
    _euroc_find,
)


KITTI_PAIRS = (("image_02", "image_03"), ("image_00", "image_01"))
"""The colour and the grey pair of a drive."""


def _kitti_find(path: Path, options: OpenOptions) -> Layout:
    drives = list(_kitti_drives(path))
    if len(drives) > 1:
        names = ", ".join(drive.name for drive in drives[:6])
        raise InputError(f"{path}: expected one drive, found {len(drives)} ({names}): name the drive's folder")
    drive = drives[0]
    pair = _pair_in(drive) or KITTI_PAIRS[0]
    cameras = []
    for name in pair:
        listed = list_in(drive / name)
        if listed is None:
            raise InputError(f"{drive / name / 'timestamps.txt'}: expected the times of the images, found no such file")
        cameras.append(_kitti_camera(drive / name / "data", listed))
    places = [folder / "calib_cam_to_cam.txt" for folder in (drive, drive.parent)]
    calibration = options.calibration or next((place for place in places if place.is_file()), drive)
    # Drives that end with _sync are rectified, those that end with _extract are not (KITTI raw data, readme.txt).
    rectified = {"_sync": True, "_extract": False}.get("_" + drive.name.rsplit("_", 1)[-1])
    chosen = (pair[0][-2:], pair[1][-2:]) if calibration.name == "calib_cam_to_cam.txt" else None
    rig = partial(load_rig, calibration, cameras=chosen, rectified=rectified)
    return timed_layout(path, cameras[0], cameras[1], options, rig)


def _kitti_drives(path: Path) -> Iterator[Path]:
    """The folder itself, its drives, and those of its days, which hold a pair."""
    if _pair_in(path):
        yield path
        return
    for folder in (f for f in entries(path) if f.is_dir() and os.access(f, os.X_OK)):
        if _pair_in(folder):
            yield folder
        elif folder.name.count("_") == 2:
            days = (f for f in sorted(folder.iterdir()) if f.is_dir() and "_drive_" in f.name)
            yield from (f for f in days if _pair_in(f))


def _pair_in(drive: Path) -> tuple[str, str] | None:
    """The first pair of cameras that both have images."""

    def has_images(name: str) -> bool:
        folder = drive / name / "data"
        return folder.is_dir() and bool(image_files(folder))

    return next((pair for pair in KITTI_PAIRS if all(map(has_images, pair))), None)


def _kitti_camera(folder: Path, times: Path) -> TimedFiles:
    """Image number n has the time of line n, counted from 0; numbers may be missing, and their lines be empty."""
    files = image_files(folder)
    lines = read_text(times, "times", MAX_BYTES).rstrip().split("\n")
    texts = []
    for file in files:
        number = frame_number(file)
        if number is None or number >= len(lines) or not lines[number].strip():
            raise InputError(
                f"{times}: expected a time for {file.name}, found none: image n has line n, counted from 0"
            )
        texts.append(lines[number])
    return TimedFiles(folder, files, read_stamps(times, texts).ns)


KITTI = Reader(
    "kitti", "a KITTI raw drive", lambda path: path.is_dir() and any(True for _ in _kitti_drives(path)), _kitti_find
)
MIDDLEBURY_NAMES = (("im0", "im1"), ("view1", "view5"), ("im2", "im6"))
"""Left and right of each year's data sets (vision.middlebury.edu/stereo/data)."""


def _middlebury_pair(path: Path) -> tuple[Path, Path] | None:
    by_stem = {file.stem: file for file in image_files(path)}
    pairs = ((by_stem[left], by_stem[right]) for left, right in MIDDLEBURY_NAMES if {left, right} <= by_stem.keys())
    return next(pairs, None)


MIDDLEBURY = Reader(
    "middlebury",
    "a Middlebury pair",
    lambda path: path.is_dir() and _middlebury_pair(path) is not None,
    lambda path, options: files_layout(path, [_middlebury_pair(path) or (None, None)], options),
)

TUM_CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
"""Camera that the benchmark recommends where a sequence is not calibrated (Kinect's nominal values)."""
_ASSOCIATIONS = ("associations.txt", "association.txt", "associate.txt", "assoc.txt", "associated.txt")


class Listed(NamedTuple):
    """The images of one list: (n,) int64 [ns], increasing, their file names as listed, and notes on skipped lines."""

    ns: I64
    names: list[str]
    notes: tuple[str, ...]


def _tum_find(path: Path, options: OpenOptions) -> Layout:
    images = _read_tum_list(path / "rgb.txt")
    depths = _read_tum_list(path / "depth.txt")
    associated = next((path / name for name in _ASSOCIATIONS if (path / name).is_file()), None)
    mates = _read_tum_mates(associated, images, depths) if associated else nearest_mates(images.ns, depths.ns)
    if not (mates >= 0).any():
        raise InputError(f"{path}: expected images and depth of the same times, found none within {MAX_APART_S:g} s")
    image_files = images_of([_inside(path, name) for name in images.names], Colour())
    depth_files = images_of([_inside(path, depths.names[i]) if i >= 0 else None for i in mates], Depths(5000.0))
    times_s = own_times(images.ns)
    clock = clock_of_times(times_s) if options.fps is None else FrameClock(options.fps, even=True)
    streams = (
        image_files.stream("image", len(images.ns), times_s),
        depth_files.stream("depth", len(depths.ns), (depths.ns - images.ns[0]) / 1e9),
    )
    notes = [*images.notes, *depths.notes, *depth_note(mates, f"in {associated.name}" if associated else "")]
    rig = partial(load_rgbd, options.calibration or path, image_files.size, depth_files.size)
    if find_rgbd(path) is None:
        notes.append("no calibration: the nominal Kinect camera is taken (fx = fy = 525 at 640x480)")
        if options.calibration is None:
            nominal = RgbdRig(TUM_CAMERA, source="nominal Kinect camera")
            rig = partial(nominal.scaled, image_files.size, depth_files.size)
    return rgbd_layout(path, image_files, depth_files, streams, clock, rig, notes)


def _read_tum_mates(file: Path, images: Listed, depths: Listed) -> I64:
    """Mates as a file of associations lists them: time, image, time, depth, either first."""
    places = {name: i for i, name in enumerate(images.names)}
    depth_places = {name: i for i, name in enumerate(depths.names)}
    mates = np.full(len(images.names), -1)
    for _, cells in read_rows(file, "associations"):
        words = [cell.replace("\\", "/") for cell in cells]
        image = next((places[word] for word in words if word in places), None)
        depth = next((depth_places[word] for word in words if word in depth_places), None)
        if image is None or depth is None:
            raise InputError(f"{file}: expected images of rgb.txt and depth.txt, found {' '.join(words)[:80]!r}")
        mates[image] = depth
    return mates


def _read_tum_list(file: Path) -> Listed:
    times, names = _read_list(file)
    stamps = read_stamps(file, times)
    kept: list[int] = []
    for i in sorted(range(len(names)), key=lambda i: (stamps.ns[i], names[i])):
        if not kept or stamps.ns[kept[-1]] != stamps.ns[i]:
            kept.append(i)
    notes = []
    if len(kept) < len(names):
        notes.append(f"{len(names) - len(kept)} lines of {file.name} with the time of another, skipped")
    if stamps.unit != "s":
        notes.append(f"times of {file.name} are taken as {'dates' if stamps.unit == 'date' else stamps.unit}")
    return Listed(stamps.ns[kept], [names[i] for i in kept], tuple(notes))


def _inside(folder: Path, name: str) -> Path:
    """The file of a list, which must lie inside the recording."""
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name:
        raise InputError(f"{folder}: expected file names inside the recording, found {name[:80]!r}")
    return path


TUM_RGBD = Reader(
    "tum-rgbd", "TUM RGB-D", lambda path: (path / "rgb.txt").is_file() and (path / "depth.txt").is_file(), _tum_find
)
