"""OpenCV FileStorage: intrinsics (M1 D1 M2 D2) and extrinsics (R T), in one file or two, or the projections (P1 P2) of
rectified images alone; YAML, XML or JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import LensModel
from calib.formats import base
from calib.formats.base import Choice, Format, Size, Source
from calib.io import parse_size, size_text
from calib.rig import StereoRig
from calib.types import F64

_K1 = ("M1", "K1", "cameraMatrix1", "mtxL", "K_left")
_K2 = ("M2", "K2", "cameraMatrix2", "mtxR", "K_right")
_D1 = ("D1", "distCoeffs1", "distL", "D_left")
_D2 = ("D2", "distCoeffs2", "distR", "D_right")
_R = ("R", "rot")
_T = ("T", "T_m", "trans")
"""Names that OpenCV's samples and the usual calibrators and tutorials write."""
_LENS_COUNTS = (0, 4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV's lens models have."""


def _keys(*each: tuple[str, ...]) -> base.Keys:
    """Keys of YAML, JSON and XML, each by any of its names; messages use the first."""
    patterns = {}
    for names in each:
        key = f"({'|'.join(names)})"
        # A bare number after the colon is a line of KITTI's.
        patterns[names[0]] = rf'<{key}[ >]|^\s*{key}\s*:(?! *[-\d])|"{key}"\s*:'
    return base.lines_with(**patterns)


_CAMERAS = _keys(_K1, _D1, _K2, _D2, _R, _T)
_RECTIFIED = _keys(("P1",), ("P2",))

COMMON_SIZES = [
    parse_size(text)
    for text in [
        "320x240", "376x240", "640x360", "640x400", "640x480", "672x376", "752x480", "800x600", "848x480", "1024x768",
        "1280x720", "1280x800", "1280x960", "1280x1024", "1600x1200", "1920x1080", "1920x1200", "2048x1536",
        "2208x1242", "2592x1944", "3840x2160",
    ]
]  # fmt: skip
"""Sizes of usual sensors [px], for files that hold none."""


def _part(source: Source) -> str | None:
    keys = dict(_CAMERAS)
    has_matrix = keys["M1"].search(source.text) is not None
    has_pose = keys["T"].search(source.text) is not None
    if "opencv-matrix" in source.text and has_matrix != has_pose:
        return "left" if has_matrix else "right"
    return base.whole_with(_CAMERAS, _RECTIFIED)(source)


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data: dict[str, Any] = {}
    for source in sources:
        data.update(parse_storage(source.text))
    name = "+".join(source.path.name for source in sources)
    only_rectified = not any(key in data for key in _K1)
    rectified = only_rectified or (choice.rectified and "P1" in data)
    return _rectified_rig(data, choice, name) if rectified else _camera_rig(data, choice, name)


def _rectified_rig(data: Mapping[str, Any], choice: Choice, name: str) -> StereoRig:
    """The cameras of images that P1 and P2 rectified: P = K [I | t]."""
    size, remark = _size(data, choice, base.numbers_at(data, 12, "P1"), base.numbers_at(data, 12, "P2"))
    left = base.camera_from_projection(size, data["P1"], "P1", choice.unit())
    right = base.camera_from_projection(size, data["P2"], "P2", choice.unit())
    return base.join_cameras(left, right, f"{name}{remark} [rectified images]")


def _camera_rig(data: Mapping[str, Any], choice: Choice, name: str) -> StereoRig:
    left_matrix = base.numbers_at(data, 9, *_K1)
    right_matrix = base.numbers_at(data, 9, *_K2)
    size, remark = _size(data, choice, left_matrix, right_matrix)
    left_lens = base.numbers_at(data, _LENS_COUNTS, *_D1)
    right_lens = base.numbers_at(data, _LENS_COUNTS, *_D2)
    # OpenCV itself has no key for the lens model; a polynomial's terms follow from their number.
    named = str(data.get("distortion_model", "")).strip().lower()
    is_fisheye = named in {"fisheye", "equidistant"}
    in_columns = _is_column(base.entry(data, *_D1)) or _is_column(base.entry(data, *_D2))
    if not named and in_columns and left_lens.any():
        raise ValueError(
            "expected a lens model for a column of 4 coefficients, found none: add distortion_model: fisheye "
            "(k1 k2 k3 k4 of cv2.fisheye) or distortion_model: plumb_bob (k1 k2 p1 p2)"
        )
    model: LensModel | None = "fisheye" if is_fisheye else None
    left = base.camera(size, left_matrix, left_lens, model, "M1")
    right = base.camera(size, right_matrix, right_lens, model, "M2")
    translation = base.numbers_at(data, 3, *_T) * choice.unit()
    pose = base.transform(base.numbers_at(data, 9, *_R), translation, "R")
    return StereoRig(left, right, pose, name + remark)


def _is_column(value: Any) -> bool:
    """True if 4 coefficients stand in a column, as cv2.fisheye and old versions of OpenCV's polynomial give them."""
    if isinstance(value, Mapping):
        return (value.get("rows"), value.get("cols")) == (4, 1)
    return isinstance(value, list) and len(value) == 4 and all(isinstance(row, list) for row in value)


def parse_storage(text: str) -> Mapping[str, Any]:
    """The keys of a file of OpenCV's in YAML, XML or JSON. Raises ValueError: none of them."""
    if text.lstrip().startswith("{"):
        return base.table(base.parse_json(text), "the file")
    if not text.lstrip().startswith("<"):
        return base.parse_yaml(text)
    data: dict[str, Any] = {}
    for node in base.parse_xml(text):
        inner = node.find("data")
        if inner is None:
            data[str(node.tag)] = node.text or ""
            continue
        rows = int(base.number(node.findtext("rows", "0"), "rows"))
        cols = int(base.number(node.findtext("cols", "0"), "cols"))
        data[str(node.tag)] = {"rows": rows, "cols": cols, "data": inner.text or ""}
    return data


def _size(data: Mapping[str, Any], choice: Choice, left: F64, right: F64) -> tuple[Size, str]:
    """Image size of a file, and a remark where it had to be guessed from the flat matrices K or P of both cameras."""
    for key in ("imageSize", "image_size"):
        if key in data:
            return base.size_of(data[key], key), ""
    if "image_width" in data and "image_height" in data:
        return (base.whole_at(data, "image_width"), base.whole_at(data, "image_height")), ""
    if choice.size is not None:
        return choice.size, ""
    # The usual sensor size whose middle is nearest to the principal points.
    cx, cy = 0.5 * (left.reshape(3, -1)[:2, 2] + right.reshape(3, -1)[:2, 2])
    distances = [max(abs(cx / width - 0.5), abs(cy / height - 0.5)) for width, height in COMMON_SIZES]
    best = int(np.argmin(distances))
    # Share of the image that a principal point may lie off centre when the size is taken from it.
    if distances[best] > 0.08:
        raise ValueError(
            f"expected an image size, found none, and the principal point ({cx:.0f}, {cy:.0f}) fits no usual size"
        )
    size = COMMON_SIZES[best]
    return size, f" (image size {size_text(size)} taken from the principal points: the file has none)"


def _texts(rig: StereoRig, path: Path) -> dict[Path, str]:
    """One file with everything, or intrinsics.yml and extrinsics.yml when the path is a folder (no suffix)."""
    is_fisheye = rig.left.model == "fisheye"
    if is_fisheye != (rig.right.model == "fisheye"):
        raise ValueError("the OpenCV format holds one lens model for both cameras, and only one of these is a fisheye")
    model = "fisheye" if is_fisheye else "opencv"
    intrinsics = f"image_width: {rig.left.width}\nimage_height: {rig.left.height}\ndistortion_model: {model}\n"
    for number, camera in ((1, rig.left), (2, rig.right)):
        intrinsics += _block(f"M{number}", camera.matrix)
        intrinsics += _block(f"D{number}", camera.coefficients.reshape(1, -1))
    pose = rig.right_SE3_left
    header = "%YAML:1.0\n---\n"
    extrinsics = _block("R", pose.rotation) + _block("T", pose.translation.reshape(3, 1))
    if path.suffix:
        return {path: header + intrinsics + extrinsics}
    return {path / "intrinsics.yml": header + intrinsics, path / "extrinsics.yml": header + extrinsics}


def _block(name: str, matrix: F64) -> str:
    values = ", ".join(repr(float(v)) for v in matrix.ravel())
    rows, cols = matrix.shape
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {values} ]\n"


FORMAT = Format(
    "opencv", "OpenCV FileStorage or JSON with its keys", (_CAMERAS, _RECTIFIED), _part, _read, _texts, ".yml"
)
