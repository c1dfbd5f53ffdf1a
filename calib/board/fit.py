"""Cameras and rigs from views of a board by OpenCV's own calibration, and which frames of a long take to use.

``calibrateCameraExtended`` and ``fisheye.calibrate`` start each camera; ``stereoCalibrateExtended`` and
``fisheye.stereoCalibrate`` then fit both cameras, the transform between them and all board poses together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from calib.board.detect import BoardView, Corners, Side
from calib.camera import Camera, LensModel
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64, U8


@dataclass(frozen=True, eq=False)
class RigFit:
    """A rig fitted to views of a board, (n_views, 6) rotation vectors and translations [m] of left_SE3_board, and per
    view the (2, n, 2) reprojection errors in the left and the right image [px]."""

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


def rms(errors: Iterable[F64]) -> float:
    """Root mean square length of the 2-vectors in several (..., 2) arrays; NaN without any."""
    vectors = np.concatenate([np.empty((0, 2)), *(error.reshape(-1, 2) for error in errors)])
    if not len(vectors):
        return math.nan
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


_POLYNOMIAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty")
_FISHEYE = ("k1", "k2", "k3", "k4")
"""Names of OpenCV's coefficients in their order."""


def rig_parameters(rig: StereoRig) -> dict[str, float]:
    """Parameters of a rig by name, e.g. "left fx" [px], "rotation x" [rad], "translation z" and "baseline" [m]."""
    parameters = {}
    for side, camera in (("left", rig.left), ("right", rig.right)):
        for name in ("fx", "fy", "cx", "cy"):
            parameters[f"{side} {name}"] = float(getattr(camera, name))
        names = _FISHEYE if camera.model == "fisheye" else _POLYNOMIAL
        for name, value in zip(names, camera.coefficients.tolist(), strict=False):
            parameters[f"{side} {name}"] = value
    pose = rig.right_SE3_left
    for what, vector in (("rotation", pose.rotvec), ("translation", pose.translation)):
        for axis, value in zip("xyz", vector.tolist(), strict=True):
            parameters[f"{what} {axis}"] = value
    parameters["baseline"] = rig.baseline_m
    return parameters


MAX_VIEWS = 40
"""More views of one board add little: the error falls with the root of their number."""


def sharpness(grey: U8, corners: Corners) -> float:
    """Median steepness of the edges at the corners, as a share of their contrast per pixel (1: perfectly sharp)."""
    steepness = []
    half = 4  # [px]
    height, width = grey.shape
    for x, y in np.rint(corners.pixels).astype(int):
        patch = grey[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
        is_inside = 0 <= x < width and 0 <= y < height
        if not is_inside or min(patch.shape) < 3:
            continue
        smooth = cv2.GaussianBlur(patch, (3, 3), 0).astype(np.float64)
        contrast = float(np.ptp(smooth))
        if contrast == 0.0:
            continue
        down = np.abs(np.diff(smooth, axis=0)).max()
        across = np.abs(np.diff(smooth, axis=1)).max()
        steepness.append(max(down, across) / contrast)
    return float(np.median(steepness)) if steepness else 0.0


def select_views(
    views: Sequence[BoardView], points: F64, sharp: Sequence[float], size: tuple[int, int], limit: int = MAX_VIEWS
) -> list[int]:
    """Indices of up to ``limit`` views of the board's (m, 3) points [m] to use, in order.

    Blurred ones (``sharp``: the ``sharpness`` of each) are left out first; then views are taken one by one, each the
    most different from those taken already in where the left image, of ``size`` [px], shows the ends of the board.
    """
    if len(views) <= limit:
        return list(range(len(views)))
    # Frames less sharp than this share of the take's best tenth are moved or out of focus.
    floor = 0.6 * float(np.quantile(np.asarray(sharp), 0.9))
    left = [i for i, value in enumerate(sharp) if value >= floor]
    ends = _board_ends(views, points) / size[0]
    distances = np.full(len(views), math.inf)
    taken: list[int] = []
    while left and len(taken) < limit:
        best = max(left, key=lambda i: (float(distances[i]), sharp[i]))
        left.remove(best)
        taken.append(best)
        distances = np.minimum(distances, np.linalg.norm(ends - ends[best], axis=1))
    return sorted(taken)


def _board_ends(views: Sequence[BoardView], points: F64) -> F64:
    """(n, 8) where the left image shows the four outer corners of the board, visible or not [px]."""
    flat = points[:, :2]
    x0, y0 = flat.min(axis=0)
    x1, y1 = flat.max(axis=0)
    ends = np.array([[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]])
    pixels = np.empty((len(views), 8))
    for i, view in enumerate(views):
        homography, _ = cv2.findHomography(flat[view.ids], view.left)
        pixels[i] = cv2.perspectiveTransform(ends, homography).ravel()
    return pixels


opencv: Any = cv2
"""OpenCV without its type stubs, which have the argument types of one version only, and no empty camera matrix."""
_MAX_ITERATIONS = 100
REFIT_ITERATIONS = 20
"""Enough for a fit that starts near its optimum: with a few of the views left out."""


class FitError(Exception):
    """OpenCV finds no camera or rig that could have taken the views."""


@dataclass(frozen=True)
class Lens:
    """A lens model to fit, of OpenCV's families: its number of coefficients, and flags of those that stay zero."""

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
        k = np.asarray(matrix)
        distortion = np.asarray(coefficients).ravel()[: self.count]
        try:
            return Camera(*size, k[0, 0], k[1, 1], k[0, 2], k[1, 2], self.model, tuple(distortion.tolist()))
        except ValueError as error:
            raise FitError(str(error)) from error


def fit_camera(views: Sequence[BoardView], points: F64, side: Side, size: tuple[int, int], lens: Lens) -> Camera:
    """One camera from its own images of the board's (m, 3) points [m]. Raises FitError: no camera fits."""
    is_fisheye = lens.model == "fisheye"
    if is_fisheye:
        views = _same_lengths(views)
    objects = _opencv_arrays([points[view.ids] for view in views], is_fisheye)
    pixels = _opencv_arrays([view.image_points(side) for view in views], is_fisheye)
    calibrate: Any = opencv.fisheye.calibrate if is_fisheye else opencv.calibrateCamera
    criteria = _criteria(_MAX_ITERATIONS)
    # First guesses of the focal length [image widths] where OpenCV's own, from vanishing points, leads nowhere.
    for share in (None, 0.4, 0.8, 1.6):
        matrix = None
        distortion = None
        flags = lens.flags
        if share is not None:
            guess = Camera(*size, share * size[0], share * size[0], (size[0] - 1) / 2, (size[1] - 1) / 2)
            matrix = guess.matrix
            distortion = np.zeros(lens.count)
            flags |= cv2.CALIB_USE_INTRINSIC_GUESS
        with suppress(cv2.error, FitError):
            result = calibrate(objects, pixels, size, matrix, distortion, flags=flags, criteria=criteria)
            if math.isfinite(result[0]):
                return lens.camera(size, result[1], result[2])
    raise FitError(f"no {lens.name} camera fits the {side} images")


def fit_rig(
    views: Sequence[BoardView],
    points: F64,
    cameras: tuple[Camera, Camera],
    lens: Lens,
    max_iterations: int = _MAX_ITERATIONS,
) -> RigFit:
    """Both cameras, the transform between them and all board poses together, from cameras to start with. Raises
    FitError: no rig fits."""
    left, right = cameras
    size = left.size
    is_fisheye = lens.model == "fisheye"
    shown = _same_lengths(views) if is_fisheye else views
    objects = _opencv_arrays([points[view.ids] for view in shown], is_fisheye)
    left_pixels = _opencv_arrays([view.left for view in shown], is_fisheye)
    right_pixels = _opencv_arrays([view.right for view in shown], is_fisheye)
    start = (left.matrix, left.coefficients, right.matrix, right.coefficients)
    data = (objects, left_pixels, right_pixels, *start, size)
    how = {"flags": lens.flags | cv2.CALIB_USE_INTRINSIC_GUESS, "criteria": _criteria(max_iterations)}
    try:
        if is_fisheye:
            result: Any = opencv.fisheye.stereoCalibrate(*data, **how)
            _, k1, d1, k2, d2, rotation, translation, rvecs, tvecs = result
        else:
            result = opencv.stereoCalibrateExtended(*data, None, None, **how)
            _, k1, d1, k2, d2, rotation, translation, _, _, rvecs, tvecs, _ = result
        pose = SE3(np.asarray(rotation), np.asarray(translation).reshape(3))
    except (cv2.error, ValueError) as error:
        raise FitError(f"no pair of {lens.name} cameras fits the views") from error
    rig = StereoRig(lens.camera(size, k1, d1), lens.camera(size, k2, d2), pose)
    turns = np.asarray(rvecs).reshape(-1, 3)
    shifts = np.asarray(tvecs).reshape(-1, 3)
    poses = np.hstack([turns, shifts])
    errors = tuple(view_errors(rig, view, points, pose) for view, pose in zip(views, poses, strict=True))
    if not all(np.isfinite(error).all() for error in errors):
        raise FitError("the fit puts corners behind a camera")
    return RigFit(rig, poses, errors)


def view_errors(rig: StereoRig, view: BoardView, points: F64, pose: F64) -> F64:
    """(2, n, 2) reprojection errors [px] in the left and the right image for a board at ``pose`` (6,); NaN behind."""
    in_left = SE3.from_rotvec(pose[:3], pose[3:]) @ points[view.ids]
    left = rig.left.project(in_left)
    right = rig.right.project(rig.right_SE3_left @ in_left)
    return np.stack([left - view.left, right - view.right])


def held_out_error(rig: StereoRig, view: BoardView, points: F64, start: F64) -> float:
    """Mean square error [px^2] of a view that the rig was not fitted to, its board's pose fitted alone."""
    from scipy.optimize import least_squares  # half a second

    def residuals(pose: F64) -> F64:
        return np.nan_to_num(view_errors(rig, view, points, pose).ravel(), nan=1e3)

    pose = least_squares(residuals, start, method="lm", x_scale="jac", xtol=1e-6, ftol=1e-6).x
    return float((residuals(pose) ** 2).sum() / (2 * len(view.ids)))


def standard_deviations(views: Sequence[BoardView], points: F64, fit: RigFit) -> dict[str, float]:
    """Standard deviation of every parameter of the rig, computed as OpenCV does for one camera: from the scatter of the
    residuals and their Jacobian by rig and board poses, whose share is eliminated view by view (Schur complement).
    OpenCV has none for the transform between two cameras, nor for a fisheye."""
    from scipy.optimize import approx_fprime  # half a second

    parameters = rig_parameters(fit.rig)
    values = np.array(list(parameters.values()))[:-1]  # without the baseline
    free = values != 0.0  # the coefficients that the lens does not have are exactly 0
    information = np.zeros((free.sum(), free.sum()))
    squares = 0.0
    freedom = -int(free.sum())
    for view, pose, error in zip(views, fit.poses, fit.errors, strict=True):

        def errors(values: F64, view: BoardView = view) -> F64:
            return view_errors(_rig_from(values[:-6], fit.rig), view, points, values[-6:]).ravel()

        jacobian = approx_fprime(np.append(values, pose), errors, 1e-6)
        by_rig = jacobian[:, :-6][:, free]
        by_pose = jacobian[:, -6:]
        left_over = by_rig - by_pose @ np.linalg.lstsq(by_pose, by_rig, rcond=None)[0]
        information += left_over.T @ left_over
        squares += float((error**2).sum())
        freedom += error.size - 6
    covariance = np.zeros((len(values), len(values)))
    covariance[np.ix_(free, free)] = np.linalg.pinv(information) * (squares / max(freedom, 1))
    translation = values[-3:]
    along = translation / np.linalg.norm(translation)
    baseline_variance = along @ covariance[-3:, -3:] @ along
    variances = np.append(covariance.diagonal(), baseline_variance)
    return dict(zip(parameters, np.sqrt(variances).tolist(), strict=True))


def _rig_from(values: F64, like: StereoRig) -> StereoRig:
    """The rig of ``rig_parameters``, without the baseline."""
    middle = (len(values) - 6) // 2
    left = _camera_from(values[:middle], like.left)
    right = _camera_from(values[middle:-6], like.left)
    return StereoRig(left, right, SE3.from_rotvec(values[-6:-3], values[-3:]))


def _camera_from(values: F64, like: Camera) -> Camera:
    fx, fy, cx, cy, *distortion = values
    return replace(like, fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(distortion))


def _criteria(max_iterations: int) -> tuple[int, int, float]:
    """OpenCV's: ``max_iterations`` steps, or parameters that change by less than 1e-8 of themselves."""
    return cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, max_iterations, 1e-8


def _same_lengths(views: Sequence[BoardView]) -> list[BoardView]:
    """Views with equal numbers of corners, the first ones repeated where some are hidden, which OpenCV's fisheye
    calibration demands (opencv/opencv issues 6388 and 21748)."""
    longest = max(len(view.ids) for view in views)
    filled = []
    for view in views:
        rows = np.resize(np.arange(len(view.ids)), longest)
        filled.append(BoardView(view.name, view.ids[rows], view.left[rows], view.right[rows]))
    return filled


def _opencv_arrays(arrays: Sequence[F64], is_fisheye: bool) -> list[Any]:
    """Points per view in the shape and type that OpenCV takes: (1, n, k), float64 for a fisheye, else float32."""
    dtype = np.float64 if is_fisheye else np.float32
    return [np.ascontiguousarray(array, dtype=dtype).reshape(1, -1, array.shape[1]) for array in arrays]


def _fisheye_flag(name: str) -> int:
    """OpenCV 4 has a fisheye's flags in their own namespace with their own values, OpenCV 5 next to all others."""
    return int(getattr(cv2.fisheye, name, None) or getattr(cv2, name))
