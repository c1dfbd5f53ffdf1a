"""Middlebury calib.txt: a rectified pair without distortion, the baseline in millimetres."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.camera import Camera
from calib.files import write_whole
from calib.formats.fields import camera, entry, number, numbers, whole
from calib.formats.source import Choice, Format, Source
from calib.pose import SE3
from calib.rig import StereoRig

_CAMERA = re.compile(r"^\s*cam0\s*=\s*\[", re.MULTILINE)
_MILLIMETRE_M = 0.001
_MAX_OFFSET_PX = 0.5


def _part(source: Source) -> str | None:
    return "whole" if _CAMERA.search(source.text) else None


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    lines = (line.split("=", 1) for line in sources[0].text.splitlines() if "=" in line)
    data = {key.strip(): value.strip() for key, value in lines}
    size = whole(entry(data, "width"), "width"), whole(entry(data, "height"), "height")
    left, right = (_camera(data, name, size) for name in ("cam0", "cam1"))
    offset = number(data.get("doffs", right.cx - left.cx), "doffs")
    if abs(offset - (right.cx - left.cx)) > _MAX_OFFSET_PX:
        raise ValueError(
            f"expected doffs to be the principal points' distance {right.cx - left.cx:g}, found {offset:g}"
        )
    baseline = number(entry(data, "baseline"), "baseline") * choice.unit(_MILLIMETRE_M)
    return StereoRig(left, right, SE3(np.eye(3), np.array([-baseline, 0.0, 0.0])), sources[0].path.name)


def _camera(data: dict[str, str], name: str, size: tuple[int, int]) -> Camera:
    text = entry(data, name).strip().removeprefix("[").removesuffix("]")
    return camera(size, numbers(text, name, 9), np.empty(0), "brown", name)


def _write(rig: StereoRig, path: Path) -> list[Path]:
    pose = rig.right_SE3_left
    if np.abs(pose.rotation - np.eye(3)).max() > 1e-12 or np.abs(pose.translation[1:]).max() > 1e-12:
        raise ValueError("the Middlebury format holds rectified pairs only, and this pair is not rectified")
    if any(np.any(one.coefficients) or one.model == "fisheye" for one in (rig.left, rig.right)):
        raise ValueError("the Middlebury format holds no distortion, and these cameras have some")
    lines = [f"{name}={_text(one)}" for name, one in (("cam0", rig.left), ("cam1", rig.right))]
    lines += [
        f"doffs={rig.right.cx - rig.left.cx!r}",
        f"baseline={float(-pose.translation[0]) / _MILLIMETRE_M!r}",
        f"width={rig.left.width}",
        f"height={rig.left.height}",
    ]
    write_whole(path, "\n".join(lines) + "\n")
    return [path]


def _text(one: Camera) -> str:
    return f"[{one.fx!r} 0 {one.cx!r}; 0 {one.fy!r} {one.cy!r}; 0 0 1]"


FORMAT = Format("middlebury", "Middlebury calib.txt", _part, _read, _write, ".txt")
