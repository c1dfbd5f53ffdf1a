"""Cameras and rigs from views of a board by OpenCV's own calibration, and which frames of a long take to use.

``calibrateCameraExtended`` and ``fisheye.calibrate`` start each camera; ``stereoCalibrateExtended`` and
``fisheye.stereoCalibrate`` then fit both cameras, the transform between them and all board poses together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from calib.board.detect import SIDES, BoardView, Corners, Side
from calib.camera import Camera, LensModel
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64, U8


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


MAX_VIEWS = 40
"""More views of one board add little: the error falls with the root of their number (our choice)."""


def sharpness(grey: U8, corners: Corners) -> float:
    """Median steepness of the edges at the corners, as a share of their contrast per pixel (1: perfectly sharp)."""
    values, half = [], 4  # [px]
    height, width = grey.shape
    for x, y in np.rint(corners.pixels).astype(int):
        patch = grey[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
        if not (0 <= x < width and 0 <= y < height) or min(patch.shape) < 3:
            continue
        smooth = cv2.GaussianBlur(patch, (3, 3), 0).astype(np.float64)
        contrast = float(np.ptp(smooth))
        if contrast > 0:
            steepest = max(np.abs(np.diff(smooth, axis=axis)).max() for axis in (0, 1))
            values.append(steepest / contrast)
    return float(np.median(values)) if values else 0.0


def select_views(
    views: Sequence[BoardView], sharp: Sequence[float], size: tuple[int, int], limit: int = MAX_VIEWS
) -> list[int]:
    """Indices of the views to use, in order.

    Blurred ones go first; then views are taken one by one, each the most different from those taken already in
    place, size and tilt of the board.
    """
    if len(views) <= limit:
        return list(range(len(views)))
    # Frames less sharp than this share of the take's best tenth are moved or out of focus (our choice).
    floor = 0.6 * float(np.quantile(np.asarray(sharp), 0.9))
    good = [i for i, value in enumerate(sharp) if value >= floor]
    features = np.array([_features(view, size) for view in views])
    taken = [max(good, key=lambda i: sharp[i])]
    away = np.linalg.norm(features - features[taken[0]], axis=1)
    while len(taken) < min(limit, len(good)):
        best = max((i for i in good if i not in taken), key=lambda i: (float(away[i]), sharp[i]))
        taken.append(best)
        away = np.minimum(away, np.linalg.norm(features - features[best], axis=1))
    return sorted(taken)


def _features(view: BoardView, size: tuple[int, int]) -> F64:
    """Place, log size, slant and perspective of the board in the left image, each about one wide."""
    normal = (view.left - [size[0] / 2, size[1] / 2]) / size[0]
    centre = normal.mean(axis=0)
    spread = np.cov((normal - centre).T)
    scale = np.sqrt(np.trace(spread))
    shape = np.array([spread[0, 0] - spread[1, 1], 2 * spread[0, 1]]) / np.trace(spread)
    third = ((normal - centre) ** 3).mean(axis=0) / scale**3
    return np.concatenate([2 * centre, [np.log(scale)], shape, 2 * third])


opencv: Any = cv2
"""Its type stubs know the argument types of one version only, and no empty camera matrix."""
_MAX_ITERATIONS = 100
REFIT_ITERATIONS = 20
"""Enough for a fit that starts near its optimum: with a few of the views left out."""


class FitError(Exception):
    """OpenCV finds no camera or rig that could have taken the views."""


@dataclass(frozen=True)
class Lens:
    """A lens model to fit.

    Attributes:
        name: for messages.
        model: OpenCV's family.
        count: number of coefficients, in OpenCV's order.
        fixed: OpenCV's flags of coefficients that stay zero.
    """

    name: str
    model: LensModel
    count: int
    fixed: int = 0

    @property
    def flags(self) -> int:
        """OpenCV's calibration flags."""
        if self.model == "fisheye":
            return _fisheye_flag("CALIB_FIX_SKEW") | _fisheye_flag("CALIB_RECOMPUTE_EXTRINSIC")
        return cv2.CALIB_RATIONAL_MODEL if self.model == "rational" else cv2.CALIB_FIX_K3 | self.fixed

    def camera(self, size: tuple[int, int], matrix: Any, coefficients: Any) -> Camera:
        """The camera of OpenCV's matrix and coefficients. Raises FitError: values that no camera has."""
        k = np.asarray(matrix, dtype=np.float64)
        distortion = np.asarray(coefficients, dtype=np.float64).ravel()[: self.count]
        try:
            return Camera(*size, k[0, 0], k[1, 1], k[0, 2], k[1, 2], self.model, tuple(map(float, distortion)))
        except ValueError as error:
            raise FitError(str(error)) from error


@dataclass(frozen=True)
class CameraFit:
    """One camera fitted on its own; the larger of OpenCV's deviations of fx and fy, NaN of a fisheye, for which it has
    none."""

    camera: Camera
    rms_px: float
    focal_std_px: float


def fit_camera(views: Sequence[BoardView], points: F64, side: Side, size: tuple[int, int], lens: Lens) -> CameraFit:
    """One camera from its own images of the board's (m, 3) points [m]. Raises FitError: no camera fits."""
    shown = _same_lengths(views) if lens.model == "fisheye" else views
    objects, pixels = [points[view.ids] for view in shown], [view.image_points(side) for view in shown]
    # First guesses of the focal length [image widths] where OpenCV's own, from vanishing points, leads nowhere.
    (width, height), plain = size, (lens.model, (0.0,) * lens.count)
    guesses = [f * width for f in (0.4, 0.8, 1.6)]
    for start in (None, *(Camera(width, height, f, f, (width - 1) / 2, (height - 1) / 2, *plain) for f in guesses)):
        with suppress(cv2.error, FitError):
            return _fit_camera(objects, pixels, size, lens, start)
    raise FitError(f"no {lens.name} camera fits the {side} images")


def _fit_camera(
    objects: list[F64], pixels: list[F64], size: tuple[int, int], lens: Lens, start: Camera | None
) -> CameraFit:
    fisheye, std = lens.model == "fisheye", math.nan
    matrix, coefficients = (None, None) if start is None else (start.matrix, start.coefficients)
    guess = 0 if start is None else cv2.CALIB_USE_INTRINSIC_GUESS
    points = _stacked(objects, fisheye), _stacked(pixels, fisheye)
    given: tuple[Any, ...] = (*points, size, matrix, coefficients)
    if fisheye:
        error, matrix, coefficients, *_ = opencv.fisheye.calibrate(
            *given, flags=lens.flags | guess, criteria=_criteria(_MAX_ITERATIONS)
        )
    else:
        result = opencv.calibrateCameraExtended(*given, flags=lens.flags | guess, criteria=_criteria(_MAX_ITERATIONS))
        error, matrix, coefficients, _, _, stds, *_ = result
        std = float(np.max(np.ravel(stds)[:2]))
    if not math.isfinite(error):
        raise FitError("the fit does not converge")
    return CameraFit(lens.camera(size, matrix, coefficients), float(error), std)


def fit_rig(
    views: Sequence[BoardView],
    points: F64,
    cameras: tuple[Camera, Camera],
    lens: Lens,
    max_iterations: int = _MAX_ITERATIONS,
) -> RigFit:
    """Both cameras, the transform between them and all board poses together, from cameras to start with. Raises
    FitError: no rig fits."""
    size, fisheye = cameras[0].size, lens.model == "fisheye"
    shown = _same_lengths(views) if fisheye else views
    given: tuple[Any, ...] = (
        _stacked([points[view.ids] for view in shown], fisheye),
        *(_stacked([view.image_points(side) for view in shown], fisheye) for side in SIDES),
        *(value for camera in cameras for value in (camera.matrix, camera.coefficients)),
        size,
    )
    flags = lens.flags | cv2.CALIB_USE_INTRINSIC_GUESS
    try:
        if fisheye:
            found: Any = opencv.fisheye.stereoCalibrate(*given, flags=flags, criteria=_criteria(max_iterations))
            _, k1, d1, k2, d2, rotation, translation, rvecs, tvecs = found
        else:
            found = opencv.stereoCalibrateExtended(*given, None, None, flags=flags, criteria=_criteria(max_iterations))
            _, k1, d1, k2, d2, rotation, translation, _, _, rvecs, tvecs, _ = found
        pose = SE3(np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64).reshape(3))
    except (cv2.error, ValueError) as error:
        raise FitError(f"no pair of {lens.name} cameras fits the views") from error
    rig = StereoRig(lens.camera(size, k1, d1), lens.camera(size, k2, d2), pose)
    poses = np.hstack([np.asarray(one, dtype=np.float64).reshape(-1, 3) for one in (rvecs, tvecs)])
    errors = tuple(view_errors(rig, view, points, pose) for view, pose in zip(views, poses, strict=True))
    if not all(np.isfinite(error).all() for error in errors):
        raise FitError("the fit puts corners behind a camera")
    return RigFit(rig, poses, errors)


def view_errors(rig: StereoRig, view: BoardView, points: F64, pose: F64) -> F64:
    """(2, n, 2) reprojection errors [px] in the left and the right image for a board at ``pose`` (6,); NaN behind."""
    in_left = SE3.from_rotvec(pose[:3], pose[3:]) @ points[view.ids]
    found = rig.left.project(in_left), rig.right.project(rig.right_SE3_left @ in_left)
    return np.stack([found[0] - view.left, found[1] - view.right])


def held_out_error(rig: StereoRig, view: BoardView, points: F64, start: F64) -> float:
    """Mean square error [px^2] of a view that the rig was not fitted to, its board's pose fitted alone.

    OpenCV has no pose of one board for a rig of two cameras: scipy's Levenberg-Marquardt finds it.
    """

    def residuals(pose: F64) -> F64:
        return np.nan_to_num(view_errors(rig, view, points, pose).ravel(), nan=1e3)

    pose = least_squares(residuals, start, method="lm", x_scale="jac", xtol=1e-6, ftol=1e-6).x
    return float((residuals(pose) ** 2).sum() / (2 * len(view.ids)))


def standard_deviations(views: Sequence[BoardView], points: F64, fit: RigFit, lens: Lens) -> dict[str, float]:
    """Standard deviation of every parameter of the rig, from fits with groups of views left out (jackknife).

    OpenCV gives none for the transform between the cameras, nor for a fisheye. Source: Efron and Tibshirani, An
    Introduction to the Bootstrap, 1993, section 11.5 (delete-d, disjoint groups): the variance is (g - 1) / g times
    the sum of squares of the g fits about their mean.
    """
    # Groups of views left out in turn: a deviation from g groups is itself uncertain by 1 / sqrt(2 (g - 1)), 24 %.
    groups, cameras = min(10, len(views)), (fit.rig.left, fit.rig.right)
    fits = []
    for group in range(groups):
        kept = [view for i, view in enumerate(views) if i % groups != group]
        try:
            fits.append(rig_parameters(fit_rig(kept, points, cameras, lens, REFIT_ITERATIONS).rig))
        except FitError:
            # Without these views there is no rig: nothing is known about any parameter.
            return dict.fromkeys(rig_parameters(fit.rig), math.inf)
    table = np.array([list(one.values()) for one in fits])
    spread = np.sqrt((groups - 1) * table.var(axis=0))
    return {name: float(value) for name, value in zip(fits[0], spread, strict=True)}


def _criteria(max_iterations: int) -> tuple[int, int, float]:
    """OpenCV's: so many steps, or parameters that change by less than this share."""
    return cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, max_iterations, 1e-8


def _same_lengths(views: Sequence[BoardView]) -> list[BoardView]:
    """Views with equal numbers of corners, the first ones repeated where some are hidden.

    OpenCV's fisheye calibration demands equal numbers (opencv/opencv issues 6388 and 21748).
    """
    longest = max(len(view.ids) for view in views)
    repeats = [np.resize(np.arange(len(view.ids)), longest) for view in views]
    return [BoardView(v.name, v.ids[i], v.left[i], v.right[i]) for v, i in zip(views, repeats, strict=True)]


def _stacked(arrays: Sequence[F64], fisheye: bool) -> list[Any]:
    """Points per view in the shape and type that OpenCV takes: (1, n, k), float64 for a fisheye, else float32."""
    kind = np.float64 if fisheye else np.float32
    return [np.ascontiguousarray(array, dtype=kind).reshape(1, -1, array.shape[1]) for array in arrays]


def _fisheye_flag(name: str) -> int:
    """OpenCV 4 has a fisheye's flags in their own namespace with their own values, OpenCV 5 next to all others."""
    return int(getattr(cv2.fisheye, name, None) or getattr(cv2, name))
