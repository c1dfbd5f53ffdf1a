"""Published data sets in their own layout: EuRoC, KITTI, Middlebury and TUM RGB-D.

TUM RGB-D: Sturm et al. 2012, A Benchmark for the Evaluation of RGB-D SLAM Systems, and its page on file formats:
rgb.txt and depth.txt with ``timestamp filename``, depth of 16 bits with 5000 values per metre, registered to the
images.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from decimal import Decimal
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.base import read_source
from calib.formats.rgbd import find_rgbd, load_rgbd
from calib.io import entries, read_text
from calib.rig import RgbdRig
from calib.types import I64
from stereo.depth import Depths
from stereo.readers.base import Layout, Reader, TimedFiles, clock_of_times, own_times, rgbd_layout, timed_layout
from stereo.readers.folders import files_layout
from stereo.readers.images import Colour, frame_number, image_files, images_of
from stereo.readers.pairing import MAX_APART_S, depth_note, nearest_mates
from stereo.readers.times import MAX_BYTES, NS, read_stamps, stamp_list
from stereo.recording import FrameClock, OpenOptions


def _euroc_root(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def _euroc_find(path: Path, options: OpenOptions) -> Layout:
    root = _euroc_root(path)
    first, second = (_euroc_camera(root / name) for name in ("cam0", "cam1"))
    if options.calibration is None:
        try:
            load_rig(root)
        except InputError as error:
            if "left and right are swapped" in str(error):
                note = "cam0 is the right camera by its calibration, and cam1 the left one: taken so"
                return timed_layout(path, second, first, options, partial(load_rig, root, swap=True), (note,))
    own = options.calibration or root
    return timed_layout(path, first, second, options, partial(load_rig, own), calibration=own)


def _euroc_camera(folder: Path) -> TimedFiles:
    data, listed = folder / "data", folder / "data.csv"
    if listed.is_file():
        lines = read_text(listed, "rows of timestamp,filename", MAX_BYTES).splitlines()
        rows = [line.split(",") for line in lines if line.strip() and not line.lstrip().startswith("#")]
        if short := [row for row in rows if len(row) < 2]:
            raise InputError(f"{listed}: expected rows of timestamp,filename, found {short[0][0][:60]!r}")
        texts, files = [row[0] for row in rows], [data / Path(row[1].strip()).name for row in rows]
    else:
        files = image_files(data)
        texts = [file.stem for file in files]
    # The format gives nanoseconds; converted recordings hold seconds under the same name.
    return TimedFiles(data, files, read_stamps(listed if listed.is_file() else data, texts).ns)


def _is_euroc(path: Path) -> bool:
    return all((_euroc_root(path) / camera / "data").is_dir() for camera in ("cam0", "cam1"))


EUROC = Reader("euroc", "an EuRoC ASL folder", _is_euroc, _euroc_find)


KITTI_PAIRS = (("image_02", "image_03"), ("image_00", "image_01"))
KITTI_SEQUENCE_PAIRS = (("image_2", "image_3"), ("image_0", "image_1"))
"""The colour and the grey pair of a drive, and of an odometry sequence."""


def _kitti_find(path: Path, options: OpenOptions) -> Layout:
    drives = list(_kitti_drives(path))
    if len(drives) > 1:
        names = ", ".join(drive.name for drive in drives[:6])
        raise InputError(f"{path}: expected one drive, found {len(drives)} ({names}): name the drive's folder")
    drive = drives[0]
    pair = _pair_in(drive, KITTI_PAIRS, "data") or KITTI_PAIRS[0]
    cameras = []
    for name in pair:
        listed = stamp_list(drive / name)
        if listed is None:
            raise InputError(f"{drive / name / 'timestamps.txt'}: expected the times of the images, found no such file")
        cameras.append(_kitti_camera(drive / name / "data", *listed))
    places = [folder / "calib_cam_to_cam.txt" for folder in (drive, drive.parent)]
    calibration = options.calibration or next((place for place in places if place.is_file()), drive)
    # Drives that end with _sync are rectified, those that end with _extract are not (KITTI raw data, readme.txt).
    rectified = {"_sync": True, "_extract": False}.get("_" + drive.name.rsplit("_", 1)[-1])
    chosen = (pair[0][-2:], pair[1][-2:]) if calibration.name == "calib_cam_to_cam.txt" else None
    grey = pair != KITTI_PAIRS[0] and any((drive / name).is_dir() for name in KITTI_PAIRS[0])
    notes = ("the grey cameras are taken: a colour one lacks images",) if grey else ()
    rig = partial(load_rig, calibration, cameras=chosen, rectified=rectified)
    return timed_layout(path, cameras[0], cameras[1], options, rig, notes)


def _kitti_sequence_find(path: Path, options: OpenOptions) -> Layout:
    pair, times = _pair_in(path, KITTI_SEQUENCE_PAIRS) or KITTI_SEQUENCE_PAIRS[0], path / "times.txt"
    texts = read_text(times, "times", MAX_BYTES).split()
    left, right = (_kitti_camera(path / name, times, texts) for name in pair)
    own = options.calibration is None
    names = (pair[0][-1], pair[1][-1]) if own else None
    rig = partial(load_rig, options.calibration or path / "calib.txt", cameras=names, rectified=own or None)
    return timed_layout(path, left, right, options, rig)


def _kitti_drives(path: Path) -> Iterator[Path]:
    """The folder itself, its drives, and those of its days, which hold a pair."""
    if _pair_in(path, KITTI_PAIRS, "data"):
        yield path
        return
    for folder in (f for f in entries(path) if f.is_dir() and os.access(f, os.X_OK)):
        if _pair_in(folder, KITTI_PAIRS, "data"):
            yield folder
        elif folder.name.count("_") == 2:
            days = (f for f in sorted(folder.iterdir()) if f.is_dir() and "_drive_" in f.name)
            yield from (f for f in days if _pair_in(f, KITTI_PAIRS, "data"))


def _pair_in(folder: Path, pairs: Sequence[tuple[str, str]], inside: str = "") -> tuple[str, str] | None:
    """The first pair of folders that both hold images."""

    def holds(name: str) -> bool:
        return (folder / name / inside).is_dir() and bool(image_files(folder / name / inside))

    return next((pair for pair in pairs if all(map(holds, pair))), None)


def _kitti_camera(folder: Path, times: Path, texts: Sequence[str]) -> TimedFiles:
    """Image number n has the time of line n, counted from 0; numbers may be missing."""
    files, ns = image_files(folder), read_stamps(times, texts).ns
    numbers = [frame_number(file) for file in files]
    if any(number is None or number >= len(ns) for number in numbers):
        raise InputError(f"{times}: expected a time for each of {len(files)} images, found {len(ns)}")
    return TimedFiles(folder, files, np.asarray(ns[np.array(numbers)], dtype=np.int64))


KITTI = Reader(
    "kitti", "a KITTI raw drive", lambda path: path.is_dir() and any(True for _ in _kitti_drives(path)), _kitti_find
)
KITTI_SEQUENCE = Reader(
    "kitti-sequence",
    "a KITTI odometry sequence",
    lambda path: (path / "times.txt").is_file() and _pair_in(path, KITTI_SEQUENCE_PAIRS) is not None,
    _kitti_sequence_find,
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
"""What the benchmark recommends where a sequence is not calibrated (Kinect's nominal values)."""
_ASSOCIATIONS = ("associations.txt", "association.txt", "associate.txt", "assoc.txt", "associated.txt")


class Listed(NamedTuple):
    """The images of one list: (n,) int64 [ns], increasing, their file names as listed, and notes on skipped lines."""

    ns: I64
    names: list[str]
    notes: tuple[str, ...]


def _tum_find(path: Path, options: OpenOptions) -> Layout:
    images, depths = _tum_listed(path / "rgb.txt"), _tum_listed(path / "depth.txt")
    associated = next((path / name for name in _ASSOCIATIONS if (path / name).is_file()), None)
    mates = _tum_associated(associated, images, depths) if associated else nearest_mates(images.ns, depths.ns)
    if not (mates >= 0).any():
        raise InputError(f"{path}: expected images and depth of the same times, found none within {MAX_APART_S:g} s")
    image_files = images_of([_inside(path, name) for name in images.names], Colour())
    depth_files = images_of([_inside(path, depths.names[i]) if i >= 0 else None for i in mates], Depths(5000.0))
    notes, held = depth_note(mates, f"in {associated.name}" if associated else ""), find_rgbd(path)
    if held is None:
        notes.append("no calibration: the nominal Kinect camera is taken (fx = fy = 525 at 640x480)")
    own = own_times(images.ns)
    clock = clock_of_times(own) if options.fps is None else FrameClock(options.fps, even=True)
    streams = (
        image_files.stream("image", len(images.ns), own),
        depth_files.stream("depth", len(depths.ns), (depths.ns - images.ns[0]) / 1e9),
    )
    sizes, remarks = (image_files.size, depth_files.size), (*images.notes, *depths.notes, *notes)
    rig = partial(load_rgbd, options.calibration or path, *sizes)
    if options.calibration is None and held is None:
        rig = partial(RgbdRig(TUM_CAMERA, source="nominal Kinect camera").scaled, *sizes)
    return rgbd_layout(path, image_files, depth_files, streams, clock, rig, remarks)


def _tum_associated(file: Path, images: Listed, depths: Listed) -> I64:
    """Mates as a file of associations lists them: time, image, time, depth, either first."""
    at, depth_at = ({name: i for i, name in enumerate(listed.names)} for listed in (images, depths))
    mates = np.full(len(images.names), -1)
    for _, words in _tum_rows(file):
        found, of_depth = ([places[word] for word in words if word in places] for places in (at, depth_at))
        if not (found and of_depth):
            raise InputError(f"{file}: expected images of rgb.txt and depth.txt, found {' '.join(words)[:80]!r}")
        mates[found[0]] = of_depth[0]
    return mates


def _tum_listed(file: Path) -> Listed:
    rows = []
    for line, words in _tum_rows(file):
        try:
            seconds, name = Decimal(words[0]), words[1]
            if not abs(seconds) * NS["s"] < 2**62:  # the year 2116: no seconds of a clock
                raise ValueError
        except (ArithmeticError, IndexError, ValueError):
            found = " ".join(words)[:80]
            raise InputError(f"{file}: expected timestamp and file name in line {line}, found {found!r}") from None
        rows.append((int(seconds * NS["s"]), name, line))
    if not rows:
        raise InputError(f"{file}: expected lines of timestamp and file name, found none")
    rows.sort()
    again = [(one, other) for one, other in pairwise(rows) if one[0] == other[0]]  # of one time, the first by name
    notes = [f"line {other[2]} of {file.name} has the time of line {one[2]}, skipped" for one, other in again[:1]]
    notes += [f"{len(again) - 1} more lines of {file.name} with the time of another, skipped"] * (len(again) > 1)
    times, names = list(dict.fromkeys(ns for ns, *_ in rows)), {ns: name for ns, name, _ in reversed(rows)}
    return Listed(np.array(times, dtype=np.int64), [names[ns] for ns in times], tuple(notes))


def _tum_rows(file: Path) -> list[tuple[int, list[str]]]:
    """Line number, from 1, and words of every line that holds any."""
    lines = enumerate((line.strip() for line in read_source(file).text.splitlines()), 1)
    return [(n, line.replace(",", " ").split()) for n, line in lines if line and not line.startswith("#")]


def _inside(folder: Path, name: str) -> Path:
    """The file of a list, which must lie inside the recording."""
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name:
        raise InputError(f"{folder}: expected file names inside the recording, found {name[:80]!r}")
    return path


TUM_RGBD = Reader(
    "tum-rgbd", "TUM RGB-D", lambda path: (path / "rgb.txt").is_file() and (path / "depth.txt").is_file(), _tum_find
)
