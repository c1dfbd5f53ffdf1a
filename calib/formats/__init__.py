"""One file per foreign calibration format, and one function that finds and reads any of them."""

from __future__ import annotations

from pathlib import Path

from calib import rig as rig_toml
from calib.errors import InputError
from calib.formats import depthai, opencv
from calib.rig import StereoRig

EXTRINSICS_NAMES = ("extrinsics.yml", "extrinsics.yaml", "extrinsics.xml")


def load_rig(folder_or_file: Path, size: tuple[int, int]) -> StereoRig:
    """The calibration in a file, or beside a recording.

    Args:
        folder_or_file: a calibration file, or a folder that holds one.
        size: (width, height) [px] of the images, for formats that do not hold it.
    Raises:
        InputError: none found, several that disagree on where to look, unreadable, or not a rig.
    """
    path = folder_or_file
    if path.is_dir():
        found = _find(path)
        if found is None:
            raise InputError(f"{path}: expected a calibration (rig.toml, intrinsics.yml, EEPROM JSON), found none")
        path = found
    if not path.is_file():
        raise InputError(f"{path}: expected a calibration file, found none")
    if path.suffix == ".toml":
        return rig_toml.load_rig(path)
    if path.suffix == ".json":
        return depthai.load_rig(path)
    return opencv.load_rig(path, _extrinsics(path), size)


def _find(folder: Path) -> Path | None:
    rig = folder / "rig.toml"
    if rig.is_file():
        return rig
    for pattern in ("intrinsics.y*ml", "intrinsics.xml"):
        for path in sorted(folder.glob(pattern)):
            return path
    for path in sorted(folder.glob("*.json")):
        if "cameraData" in path.read_text(encoding="utf-8", errors="replace"):
            return path
    return None


def _extrinsics(intrinsics: Path) -> Path:
    for name in EXTRINSICS_NAMES:
        if (intrinsics.parent / name).is_file():
            return intrinsics.parent / name
    raise InputError(f"{intrinsics}: expected extrinsics.yml beside it, found none")
