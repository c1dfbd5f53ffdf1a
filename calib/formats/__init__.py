"""Calibrations as other tools write them: one file per format, found by content."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from calib.formats.depthai import FORMAT as DEPTHAI
from calib.formats.find import find_rig
from calib.formats.native import FORMAT as NATIVE
from calib.formats.opencv import FORMAT as OPENCV
from calib.formats.source import Choice
from calib.rig import StereoRig

FORMATS = (NATIVE, OPENCV, DEPTHAI)

__all__ = ["FORMATS", "load_rig"]


def load_rig(
    path: Path,
    size: tuple[int, int] | None = None,
    *,
    cameras: tuple[str, str] | None = None,
    unit_m: float | None = None,
) -> StereoRig:
    """Read a stereo calibration in any supported format, told by its content.

    Args:
        path: a calibration file (of a pair, either half), or a folder that holds one calibration.
        size: (width, height) of the recording's images [px]: selects a resolution where the file holds several,
            supplies it where it holds none; a calibration of another size and the same aspect is scaled, which
            ``source`` then says.
        cameras: names of the left and right camera (or sockets) where the file holds more than two.
        unit_m: length of the unit of the file's translations [m]; None: what the format prescribes.
    Returns:
        The rig, checked (``StereoRig.check``).
    Raises:
        InputError: nothing readable there, not a stereo rig, or a rig for another image size.
    """
    choice = Choice(size, cameras, unit_m)
    found, sources = find_rig(path, FORMATS)
    name = "+".join(str(source.path) for source in sources)
    try:
        rig = found.read(sources, choice)
    except (ValueError, TypeError, KeyError, IndexError, OverflowError) as error:
        raise InputError(f"{name}: expected a calibration ({found.name}), {_detail(error)}") from error
    return _fitted(rig.check(name), name, size)


def _detail(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if "expected" in text else f"found {text}"


def _fitted(rig: StereoRig, name: str, size: tuple[int, int] | None) -> StereoRig:
    if rig.left.size != rig.right.size:
        raise InputError(
            f"{name}: expected two cameras of one image size, found {_text(rig.left.size)} and {_text(rig.right.size)}"
        )
    own = rig.left.size
    if size is None or size == own:
        return rig
    if size[0] * own[1] != size[1] * own[0]:
        raise InputError(
            f"{name}: expected a calibration for images of {_text(size)}, found one for {_text(own)} (another aspect)"
        )
    scaled = rig.scaled(*size)
    return StereoRig(
        scaled.left, scaled.right, rig.right_SE3_left, f"{rig.source} (scaled from {_text(own)} to {_text(size)})"
    )


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
