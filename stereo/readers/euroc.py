"""EuRoC MAV / ASL dataset format: mav0/cam0 and cam1, each with data.csv, data/ and sensor.yaml."""

from __future__ import annotations

import csv
from pathlib import Path

from calib.errors import InputError
from calib.formats import load_rig
from calib.rig import StereoRig
from calib.text import reason
from stereo.readers.images import image_files
from stereo.readers.reader import OpenOptions, Reader
from stereo.readers.stamps import read_stamps
from stereo.readers.stereo_layout import Size, StereoLayout
from stereo.readers.timed_files import TimedFiles, timed_layout

MAX_ROWS = 10_000_000
"""More rows than a day of 100 Hz are no list of images."""


def _fits(path: Path) -> bool:
    root = _root(path)
    return all((root / camera / "data").is_dir() for camera in ("cam0", "cam1"))


def _find(path: Path, options: OpenOptions) -> StereoLayout:
    root = _root(path)
    first, second = (_camera(root / name) for name in ("cam0", "cam1"))
    calibration = options.calibration or root
    if options.calibration is None and _swapped(root):
        note = "cam0 is the right camera by its calibration, and cam1 the left one: taken so"
        return timed_layout(path, second, first, options, lambda size: load_rig(root, size, swap=True), (note,))

    def rig(size: Size) -> StereoRig:
        return load_rig(calibration, size)

    return timed_layout(path, first, second, options, rig)


def _swapped(root: Path) -> bool:
    try:
        load_rig(root)
    except InputError as error:
        return "left and right are swapped" in str(error)
    return False


def _root(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def _camera(folder: Path) -> TimedFiles:
    data = folder / "data"
    listed = folder / "data.csv"
    if listed.is_file():
        rows = _rows(listed)
        names = [Path(row[1].strip()).name for row in rows]
        texts, files = [row[0] for row in rows], [data / name for name in names]
    else:
        files = image_files(data)
        texts = [file.stem for file in files]
    try:
        # The format gives nanoseconds; converted recordings hold seconds under the same name.
        return TimedFiles(data, files, read_stamps(texts).ns)
    except ValueError as error:
        raise InputError(f"{listed if listed.is_file() else data}: {error}") from error


def _rows(path: Path) -> list[list[str]]:
    rows: list[list[str]] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            for row in csv.reader(file):
                if not row or row[0].lstrip().startswith("#") or not row[0].strip():
                    continue
                if len(row) < 2 or len(rows) >= MAX_ROWS:
                    raise InputError(f"{path}: expected rows of timestamp,filename, found {','.join(row)[:60]!r}")
                rows.append(row)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected rows of timestamp,filename, found {reason(error)}") from error
    return rows


READER = Reader("euroc", "an EuRoC ASL folder", "mav0/cam0 and mav0/cam1 with data.csv (EuRoC)", _fits, _find)
