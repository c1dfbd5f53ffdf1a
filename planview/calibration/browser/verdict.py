"""What the page says of a solution: its values with their deviations, and whether it is enough."""

from __future__ import annotations

import math
from typing import NamedTuple

from calib.people.calibration import HumanCalibration
from calib.rig import Floor
from planview.calibration.browser.floor_fit import FloorFit


class ValueRow(NamedTuple):
    """One value: its name, itself and its deviation, as text with units."""

    name: str
    value: str
    deviation: str


class Verdict(NamedTuple):
    """Whether a solution may be used without a second thought, and why."""

    enough: bool
    sentence: str


def camera_rows(found: HumanCalibration) -> list[ValueRow]:
    """The values of a camera from people."""
    camera, std = found.camera, found.std
    focal_std = std.focal * camera.focal_px
    return [
        ValueRow("height above the floor", f"{camera.height_m:.2f} m", f"± {std.height * camera.height_m:.2f} m"),
        _angle("tilt from straight down", camera.tilt_rad, std.tilt_rad),
        _angle("roll", camera.roll_rad, std.roll_rad),
        ValueRow("focal length", f"{camera.focal_px:.0f} px", f"± {focal_std:.0f} px"),
        ValueRow("lens", camera.lens, ""),
        ValueRow("floor positions", "", f"± {found.assessment.floor_error_m:.2f} m"),
    ]


def floor_rows(fit: FloorFit, found: Floor | None) -> list[ValueRow]:
    """The values of a floor from points, beside those found without points, in brackets."""
    floor, beside = fit.floor, "(found {})"
    height = beside.format(f"{found.height_m:.2f} m") if found else ""
    tilt = beside.format(f"{math.degrees(found.tilt_rad):.1f}°") if found else ""
    roll = beside.format(f"{math.degrees(found.roll_rad):.1f}°") if found else ""
    return [
        ValueRow("height above the floor", f"{floor.height_m:.2f} m", height),
        ValueRow("tilt from straight down", f"{math.degrees(floor.tilt_rad):.1f}°", tilt),
        ValueRow("roll", f"{math.degrees(floor.roll_rad):.1f}°", roll),
        ValueRow("points from the plane", f"{100 * (floor.residual_m or 0.0):.1f} cm rms", ""),
    ]


def floor_verdict(fit: FloorFit) -> Verdict:
    """A plane through three points fits whatever they lie on; the fourth one checks it."""
    n_used, n_off = int(fit.used.sum()), int((~fit.used).sum())
    if n_off and n_used < n_off + 3:
        return Verdict(False, f"not enough: {n_off} of {n_used + n_off} points lie off the plane of the others")
    if n_used < 4:
        return Verdict(False, "not enough: three points fit any plane; add a fourth one far from them, which checks it")
    off = f"; {n_off} off the plane not used" if n_off else ""
    return Verdict(True, f"enough: {n_used} points lie on one plane{off}")


def _angle(name: str, value_rad: float, std_rad: float) -> ValueRow:
    return ValueRow(name, f"{math.degrees(value_rad):.1f}°", f"± {math.degrees(std_rad):.1f}°")
