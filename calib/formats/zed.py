"""ZED factory calibration: a section per camera and resolution, the baseline in millimetres."""

from __future__ import annotations

import configparser
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calib.camera import Camera
from calib.files import write_whole
from calib.formats.fields import camera, entry, held, number
from calib.formats.source import Choice, Format, Size, Source
from calib.pose import SE3
from calib.rig import StereoRig

RESOLUTIONS: dict[str, Size] = {
    "4K": (3840, 2160), "QHDPLUS": (3200, 1800), "2K": (2208, 1242), "FHD": (1920, 1080), "FHD1200": (1920, 1200),
    "HD": (1280, 720), "HD1200": (1280, 1200), "SVGA": (960, 600), "VGA": (672, 376),
}  # fmt: skip
"""Image size of one camera by the name of the section [px] (Stereolabs' video modes)."""

_SECTION = re.compile(r"^\s*\[(LEFT|RIGHT)_CAM_(\w+)\]", re.MULTILINE)
_MILLIMETRE_M = 0.001
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def _part(source: Source) -> str | None:
    return "whole" if _SECTION.search(source.text) else None


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    source = sources[0]
    sections = _sections(source.text)
    name, remark = _resolution(sections, choice.size)
    left, right = (_camera(sections, f"{side}_CAM_{name}", RESOLUTIONS[name]) for side in ("LEFT", "RIGHT"))
    pose = _pose(entry(sections, "STEREO"), name, choice.unit(_MILLIMETRE_M))
    return StereoRig(left, right, pose, f"{source.path.name} [{name}]{remark}")


def _sections(text: str) -> dict[str, Mapping[str, str]]:
    parser = configparser.ConfigParser(interpolation=None, strict=False, default_section="\0")
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise ValueError(f"expected sections with key=value lines, found {' '.join(str(error).split())}") from error
    return {name: dict(parser[name]) for name in parser.sections()}


def _resolution(sections: Mapping[str, Mapping[str, str]], size: Size | None) -> tuple[str, str]:
    """The resolution of the images: the same size, else the largest of the same shape, else the largest."""
    names = [name for name in RESOLUTIONS if f"LEFT_CAM_{name}" in sections and f"RIGHT_CAM_{name}" in sections]
    if not names:
        raise ValueError(f"expected LEFT_CAM and RIGHT_CAM sections of {', '.join(RESOLUTIONS)}, found none")
    if size is None:
        held = ", ".join(f"{RESOLUTIONS[n][0]}x{RESOLUTIONS[n][1]}" for n in names)
        return names[0], "" if len(names) == 1 else f" (the largest of {held}; another image size selects another)"
    for name in names:
        if RESOLUTIONS[name] == size:
            return name, ""
    shaped = [n for n in names if RESOLUTIONS[n][0] * size[1] == RESOLUTIONS[n][1] * size[0]]
    return (shaped or names)[0], ""


def _camera(sections: Mapping[str, Mapping[str, str]], name: str, size: Size) -> Camera:
    # Newer files keep the lens, which is the same at every resolution, in a section of its own.
    values = {**sections.get(f"{name.split('_')[0]}_DISTO", {}), **sections[name]}
    matrix = np.array([number(entry(values, key), f"{key} of {name}") for key in ("fx", "fy", "cx", "cy")])
    coefficients = np.array([number(values.get(key, 0.0), f"{key} of {name}") for key in _COEFFICIENTS])
    return camera(size, matrix, coefficients if np.any(coefficients[5:]) else coefficients[:5], None, name)


def _pose(stereo: Mapping[str, str], resolution: str, unit_m: float) -> SE3:
    """Rotation vector (RX, CV, RZ) and shift (-Baseline, TY, TZ) from left to right."""

    def value(*keys: str) -> float:
        for key in keys:
            for full in (f"{key}_{resolution}", key):
                if full in stereo:
                    return number(stereo[full], full)
        return 0.0

    baseline = number(entry(stereo, "Baseline", "BaseLine"), "Baseline")
    translation = np.array([-baseline, value("TY"), value("TZ")]) * unit_m
    return SE3.from_rotvec([value("RX"), value("CV", "RY"), value("RZ")], translation)


def _write(rig: StereoRig, path: Path) -> list[Path]:
    names = [name for name, size in RESOLUTIONS.items() if size == rig.left.size]
    if not names:
        held = ", ".join(f"{w}x{h}" for w, h in RESOLUTIONS.values())
        raise ValueError(f"the ZED format holds images of {held}, not {rig.left.width}x{rig.left.height}")
    name = names[0]
    lines = [*_camera_lines(f"LEFT_CAM_{name}", rig.left), *_camera_lines(f"RIGHT_CAM_{name}", rig.right)]
    x, y, z = (float(v) / _MILLIMETRE_M for v in rig.right_SE3_left.translation)
    rx, ry, rz = (float(v) for v in rig.right_SE3_left.rotvec)
    lines += ["[STEREO]", f"Baseline={-x!r}", f"TY={y!r}", f"TZ={z!r}"]
    lines += [f"RX_{name}={rx!r}", f"CV_{name}={ry!r}", f"RZ_{name}={rz!r}", ""]
    write_whole(path, "\n".join(lines))
    return [path]


def _camera_lines(section: str, one: Camera) -> list[str]:
    _, coefficients = held("ZED", one, {"brown": 5, "rational": 8})
    intrinsics = [f"{key}={float(getattr(one, key))!r}" for key in ("fx", "fy", "cx", "cy")]
    return [f"[{section}]", *intrinsics, *(f"{k}={v!r}" for k, v in zip(_COEFFICIENTS, coefficients, strict=False)), ""]


FORMAT = Format("zed", "ZED factory conf", _part, _read, _write, ".conf")
