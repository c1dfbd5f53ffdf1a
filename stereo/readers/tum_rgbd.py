"""The layout of the TUM RGB-D benchmark: lists of images and of depth with their times.

Sturm et al. 2012, A Benchmark for the Evaluation of RGB-D SLAM Systems, and its page on file formats: rgb.txt and
depth.txt with ``timestamp filename``, depth of 16 bits with 5000 values per metre, registered to the images.
"""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats.rgbd import find_rgbd, load_rgbd
from calib.formats.source import read_source
from calib.rgbd import RgbdRig
from calib.types import I64
from stereo.readers.depth_files import DepthFiles
from stereo.readers.depth_mates import MAX_APART_S, depth_note, nearest_mates
from stereo.readers.images import ImageFiles
from stereo.readers.paired import rate_of
from stereo.readers.reader import OpenOptions, Reader, Stream
from stereo.readers.rgbd_folders import rgbd_pairs
from stereo.readers.rgbd_layout import RgbdLayout
from stereo.readers.stamps import NS

UNITS_PER_M = 5000.0
DEFAULT_CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
"""What the benchmark recommends where a sequence is not calibrated (Kinect's nominal values)."""
_ASSOCIATIONS = ("associations.txt", "association.txt", "associate.txt", "assoc.txt", "associated.txt")


class Listed(NamedTuple):
    """The images of one list.

    Attributes:
        ns: (n,) int64 [ns], increasing.
        names: (n,) file names as listed.
    """

    ns: I64
    names: list[str]


def _fits(path: Path) -> bool:
    return (path / "rgb.txt").is_file() and (path / "depth.txt").is_file()


def _find(path: Path, options: OpenOptions) -> RgbdLayout:
    images, depths = _listed(path / "rgb.txt"), _listed(path / "depth.txt")
    associated = next((path / name for name in _ASSOCIATIONS if (path / name).is_file()), None)
    mates = _associated(associated, images, depths) if associated else nearest_mates(images.ns, depths.ns)
    if not (mates >= 0).any():
        raise InputError(f"{path}: expected images and depth of the same times, found none within {MAX_APART_S:g} s")
    image_files = ImageFiles([_inside(path, name) for name in images.names])
    depth_files = DepthFiles([_inside(path, depths.names[i]) if i >= 0 else None for i in mates], UNITS_PER_M)
    times = (images.ns - images.ns[0]) / 1e9 if options.fps is None else np.arange(len(images.ns)) / options.fps
    return RgbdLayout(
        path, path, partial(rgbd_pairs, image_files, depth_files),
        (Stream("image", image_files.size, len(images.ns), (images.ns - images.ns[0]) / 1e9),
         Stream("depth", depth_files.size, len(depths.ns), (depths.ns - images.ns[0]) / 1e9)),
        len(images.ns), rate_of(times), np.asarray(times, dtype=np.float64),
        partial(_rig, path, options.calibration, image_files.size, depth_files.size), _notes(mates, associated, path),
    )  # fmt: skip


def _notes(mates: I64, associated: Path | None, path: Path) -> tuple[str, ...]:
    notes = depth_note(mates, f"in {associated.name}" if associated else "")
    if find_rgbd(path) is None:
        notes.append("no calibration: the nominal Kinect camera is taken (fx = fy = 525 at 640x480)")
    return tuple(notes)


def _rig(path: Path, calibration: Path | None, size: tuple[int, int], depth_size: tuple[int, int]) -> RgbdRig:
    """The calibration that was named or lies in the folder, else the benchmark's own."""
    if calibration is None and find_rgbd(path) is None:
        return RgbdRig(DEFAULT_CAMERA, source="nominal Kinect camera").scaled(size, depth_size)
    return load_rgbd(calibration or path, size, depth_size)


def _associated(file: Path, images: Listed, depths: Listed) -> I64:
    """Mates as a file of associations lists them: time, image, time, depth, either first."""
    at = {name: i for i, name in enumerate(images.names)}
    depth_at = {name: i for i, name in enumerate(depths.names)}
    mates = np.full(len(images.names), -1)
    for words in _rows(file):
        names = [word for word in words if word in at or word in depth_at]
        image = next((at[name] for name in names if name in at), None)
        depth = next((depth_at[name] for name in names if name in depth_at), None)
        if image is None or depth is None:
            raise InputError(f"{file}: expected images of rgb.txt and depth.txt, found {' '.join(words)[:80]!r}")
        mates[image] = depth
    return mates


def _listed(file: Path) -> Listed:
    rows = []
    for words in _rows(file):
        try:
            ns = int(Decimal(words[0]) * NS["s"])
            rows.append((ns, words[1]))
        except (InvalidOperation, IndexError, ValueError, OverflowError):
            raise InputError(f"{file}: expected timestamp and file name, found {' '.join(words)[:80]!r}") from None
    if not rows:
        raise InputError(f"{file}: expected lines of timestamp and file name, found none")
    if not all(abs(ns) < 2**62 for ns, _ in rows):
        raise InputError(f"{file}: expected timestamps in seconds, found larger numbers")
    first = dict(sorted(rows, reverse=True))  # of one time, the first by name
    times = sorted(first)
    return Listed(np.array(times, dtype=np.int64), [first[ns] for ns in times])


def _rows(file: Path) -> list[list[str]]:
    lines = (line.strip() for line in read_source(file).text.splitlines())
    return [line.replace(",", " ").split() for line in lines if line and not line.startswith("#")]


def _inside(folder: Path, name: str) -> Path:
    """The file of a list, which must lie inside the recording."""
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(f"{folder}: expected file names inside the recording, found {name[:80]!r}")
    return path


READER = Reader("tum-rgbd", "TUM RGB-D", "rgb.txt and depth.txt", _fits, _find)
