"""``planview calibrate convert``: a calibration from one format to another."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from calib.errors import InputError
from calib.formats import calibration_files, load_rig, write_rig
from calib.io import parse_length, parse_size
from calib.rig import StereoRig
from planview.commands.options import Flag, JsonFlag


def calibrate_convert(
    source: Annotated[Path, Parameter(name="IN")],
    target: Annotated[Path, Parameter(name="OUT")],
    /,
    *,
    to: str | None = None,
    size: str | None = None,
    unit: str | None = None,
    cameras: str | None = None,
    swap: Flag = False,
    json_: JsonFlag = False,
) -> None:
    """Convert a calibration from one format to another.

    Example: planview calibrate convert intrinsics.yml rig.toml --size 640x480 --unit 24.23mm

    Parameters
    ----------
    source
        Calibration file (either one of a pair) or a folder that holds one; the format is recognised by its content.
    target
        File or folder to write.
    to
        Format to write: rig, opencv, depthai, kalibr, ros, zed, kitti, euroc or middlebury; else taken from the suffix.
    size
        Image size WxH: selects a resolution, supplies one the file lacks, or scales.
    unit
        Length of the file's unit of translation, e.g. mm, or 24.23mm for a file in chessboard squares.
    cameras
        Left and right camera of a file with more than two, e.g. cam1,cam2.
    swap
        The file calls the right camera left.
    json_
        Print one JSON object on stdout.
    """
    rig = load_rig(
        source,
        None if size is None else parse_size(size, "--size"),
        cameras=None if cameras is None else _pair(cameras),
        unit_m=None if unit is None else parse_length(unit, "--unit"),
        swap=swap,
    )
    written = write_rig(rig, target, to, calibration_files(source))
    print(f"{rig.source}: baseline {rig.baseline_m:.4f} m, {rig.left.width}x{rig.left.height}", file=sys.stderr)
    print(f"wrote {', '.join(map(str, written))}", file=sys.stderr)
    if json_:
        print(json.dumps(_result(rig, written)))


def _result(rig: StereoRig, written: list[Path]) -> dict[str, Any]:
    """The ``--json`` object."""
    return {
        "source": rig.source,
        "baseline_m": rig.baseline_m,
        "width": rig.left.width,
        "height": rig.left.height,
        "model": rig.left.model,
        "files": [str(path) for path in written],
    }


def _pair(text: str) -> tuple[str, str]:
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise InputError(f"--cameras: expected two different names such as cam0,cam1, found {text!r}")
    return names[0], names[1]
