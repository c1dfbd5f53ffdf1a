"""What board calibration works on: corners in images, views of the board, and a rig fitted to them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.camera import Camera
from calib.rig import StereoRig
from calib.types import F64, I64

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of the board found in one image: (n,) ids into the board's points and (n, 2) pixels."""

    ids: I64
    pixels: F64


@dataclass(frozen=True, eq=False)
class BoardView:
    """Corners of the board that both images of a pair show.

    Attributes:
        name: of the pair, for messages.
        ids: (n,) into the board's points.
        left, right: (n, 2) image points [px].
    """

    name: str
    ids: I64
    left: F64
    right: F64

    def image_points(self, side: Side) -> F64:
        """(n, 2) image points of one camera [px]."""
        return self.left if side == "left" else self.right


def common_view(name: str, left: Corners, right: Corners) -> BoardView:
    """The corners that are in both images."""
    ids, i, j = np.intersect1d(left.ids, right.ids, return_indices=True)
    return BoardView(name, np.asarray(ids, dtype=np.int64), left.pixels[i], right.pixels[j])


@dataclass(frozen=True, eq=False)
class RigFit:
    """A rig fitted to views of a board.

    Attributes:
        rig: both cameras and the transform between them.
        poses: (n_views, 6) rotation vector and translation [m] of left_SE3_board.
        errors: per view the (2, n, 2) reprojection errors in the left and the right image [px].
    """

    rig: StereoRig
    poses: F64
    errors: tuple[F64, ...]

    @property
    def rms_px(self) -> float:
        """Root mean square distance between corners and their reprojection, over all images [px]."""
        return rms(self.errors)

    def view_rms_px(self) -> F64:
        """(n_views,) the same per view [px]."""
        return np.array([rms([error]) for error in self.errors])

    def side_errors(self, side: Side) -> list[F64]:
        """Per view the (n, 2) reprojection errors of one camera [px]."""
        return [error[SIDES.index(side)] for error in self.errors]


def rms(errors: Iterable[F64]) -> float:
    """Root mean square length of the 2-vectors in several (..., 2) arrays; NaN without any."""
    stacked = np.concatenate([np.empty((0, 2)), *(error.reshape(-1, 2) for error in errors)])
    return float(np.sqrt((stacked**2).sum(axis=1).mean())) if len(stacked) else math.nan


def coefficient_names(camera: Camera) -> tuple[str, ...]:
    """Names of the distortion coefficients in their order."""
    if camera.model == "fisheye":
        return ("k1", "k2", "k3", "k4")
    order = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty")
    return order[: len(camera.coefficients)]


def rig_parameters(rig: StereoRig) -> dict[str, float]:
    """Parameters of a rig by name, e.g. "left fx" [px], "rotation x" [rad], "translation z" and "baseline" [m]."""
    values: dict[str, float] = {}
    for side, camera in (("left", rig.left), ("right", rig.right)):
        for name in ("fx", "fy", "cx", "cy"):
            values[f"{side} {name}"] = float(getattr(camera, name))
        named = zip(coefficient_names(camera), camera.coefficients, strict=True)
        values |= {f"{side} {name}": float(value) for name, value in named}
    pose = rig.right_SE3_left
    for what, vector in (("rotation", pose.rotvec), ("translation", pose.translation)):
        values |= {f"{what} {axis}": float(value) for axis, value in zip("xyz", vector, strict=True)}
    return values | {"baseline": rig.baseline_m}
