"""Calibrations as other tools write them: one file per format, recognised by content."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats.base import NATIVE, Choice, Format
from calib.formats.datasets import EUROC, KITTI, MIDDLEBURY
from calib.formats.devices import DEPTHAI, ZED
from calib.formats.find import find_rig
from calib.formats.opencv import FORMAT as OPENCV
from calib.formats.ros import KALIBR, ROS
from calib.formats.tsai import is_tsai
from calib.io import reason, size_text
from calib.rig import StereoRig

FORMATS: tuple[Format, ...] = (NATIVE, OPENCV, DEPTHAI, KALIBR, ROS, ZED, KITTI, EUROC, MIDDLEBURY)

MAX_TURN_DEG = 45.0
"""Cameras turned further against each other share no view worth matching (our choice)."""
MIN_FOCAL_WIDTHS, MAX_FOCAL_WIDTHS = 0.1, 30.0
"""A focal length outside these multiples of the image width is in other units (fisheye of 200 deg: 0.2)."""
MAX_BENT = 10.0
"""Rays through the middle half of an image lie within this factor of where they were without distortion; a fisheye of
200 deg has 2.4 (our choice)."""
MAX_OFF_IMAGE = 0.25
"""Share of the image by which a principal point may lie outside of it; crops rarely go further (our choice)."""

__all__ = ["FORMATS", "calibration_files", "load_rig", "refuse_strange_camera", "write_rig"]


def load_rig(
    path: Path,
    size: tuple[int, int] | None = None,
    *,
    cameras: tuple[str, str] | None = None,
    unit_m: float | None = None,
    swap: bool = False,
    rectified: bool | None = None,
) -> StereoRig:
    """Read a stereo calibration in any supported format, recognised by its content.

    Args:
        path: a calibration file (of a pair, either half), or a folder that holds one calibration.
        size: (width, height) of the recording's images [px]: selects a resolution where the file holds several,
            supplies it where it holds none; a calibration of another size and the same aspect is scaled, which
            ``source`` then notes.
        cameras: names of the left and right camera (or sockets) where the file holds more than two.
        unit_m: length of the unit of the file's translations [m]; None: what the format prescribes.
        swap: the file calls the right camera left.
        rectified: whether the images are, where a file holds both calibrations; None tells it by their size.
    Returns:
        The rig, checked (``StereoRig.check``).
    Raises:
        InputError: nothing readable there, not a stereo rig, or a rig for another image size.
    """
    choice = Choice(size, cameras, unit_m, rectified)
    found, sources = find_rig(path, FORMATS, is_tsai)
    name = "+".join(str(source.path) for source in sources)
    try:
        rig = found.read(sources, choice)
        refuse_strange_camera(rig.left, "left")
        refuse_strange_camera(rig.right, "right")
        turn = math.degrees(rig.right_SE3_left.angle_rad)
        if turn > MAX_TURN_DEG:
            raise ValueError(f"expected cameras that look the same way, found {turn:.0f} degrees between them")
    except (ValueError, TypeError, KeyError, IndexError, OverflowError, np.linalg.LinAlgError) as error:
        raise InputError(f"{name} ({found.name}): {_detail(error)}") from error
    return _fitted((rig.swapped() if swap else rig).check(name), name, size)


def calibration_files(path: Path) -> list[Path]:
    """The files that ``load_rig`` reads a calibration from (same errors)."""
    return [source.path for source in find_rig(path, FORMATS, is_tsai)[1]]


def write_rig(rig: StereoRig, path: Path, format_key: str | None = None, keep: Collection[Path] = ()) -> list[Path]:
    """Write a rig in a format.

    Args:
        path: file, or folder for formats of two files.
        format_key: ``Format.key``; None takes the first format that writes files of this suffix.
        keep: files that must not be written over.
    Returns:
        The files written.
    Raises:
        InputError: no such format, a format that cannot hold this rig exactly, a place that cannot be written, or a
            file to be kept.
    """
    chosen = _format_for(path, format_key)
    try:
        kept = {file.resolve() for file in keep}
        with TemporaryDirectory() as rehearsal:
            trial = Path(rehearsal) / (path.name or "rig")
            for file in chosen.write(rig, trial):
                target = (path / file.relative_to(trial)).resolve()
                if target in kept:
                    raise InputError(f"{path}: expected another place than the calibration read, found it at {target}")
        return chosen.write(rig, path)
    except ValueError as error:
        raise InputError(f"{path}: expected a rig that {chosen.name} can hold, but {error}") from error
    except OSError as error:
        raise InputError(f"{path}: expected a place to write to, found {reason(error)}") from error


def _format_for(path: Path, format_key: str | None) -> Format:
    keys = ", ".join(f.key for f in FORMATS)
    if format_key is not None:
        for one in FORMATS:
            if one.key == format_key:
                return one
        raise InputError(f"{path}: expected a format of {keys}, found {format_key!r}")
    for one in FORMATS:
        if one.suffix and one.suffix == path.suffix.lower():
            return one
    raise InputError(f"{path}: expected --to {keys}, because no format has the suffix of {path.name!r}")


def _detail(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if text.startswith("expected") else f"expected a calibration, found {text}"


def refuse_strange_camera(one: Camera, side: str) -> None:
    """A camera whose numbers belong to another image size or another unit, or whose lens shows no picture.

    Raises:
        ValueError: what was expected and found.
    """
    if not MIN_FOCAL_WIDTHS <= one.fx / one.width <= MAX_FOCAL_WIDTHS or not 0.5 <= one.fx / one.fy <= 2.0:
        raise ValueError(
            f"expected a {side} focal length in pixels of {one.width}x{one.height}, found fx={one.fx:g} fy={one.fy:g}"
        )
    off = max(abs(one.cx / one.width - 0.5), abs(one.cy / one.height - 0.5)) - 0.5
    if off > MAX_OFF_IMAGE:
        raise ValueError(
            f"expected a {side} principal point inside the image of {one.width}x{one.height}, "
            f"found ({one.cx:.1f}, {one.cy:.1f})"
        )
    u, v = (grid.ravel() for grid in np.meshgrid(*(np.linspace(0.25, 0.75, 5) * length for length in one.size)))
    straight = np.hypot((u - one.cx) / one.fx, (v - one.cy) / one.fy)
    with np.errstate(all="ignore"):
        bent = np.linalg.norm(one.unproject(np.column_stack([u, v]))[:, :2], axis=1)
    if not ((bent <= MAX_BENT * straight + 1e-3) & (straight <= MAX_BENT * bent + 1e-3)).all():
        shown = ", ".join(f"{k:g}" for k in one.distortion)
        raise ValueError(f"expected a {side} lens that shows the middle of its image, found distortion ({shown})")


def _fitted(rig: StereoRig, name: str, size: tuple[int, int] | None) -> StereoRig:
    if rig.left.size != rig.right.size:
        raise InputError(
            f"{name}: expected two cameras of one image size, "
            f"found {size_text(rig.left.size)} and {size_text(rig.right.size)}"
        )
    own = rig.left.size
    if size is None or size == own:
        return rig
    if size[0] * own[1] != size[1] * own[0]:
        raise InputError(
            f"{name}: expected a calibration for images of {size_text(size)}, "
            f"found one for {size_text(own)} (another aspect)"
        )
    scaled = rig.scaled(*size)
    source = f"{rig.source} (scaled from {size_text(own)} to {size_text(size)})"
    return StereoRig(scaled.left, scaled.right, rig.right_SE3_left, source)
