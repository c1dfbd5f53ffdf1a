"""What board calibration works on: corners, views, the unknowns, and the outcome of an adjustment."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.camera import Camera
from calib.pose import SE3
from calib.types import F64, I64

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of the board seen in one image: (n,) ids into the board's points and (n, 2) pixels."""

    ids: I64
    pixels: F64


@dataclass(frozen=True, eq=False)
class View:
    """One pair of images of the board; a side that did not show the board is None."""

    name: str
    left: Corners | None
    right: Corners | None

    def side(self, side: Side) -> Corners | None:
        """Corners of one camera."""
        return self.left if side == "left" else self.right


@dataclass(frozen=True, eq=False)
class Estimate:
    """Unknowns of the adjustment.

    Attributes:
        left, right: cameras; None when that side is not part of the adjustment.
        stereo: (6,) rotation vector and translation of right_SE3_left.
        poses: (n_views, 6) rotation vector and translation of left_SE3_board.
        frozen: names of distortion coefficients that stay as they are.
    """

    left: Camera | None
    right: Camera | None
    stereo: F64
    poses: F64
    frozen: frozenset[str] = frozenset()

    def camera(self, side: Side) -> Camera | None:
        """Camera of one side."""
        return self.left if side == "left" else self.right

    @property
    def right_SE3_left(self) -> SE3:
        """Transform between the cameras."""
        return SE3.from_rotvec(self.stereo[:3], self.stereo[3:])


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Outcome of an adjustment.

    Attributes:
        estimate: the unknowns.
        errors: per view, per side the (n, 2) reprojection errors [px], None for a side that is not there.
        covariance: (p, p) of ``names``, scaled by the residuals' variance.
        names: of the shared unknowns, e.g. "left fx", "rotation x", "translation z".
    """

    estimate: Estimate
    errors: tuple[dict[Side, F64], ...]
    covariance: F64
    names: tuple[str, ...]

    @property
    def rms_px(self) -> float:
        """Root mean square distance between corners and their reprojection, over all images [px]."""
        return rms(error for view in self.errors for error in view.values())

    def view_rms_px(self) -> F64:
        """(n_views,) the same per view [px]."""
        return np.array([rms(view.values()) for view in self.errors])


def rms(errors: object) -> float:
    """Root mean square length of 2-vectors in several (n, 2) arrays."""
    stacked = np.concatenate([np.empty((0, 2)), *errors])  # type: ignore[misc]
    return float(np.sqrt((stacked**2).sum(axis=1).mean())) if len(stacked) else math.nan


def coefficient_names(camera: Camera) -> tuple[str, ...]:
    """Names of the distortion coefficients in their order."""
    if camera.model == "fisheye":
        return ("k1", "k2", "k3", "k4")
    order = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty")
    return order[: len(camera.coefficients)]
