"""A calibrated stereo pair and our own file for it, and a colour camera with a depth sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np

from calib.camera import Camera, LensModel
from calib.errors import InputError
from calib.io import parse_toml, toml_string, write_whole
from calib.pose import SE3
from calib.types import F64

DepthTechnology = Literal["structured-light", "time-of-flight", "stereo"]
"""Technology by which a depth camera measures, which decides how its noise grows with depth."""

IDENTITY = SE3(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class RgbdRig:
    """Calibration of images with depth.

    Attributes:
        camera: of the image.
        depth_camera: of the depth; None where depth lies in the image's own pixel grid (registered).
        camera_SE3_depth: maps the depth camera's coordinates to those of the image's camera [m].
        units_per_m: depth values per metre; None when the file does not give it.
        technology: how depth is measured; None when the file does not give it.
        source: where it came from, for messages and run.json.
    """

    camera: Camera
    depth_camera: Camera | None = None
    camera_SE3_depth: SE3 = IDENTITY
    units_per_m: float | None = None
    technology: DepthTechnology | None = None
    source: str = ""

    def scaled(self, size: tuple[int, int], depth_size: tuple[int, int]) -> RgbdRig:
        """The same rig for images and depth of other resolutions of the same fields of view."""
        depth = self.depth_camera and self.depth_camera.scaled(*depth_size)
        return replace(self, camera=self.camera.scaled(*size), depth_camera=depth)


MAX_BASELINE_M = 5.0
"""Longer baselines mean wrong units: no pair for people is wider than this."""
MAX_LIKELY_BASELINE_M = 1.0
"""Longest baseline that a guess at the unit of length may give."""
MIN_BASELINE_M = 0.005


@dataclass(frozen=True)
class StereoRig:
    """Two cameras and the transform between them.

    Attributes:
        left, right: intrinsics.
        right_SE3_left: maps left camera coordinates to right ones [m]; for a usual pair its x translation is negative.
        source: where it came from, for messages and run.json.
    """

    left: Camera
    right: Camera
    right_SE3_left: SE3
    source: str = ""

    @property
    def baseline_m(self) -> float:
        """Distance between the camera centres [m]."""
        return float(np.linalg.norm(self.right_SE3_left.translation))

    def scaled(self, width: int, height: int) -> StereoRig:
        """The same rig at another resolution of the same field of view."""
        return replace(self, left=self.left.scaled(width, height), right=self.right.scaled(width, height))

    def rectifying_rotations(self) -> tuple[F64, F64]:
        """(3, 3) rotations of the left and the right camera into frames whose x axis is the baseline.

        The z axis is as near to both optical axes as the baseline allows.
        """
        pose = self.right_SE3_left
        centre = pose.inverse().translation
        x = centre / np.linalg.norm(centre)
        ahead = np.array([0.0, 0.0, 1.0]) + pose.rotation[2]
        z = ahead - (ahead @ x) * x
        z /= np.linalg.norm(z)
        left = np.asarray(np.stack([x, np.cross(z, x), z]))
        return left, np.asarray(left @ pose.rotation.T)

    def swapped(self) -> StereoRig:
        """The rig with left and right exchanged."""
        return StereoRig(self.right, self.left, self.right_SE3_left.inverse(), self.source)

    def check(self, source: str) -> StereoRig:
        """Return self, or refuse a geometry that cannot be a stereo rig. Raises InputError: baseline out of range
        (wrong units), cameras that look apart, or a right camera above, below, ahead of or to the left of the other."""
        baseline_m = self.baseline_m
        t = self.right_SE3_left.translation
        turn = math.degrees(self.right_SE3_left.angle_rad)
        problem = ""
        if not MIN_BASELINE_M <= baseline_m <= MAX_BASELINE_M:
            cause = "wrong units?" if baseline_m else "the file holds no distance between the cameras"
            units = {"centimetres": baseline_m / 100, "millimetres": baseline_m / 1000}
            if likely := {unit: m for unit, m in units.items() if MIN_BASELINE_M <= m <= MAX_LIKELY_BASELINE_M}:
                cause = " or ".join(f"{m:g} m if it is in {unit}" for unit, m in likely.items())
            problem = f"a baseline of {MIN_BASELINE_M}-{MAX_BASELINE_M:g} m, found {baseline_m:g} m ({cause})"
        elif turn > 45.0:  # they share no view worth matching
            problem = f"cameras that look the same way, found {turn:.0f} degrees between them"
        elif abs(t[2]) > max(abs(t[0]), abs(t[1])):
            actual = f"T = {[round(float(v), 4) for v in t]} m"
            problem = f"cameras side by side, found {actual}: one lies ahead of the other"
        elif abs(t[1]) > abs(t[0]):
            actual = f"the right camera {abs(t[1]):.3f} m {'below' if t[1] < 0 else 'above'} the left one"
            problem = f"cameras side by side, found {actual}: turn the images by 90 degrees and calibrate them so"
        elif t[0] > 0:
            actual = f"T = {t[0]:+.4f} m: left and right are swapped, or its sign (in ROS that of P[3]) is wrong"
            problem = f"the right camera on the right (negative x translation), found {actual}"
        if problem:
            raise InputError(f"{source}: expected {problem}")
        return self


def save_rig(rig: StereoRig, path: Path) -> None:
    """Write ``rig.toml``."""
    write_whole(path, rig_text(rig))


def rig_text(rig: StereoRig) -> str:
    """The content of ``rig.toml``; floats keep all their digits."""
    lines = [
        "# planview stereo rig: p_right = rotation @ p_left + translation_m",
        f"source = {toml_string(rig.source)}",
        "",
    ]
    for name, camera in (("left", rig.left), ("right", rig.right)):
        lines += [f"[{name}]", f"width = {camera.width}", f"height = {camera.height}"]
        lines += [f"{key} = {float(getattr(camera, key))!r}" for key in ("fx", "fy", "cx", "cy")]
        lines += [f'model = "{camera.model}"', f"distortion = {list(camera.distortion)!r}", ""]
    return "\n".join([*lines, "[right_SE3_left]", *rig.right_SE3_left.toml(), ""])


def parse_rig(text: str, source: str) -> StereoRig:
    """A rig from the text of ``rig.toml``. Raises ValueError: not TOML, keys missing, or values of no rig."""
    try:
        data = parse_toml(text)
        pose = SE3.from_table(data["right_SE3_left"])
        return StereoRig(_camera(data["left"]), _camera(data["right"]), pose, str(data.get("source", source)))
    except KeyError as error:
        raise ValueError(f"no key {error}; it ends in line {len(text.splitlines())}") from error
    # tomllib recurses into nested arrays; a table where a number belongs gives TypeError or AttributeError.
    except (TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"a value of the wrong kind ({error})") from error


def _camera(table: dict[str, Any]) -> Camera:
    model = str(table.get("model", "brown"))
    if model not in get_args(LensModel):
        raise ValueError(f"lens model {model!r} (known: {', '.join(get_args(LensModel))})")
    fx, fy, cx, cy = (float(table[key]) for key in ("fx", "fy", "cx", "cy"))
    distortion = tuple(float(k) for k in table.get("distortion", ()))
    return Camera(int(table["width"]), int(table["height"]), fx, fy, cx, cy, cast(LensModel, model), distortion)


@dataclass(frozen=True)
class Floor:
    """Pose of the left rectified camera above the floor.

    Attributes:
        height_m: height of the left camera's centre above the floor.
        tilt_rad: angle between the optical axis and straight down (0: overhead, pi/2: horizontal).
        roll_rad: angle of the camera's x axis above the horizontal; unlike a rotation about the optical axis it is
            defined for a camera that looks straight down too.
        inlier_fraction: share of valid depth that lies on the floor; NaN when given by hand.
        residual_m: rms distance of the inliers from the plane; NaN when given by hand.
        covariance: (3, 3) float64 of (height [m], tilt [rad], roll [rad]); None when unknown.
        extent_m: (x_min, y_min, x_max, y_max) of the visible floor, world frame [m]; None when unknown.
        doubt: what else the plane may be; empty when nothing speaks for it.
    """

    world_SE3_left: SE3
    inlier_fraction: float = math.nan
    residual_m: float = math.nan
    covariance: F64 | None = None
    extent_m: tuple[float, float, float, float] | None = None
    doubt: str = ""

    @property
    def height_m(self) -> float:
        return float(self.world_SE3_left.translation[2])

    @property
    def tilt_rad(self) -> float:
        return float(np.arccos(np.clip(-self.world_SE3_left.rotation[2, 2], -1.0, 1.0)))

    @property
    def roll_rad(self) -> float:
        return float(np.arcsin(np.clip(self.world_SE3_left.rotation[2, 0], -1.0, 1.0)))


def world_from_plane(normal: F64, offset_m: float) -> SE3:
    """Canonical world frame: origin on the floor below the left camera, Z up, X along the camera's x axis. Raises
    ValueError: the camera's x axis is vertical, so that X is not defined.

    Args:
        normal: (3,) the floor's upward normal in the rectified left camera frame; need not be unit.
        offset_m: height of the camera centre above the floor [m].
    """
    up = np.asarray(normal, dtype=np.float64)
    up = up / np.linalg.norm(up)
    x_axis = np.array([1.0, 0.0, 0.0]) - up[0] * up
    if np.linalg.norm(x_axis) < 1e-3:
        raise ValueError("expected a camera whose x axis is not vertical")
    x_axis /= np.linalg.norm(x_axis)
    return SE3(np.stack([x_axis, np.cross(up, x_axis), up]), np.array([0.0, 0.0, offset_m]))
