"""OpenCV FileStorage: intrinsics (M1 D1 M2 D2) and extrinsics (R T), in one file or two, or the projections (P1 P2) of
rectified images alone; YAML, XML or JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.formats import base
from calib.formats.base import Choice, Format, Size, Source
from calib.rig import StereoRig
from calib.types import F64

_K1, _K2 = (
    (f"M{n}", f"K{n}", f"cameraMatrix{n}", f"camera_matrix{n}", f"CM{n}", f"mtx{n}",
     f"mtx{side}", f"cameraMatrix{side}", f"K_{side.lower()}", f"K_{word}")
    for n, side, word in ((1, "L", "left"), (2, "R", "right"))
)  # fmt: skip
_D1, _D2 = (
    (f"D{n}", f"d{n}", f"distCoeffs{n}", f"dist_coeffs{n}", f"dist{n}",
     f"dist{side}", f"distCoeffs{side}", f"D_{side.lower()}", f"D_{word}")
    for n, side, word in ((1, "L", "left"), (2, "R", "right"))
)  # fmt: skip
_R = ("R", "Rot", "rot", "rotation")
_T = ("T", "t", "Trans", "trans", "translation")
"""Names that OpenCV's samples, calibrators and tutorials give them."""
_T_UNITS_M = {"T_m": 1.0, "T_cm": 0.01, "T_mm": 0.001}
_P1 = ("P1", "P1_rect")
_P2 = ("P2", "P2_rect")


def _keys(*each: tuple[str, ...]) -> base.Keys:
    """Keys of YAML, JSON and XML, each by any of its names; messages use the first. Bare numbers follow KITTI's."""
    patterns = {names[0]: f"({'|'.join(names)})" for names in each}
    return base.lines_with(**{k: rf'<{one}[ >]|^\s*{one}\s*:(?! *[-\d])|"{one}"\s*:' for k, one in patterns.items()})


_CAMERAS = _keys(_K1, _D1, _K2, _D2, _R, (*_T, *_T_UNITS_M))
_RECTIFIED = _keys(_P1, _P2)

COMMON_SIZES: tuple[Size, ...] = (
    (320, 240), (376, 240), (640, 360), (640, 400), (640, 480), (672, 376), (752, 480), (800, 600), (848, 480),
    (1024, 768), (1280, 720), (1280, 800), (1280, 960), (1280, 1024), (1600, 1200), (1920, 1080), (1920, 1200),
    (2048, 1536), (2208, 1242), (2592, 1944), (3840, 2160),
)  # fmt: skip
"""Sizes of usual sensors [px], for files that hold none."""


def _part(source: Source) -> str | None:
    matrix, translation = (dict(_CAMERAS)[name].search(source.text) is not None for name in ("M1", "T"))
    if "opencv-matrix" in source.text and matrix != translation:
        return "left" if matrix else "right"
    return base.whole_with(_CAMERAS, _RECTIFIED)(source)


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data: dict[str, Any] = {}
    for source in sources:
        data.update(parse_storage(source.text))
    alone = not any(key in data for key in _K1)
    matrices = [base.numbers_at(data, 12 if alone else 9, *names) for names in ((_P1, _P2) if alone else (_K1, _K2))]
    size, remark = _size(data, choice, [tuple(k.reshape(3, -1)[:2, 2].tolist()) for k in matrices])
    name = "+".join(source.path.name for source in sources) + remark
    if alone or (choice.rectified and any(key in data for key in _P1)):
        # The cameras of images that P1 and P2 rectified: P = K [I | t].
        one, other = (base.projected(size, base.entry(data, *p), p[0], choice.unit()) for p in (_P1, _P2))
        return base.joined(one, other, f"{name} [rectified images]")
    # For what the file names OpenCV itself has no key; a polynomial's terms follow from their number.
    named = str(data.get("distortion_model", "")).strip().lower()
    fisheye = named in {"fisheye", "equidistant", "kannala_brandt"} or str(data.get("fisheye", 0)).strip() == "1"
    lenses = [base.numbers_at(data, (0, 4, 5, 8, 12, 14), *names) for names in (_D1, _D2)]
    columns = False
    if not (named or fisheye):
        columns = any(_is_column(base.entry(data, *names)) for names in (_D1, _D2))
    if columns and lenses[0].any():
        raise ValueError(
            "expected a lens model for a column of 4 coefficients, found none: add distortion_model: fisheye "
            "(k1 k2 k3 k4 of cv2.fisheye) or distortion_model: plumb_bob (k1 k2 p1 p2)"
        )
    left, right = (
        base.camera(size, k, lens, "fisheye" if fisheye else None, names[0])
        for k, lens, names in zip(matrices, lenses, (_K1, _K2), strict=True)
    )
    key = next((key for key in _T_UNITS_M if key in data), "T")
    translation = base.numbers_at(data, 3, key, *_T) * choice.unit(_T_UNITS_M.get(key, 1.0))
    return StereoRig(left, right, base.transform(base.numbers_at(data, 9, *_R), translation, "R"), name)


def _is_column(value: Any) -> bool:
    """Whether 4 coefficients stand in a column, as cv2.fisheye and old versions of OpenCV's polynomial give them."""
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
        value = (node.text if inner is None else inner.text) or ""
        shape = {key: int(base.number(node.findtext(key, "0"), key)) for key in ("rows", "cols")}
        data[str(node.tag)] = value if inner is None else {**shape, "data": value}
    return data


def _size(data: Mapping[str, Any], choice: Choice, centres: Sequence[tuple[float, float]]) -> tuple[Size, str]:
    for key in ("imageSize", "image_size", "size", "Size"):
        if key in data:
            return base.size_of(data[key], key), ""
    if "image_width" in data and "image_height" in data:
        return (base.whole(data["image_width"], "image_width"), base.whole(data["image_height"], "image_height")), ""
    if choice.size is not None:
        return choice.size, ""
    # The usual sensor size whose middle is nearest to the principal points.
    cx, cy = np.mean(np.asarray(centres, dtype=np.float64), axis=0)
    away = [max(abs(cx / w - 0.5), abs(cy / h - 0.5)) for w, h in COMMON_SIZES]
    best = int(np.argmin(away))
    # Share of the image that a principal point may lie off centre when the size is taken from it.
    if away[best] > 0.08:
        raise ValueError(
            f"expected an image size, found none, and the principal point ({cx:.0f}, {cy:.0f}) fits no usual size"
        )
    size = COMMON_SIZES[best]
    return size, f" (image size {size[0]}x{size[1]} taken from the principal points: the file has none)"


def _texts(rig: StereoRig, path: Path) -> dict[Path, str]:
    """One file with everything, or intrinsics.yml and extrinsics.yml when the path is a folder (no suffix)."""
    if (rig.left.model == "fisheye") != (rig.right.model == "fisheye"):
        raise ValueError("the OpenCV format holds one lens model for both cameras, and only one of these is a fisheye")
    model = "fisheye" if rig.left.model == "fisheye" else "opencv"
    head = f"image_width: {rig.left.width}\nimage_height: {rig.left.height}\ndistortion_model: {model}\n"
    intrinsics = head + "".join(
        (_block(f"M{number}", one.matrix) + _block(f"D{number}", one.coefficients.reshape(1, -1)))
        for number, one in ((1, rig.left), (2, rig.right))
    )
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
