"""OpenCV FileStorage: intrinsics (M1 D1 M2 D2) and extrinsics (R T), in one file or two, YAML or XML."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import Camera, LensModel
from calib.formats.fields import camera, entry, numbers, transform, whole
from calib.formats.source import Choice, Format, Size, Source
from calib.formats.yaml_text import parse_yaml
from calib.rig import StereoRig

_K1, _K2 = (
    ("M1", "K1", "cameraMatrix1", "camera_matrix1", "CM1"),
    ("M2", "K2", "cameraMatrix2", "camera_matrix2", "CM2"),
)
_D1, _D2 = ("D1", "distCoeffs1", "dist_coeffs1"), ("D2", "distCoeffs2", "dist_coeffs2")
_MATRIX = re.compile(r"^\s*(M1|K1|cameraMatrix1|camera_matrix1|CM1)\s*:", re.MULTILINE)
_TRANSLATION = re.compile(r"^\s*T\s*:", re.MULTILINE)
_COUNTS = (4, 5, 8, 12, 14)

COMMON_SIZES: tuple[Size, ...] = (
    (320, 240), (376, 240), (640, 360), (640, 400), (640, 480), (672, 376), (752, 480), (800, 600), (848, 480),
    (1024, 768), (1280, 720), (1280, 800), (1280, 960), (1280, 1024), (1600, 1200), (1920, 1080), (1920, 1200),
    (2048, 1536), (2208, 1242), (2592, 1944), (3840, 2160),
)  # fmt: skip
"""Sizes of usual sensors [px], for files that hold none."""


def _part(source: Source) -> str | None:
    if "opencv-matrix" not in source.text and "opencv_storage" not in source.text:
        return None
    intrinsics = _MATRIX.search(source.text) is not None
    extrinsics = _TRANSLATION.search(source.text) is not None
    if intrinsics and extrinsics:
        return "whole"
    return "left" if intrinsics else "right" if extrinsics else None


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data: dict[str, Any] = {}
    for source in sources:
        data.update(parse_yaml(source.text))
    matrices = [numbers(entry(data, *names), names[0], 9) for names in (_K1, _K2)]
    size, said = _size(data, choice, [(float(k[2]), float(k[5])) for k in matrices])
    model = _model(data)
    left, right = (
        camera(size, k, numbers(entry(data, *names), names[0], _COUNTS), model, names[0])
        for k, names in zip(matrices, (_D1, _D2), strict=True)
    )
    pose = transform(numbers(entry(data, "R"), "R", 9), numbers(entry(data, "T"), "T", 3) * choice.unit(), "R")
    names = "+".join(source.path.name for source in sources)
    return StereoRig(left, right, pose, names + said)


def _model(data: Mapping[str, Any]) -> LensModel | None:
    name = str(data.get("distortion_model", "")).lower()
    return "fisheye" if name in {"fisheye", "equidistant"} or str(data.get("fisheye", 0)) == "1" else None


def _size(data: Mapping[str, Any], choice: Choice, centres: list[tuple[float, float]]) -> tuple[Size, str]:
    for key in ("imageSize", "image_size", "size", "Size"):
        if key in data:
            width, height = numbers(data[key], key, 2)
            return (whole(float(width), key), whole(float(height), key)), ""
    if "image_width" in data and "image_height" in data:
        return (whole(data["image_width"], "image_width"), whole(data["image_height"], "image_height")), ""
    if choice.size is not None:
        return choice.size, ""
    size = guess_size(centres)
    return size, f" (image size {size[0]}x{size[1]} taken from the principal points: the file has none)"


def guess_size(centres: Sequence[tuple[float, float]]) -> Size:
    """The usual sensor size whose middle is nearest to the principal points.

    Raises:
        ValueError: none is near (8 % of the size).
    """
    cx, cy = np.mean(np.asarray(centres, dtype=np.float64), axis=0)
    away = [max(abs(2 * cx / w - 1), abs(2 * cy / h - 1)) for w, h in COMMON_SIZES]
    best = int(np.argmin(away))
    if not away[best] < 0.16:
        raise ValueError(
            f"expected an image size, found none (principal point {cx:.0f}, {cy:.0f} fits no usual size): give it"
        )
    return COMMON_SIZES[best]


def write_opencv(rig: StereoRig, path: Path) -> None:
    """Write one FileStorage file with everything (M1 D1 M2 D2 R T and the image size), floats with all digits."""
    blocks = [f"%YAML:1.0\n---\nimage_width: {rig.left.width}\nimage_height: {rig.left.height}\n"]
    blocks.append(f"distortion_model: {rig.left.model}\n")
    blocks += [_intrinsics_text(rig), _extrinsics_text(rig)]
    path.write_text("".join(blocks), encoding="utf-8")


def _intrinsics_text(rig: StereoRig) -> str:
    parts = []
    for index, one in ((1, rig.left), (2, rig.right)):
        parts += [_block(f"M{index}", one.matrix), _block(f"D{index}", _row(one))]
    return "".join(parts)


def _extrinsics_text(rig: StereoRig) -> str:
    return _block("R", rig.right_SE3_left.rotation) + _block("T", rig.right_SE3_left.translation.reshape(3, 1))


def _row(one: Camera) -> np.ndarray[Any, np.dtype[np.float64]]:
    return one.coefficients.reshape(1, -1)


def _block(name: str, matrix: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    values = ", ".join(repr(float(v)) for v in matrix.ravel())
    rows, cols = matrix.shape
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {values} ]\n"


FORMAT = Format("OpenCV FileStorage", _part, _read)
