"""A stereo rig from views of a board: first guess, joint adjustment, outlier views, choice of the lens model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.board import Board
from calib.board_adjust import SIDES, Adjusted, Corners, Estimate, Side, View, adjust, lens, rms
from calib.camera import Camera, LensModel
from calib.errors import InputError
from calib.pose import SE3
from calib.rig import MAX_BASELINE_M, MIN_BASELINE_M, StereoRig
from calib.types import F64, Bool

MIN_PAIRS = 5
"""Fewer pairs leave focal length and distortion to chance (three orientations are the bare minimum; our choice)."""
MAX_REJECTED_SHARE = 0.5
"""When more views than this disagree, there is no telling which half is right."""
REJECT_MEDIANS = 2.5
"""A view whose rms is this many times the median of all views is an outlier (good views differ by up to 1.6)."""
REJECT_FLOOR_PX = 0.3
"""Views better than this are never outliers: corners are found no better than 0.1 to 0.3 px."""
MAX_FOCAL_STD = 0.02
"""Relative standard deviation of a focal length above which the views do not determine it (depth errs as much)."""
MAX_RMS_WIDTHS = 0.003
"""Share of the image width; a worse fit means images that do not belong together."""
MAX_TURN_DEG = 45.0
_FOCALS = (0.35, 0.5, 0.7, 1.0, 1.5, 2.5)
FOLDS = 5
_GUESS_VIEWS = 8


@dataclass(frozen=True)
class LensChoice:
    """A lens model that was tried.

    Attributes:
        name: e.g. "brown (4)".
        model, count: model and number of coefficients.
        held_out_px: rms over views that were left out of the fit (k-fold), poses adjusted only.
        std_error_px: standard error of its difference to the best model over the folds.
        folds_back: whether the fitted lens turns back inside the image, which makes it useless there.
    """

    name: str
    model: LensModel
    count: int
    held_out_px: float
    std_error_px: float
    folds_back: bool


@dataclass(frozen=True)
class RejectedView:
    """A pair that was not used, and why."""

    name: str
    why: str


@dataclass(frozen=True, eq=False)
class BoardCalibration:
    """A rig and how far to trust it.

    Attributes:
        rig: the result.
        board: the board it was made from.
        views: the pairs used, with their corners.
        adjusted: errors, covariance and board poses of the final adjustment.
        rejected: pairs that were not used.
        lenses: models tried, simplest first; empty when the model was given.
    """

    rig: StereoRig
    board: Board
    views: tuple[View, ...]
    adjusted: Adjusted
    rejected: tuple[RejectedView, ...]
    lenses: tuple[LensChoice, ...]

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of every parameter by its name."""
        values = np.sqrt(np.maximum(np.diag(self.adjusted.covariance), 0.0))
        return {name: float(value) for name, value in zip(self.adjusted.names, values, strict=True)}

    @property
    def pairs_used(self) -> int:
        """Pairs with the board in both images."""
        return sum(view.left is not None and view.right is not None for view in self.views)

    @property
    def chosen_lens(self) -> LensChoice | None:
        """The lens that was chosen, None when it was given."""
        return choose_lens(self.lenses) if self.lenses else None

    @property
    def baseline_std_m(self) -> float:
        """Standard deviation of the baseline [m]."""
        direction = self.rig.right_SE3_left.translation / self.rig.baseline_m
        return math.sqrt(max(float(direction @ self.adjusted.covariance[-3:, -3:] @ direction), 0.0))

    @property
    def row_rms_px(self) -> float:
        """Rms difference of the rows of a corner in the rectified images [px]: what a matcher must bear."""
        return rms(_row_errors(self.rig, self.views))

    def coverage(self, side: Side, cols: int = 8, rows: int = 6) -> F64:
        """(rows, cols) number of corners in each cell of the image."""
        seen = [corners.pixels for view in self.views if (corners := view.side(side)) is not None]
        pixels = np.concatenate(seen)
        edges = (
            np.linspace(-0.5, self.rig.left.height - 0.5, rows + 1),
            np.linspace(-0.5, self.rig.left.width - 0.5, cols + 1),
        )
        return np.asarray(np.histogram2d(pixels[:, 1], pixels[:, 0], bins=edges)[0], dtype=np.float64)

    def coverage_share(self, side: Side) -> float:
        """Share of the image's cells that hold a corner."""
        return float((self.coverage(side) > 0).mean())


LENSES: tuple[tuple[str, LensModel, int], ...] = (
    ("brown (k1 k2 p1 p2)", "brown", 4),
    ("brown (k1 k2 p1 p2 k3)", "brown", 5),
    ("fisheye (k1-k4)", "fisheye", 4),
    ("rational (k1-k6 p1 p2)", "rational", 8),
)
"""Simplest first."""


def solve_board(
    views: Sequence[View],
    board: Board,
    size: tuple[int, int],
    *,
    model: LensModel | None = None,
    rejected: Sequence[RejectedView] = (),
    source: str = "board images",
) -> BoardCalibration:
    """Calibrate a stereo rig.

    Args:
        views: corners per pair; pairs without the board in both images may help one camera.
        board: what was seen.
        size: (width, height) of all images [px].
        model: lens model; None chooses by views left out of the fit.
        rejected: pairs that were refused before, to be named with those refused here.
        source: for messages and the rig.
    Raises:
        InputError: too few or degenerate views, or views that no two cameras side by side can have seen.
    """
    points = board.points
    _refuse_few(views, rejected, board, source)
    _refuse_repeated(views, size, source)
    kept, out = list(views), list(rejected)
    fit = adjust(kept, points, first_guess(kept, points, size, model, source))
    fit, kept = _without_outliers(fit, kept, out, points, source)
    tried: tuple[LensChoice, ...] = ()
    if model is None:
        tried = compare_lenses(kept, points, fit.estimate)
        chosen = choose_lens(tried)
        fit = adjust(kept, points, with_lens(fit.estimate, chosen.model, chosen.count))
        fit, kept = _without_outliers(fit, kept, out, points, source)
    rig = _checked_rig(fit, size, source)
    return BoardCalibration(rig, board, tuple(kept), fit, tuple(out), tried)


def _refuse_few(views: Sequence[View], rejected: Sequence[RejectedView], board: Board, source: str) -> None:
    both = sum(view.left is not None and view.right is not None for view in views)
    if both < MIN_PAIRS:
        first = f", e.g. {rejected[0].name}: {rejected[0].why}" if rejected else ""
        raise InputError(
            f"{source}: expected at least {MIN_PAIRS} pairs that show a {board.name} in both images, "
            f"found {both} of {len(views) + len(rejected)}{first}"
        )


def _refuse_repeated(views: Sequence[View], size: tuple[int, int], source: str) -> None:
    """Fewer than three clearly different board poses cannot determine a camera, however many images show them."""
    limit = 0.02 * size[0]
    distinct: list[Corners] = []
    for view in views:
        corners = view.left
        if corners is not None and all(_apart(corners, other) > limit for other in distinct):
            distinct.append(corners)
    if len(distinct) < 3:
        raise InputError(
            f"{source}: expected the board in different places and tilts, found {len(distinct)} different "
            f"pose{'s' if len(distinct) > 1 else ''} in {len(views)} views (corners within {limit:.0f} px)"
        )


def _apart(one: Corners, other: Corners) -> float:
    """Largest distance between the same corners of two views; infinite when they share none."""
    _, i, j = np.intersect1d(one.ids, other.ids, return_indices=True)
    # A chessboard's order is known up to half a turn, so that turned orders count as the same pose.
    if len(i) == 0:
        return math.inf
    a, b = one.pixels[i], other.pixels[j]
    return float(min(np.linalg.norm(a - b, axis=1).max(), np.linalg.norm(a - b[::-1], axis=1).max()))


def first_guess(
    views: Sequence[View], points: F64, size: tuple[int, int], model: LensModel | None, source: str
) -> Estimate:
    """Both cameras on their own, then the median of the transforms that each pair gives."""
    lenses: list[LensModel] = ["brown", "fisheye"] if model is None else [model]
    singles = [[_single(views, points, size, side, kind) for side in SIDES] for kind in lenses]
    whole = [pair for pair in singles if all(math.isfinite(fit.rms_px) for fit, _ in pair)]
    if not whole:
        raise InputError(f"{source}: expected views of a flat board, found none that a camera could have taken")
    (left, left_poses), (right, right_poses) = min(whole, key=lambda pair: pair[0][0].rms_px + pair[1][0].rms_px)
    pairs = [i for i in left_poses if i in right_poses]
    stereo = np.median([_vector(_pose(right_poses[i]) @ _pose(left_poses[i]).inverse()) for i in pairs], axis=0)
    back = _pose(stereo).inverse()
    poses = [left_poses[i] if i in left_poses else _vector(back @ _pose(right_poses[i])) for i in range(len(views))]
    return Estimate(left.estimate.left, right.estimate.left, stereo, np.array(poses))


def _single(
    views: Sequence[View], points: F64, size: tuple[int, int], side: Side, model: LensModel
) -> tuple[Adjusted, dict[int, F64]]:
    """One camera from its own images: the focal length that fits best of a few, then the adjustment."""
    index = [i for i, view in enumerate(views) if view.side(side) is not None]
    seen = [View(views[i].name, views[i].side(side), None) for i in index]
    some = seen[:: max(1, len(seen) // _GUESS_VIEWS)]
    guesses = [_guess(some, points, _plain_camera(size, focal, model)) for focal in _FOCALS]
    camera = min(guesses, key=lambda fit: fit.rms_px if math.isfinite(fit.rms_px) else math.inf).estimate.left
    fit = _guess(seen, points, camera or _plain_camera(size, 1.0, model))
    return fit, dict(zip(index, fit.estimate.poses, strict=True))


def _plain_camera(size: tuple[int, int], focal_widths: float, model: LensModel) -> Camera:
    focal = focal_widths * size[0]
    count = {"brown": 4, "fisheye": 4, "rational": 8}[model]
    return Camera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2, model, (0.0,) * count)


def _guess(views: Sequence[View], points: F64, camera: Camera) -> Adjusted:
    poses = np.array([board_pose(camera, view.left, points) for view in views if view.left is not None])
    return adjust(views, points, Estimate(camera, None, np.zeros(6), poses), max_iterations=30)


def board_pose(camera: Camera, corners: Corners, points: F64) -> F64:
    """(6,) camera_SE3_board of one view by infinitesimal plane-based pose estimation.

    Where there is none (a wild first guess of the lens), the board is put a little ahead of the camera.
    """
    rays = camera.unproject(corners.pixels)[:, :2]
    good = np.isfinite(rays).all(axis=1)
    if good.sum() >= 4:
        plane, image = np.ascontiguousarray(points[corners.ids][good]), np.ascontiguousarray(rays[good])
        found, rotation, translation = cv2.solvePnP(plane, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        pose = np.concatenate([np.asarray(rotation).reshape(3), np.asarray(translation).reshape(3)])
        if found and np.isfinite(pose).all() and pose[5] > 0:
            return pose
    extent = float(np.ptp(points, axis=0).max())
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 3.0 * extent])


def _pose(vector: F64) -> SE3:
    return SE3.from_rotvec(vector[:3], vector[3:])


def _vector(pose: SE3) -> F64:
    return np.concatenate([pose.rotvec, pose.translation])


def _without_outliers(
    fit: Adjusted, views: list[View], out: list[RejectedView], points: F64, source: str
) -> tuple[Adjusted, list[View]]:
    """Drop the worst view and adjust again, until none stands out."""
    total = len(views)
    while True:
        each = fit.view_rms_px()
        worst, median = int(np.argmax(each)), float(np.median(each))
        if each[worst] <= max(REJECT_MEDIANS * median, REJECT_FLOOR_PX):
            return fit, views
        why = f"reprojection error {each[worst]:.2f} px, {each[worst] / median:.0f} times the median of {median:.2f} px"
        out.append(RejectedView(views[worst].name, why))
        views = views[:worst] + views[worst + 1 :]
        if len(views) < max(MIN_PAIRS, (1 - MAX_REJECTED_SHARE) * total):
            raise InputError(
                f"{source}: expected views that agree on one rig, found {total - len(views)} of {total} that do not, "
                f"the last {out[-1].name} with a {why}"
            )
        poses = np.delete(fit.estimate.poses, worst, axis=0)
        fit = adjust(views, points, replace(fit.estimate, poses=poses))


def with_lens(estimate: Estimate, model: LensModel, count: int) -> Estimate:
    """The estimate with another lens model for both cameras."""
    left, right = (None if one is None else lens(one, model, count) for one in (estimate.left, estimate.right))
    return replace(estimate, left=left, right=right)


def compare_lenses(views: Sequence[View], points: F64, start: Estimate) -> tuple[LensChoice, ...]:
    """Judge every lens model on views left out of its fit (k-fold)."""
    folds = [np.arange(len(views)) % min(FOLDS, len(views)) == k for k in range(min(FOLDS, len(views)))]
    squares, fold_backs = [], []
    for _, model, count in LENSES:
        fit = adjust(views, points, with_lens(start, model, count))
        fold_backs.append(any(c is not None and folds_back(c) for c in (fit.estimate.left, fit.estimate.right)))
        squares.append([_held_out(views, points, fit.estimate, fold) for fold in folds])
    table = np.array(squares)
    differences = table - table[int(np.argmin(table.mean(axis=1)))]
    errors = differences.std(axis=1, ddof=1) / math.sqrt(len(folds))
    means = np.sqrt(table.mean(axis=1))
    return tuple(
        # The error of a mean square becomes that of its root.
        LensChoice(name, model, count, float(mean), float(error / (2 * mean)), back)
        for (name, model, count), mean, error, back in zip(LENSES, means, errors, fold_backs, strict=True)
    )


def _held_out(views: Sequence[View], points: F64, start: Estimate, fold: Bool) -> float:
    """Mean square error [px^2] over the fold's views of a rig fitted without them."""
    inside = [view for view, out in zip(views, fold, strict=True) if not out]
    outside = [view for view, out in zip(views, fold, strict=True) if out]
    fit = adjust(inside, points, replace(start, poses=start.poses[~fold]), max_iterations=20)
    judged = adjust(outside, points, replace(fit.estimate, poses=start.poses[fold]), fix_shared=True, max_iterations=20)
    return judged.rms_px**2


def choose_lens(tried: Sequence[LensChoice]) -> LensChoice:
    """The simplest lens that is no worse than the best by more than one standard error (Breiman's rule)."""
    usable = [one for one in tried if not one.folds_back] or list(tried)
    best = min(usable, key=lambda one: one.held_out_px)
    return next(one for one in usable if one.held_out_px - best.held_out_px <= one.std_error_px)


def folds_back(camera: Camera) -> bool:
    """Does the lens model turn back, or have no ray, somewhere inside the image?"""
    w, h = camera.width - 1.0, camera.height - 1.0
    along = np.linspace(0.0, 1.0, 13)
    border = np.concatenate(
        [np.column_stack(side) for u in (0.0, w) for side in ((np.full(13, u), along * h),)]
        + [np.column_stack(side) for v in (0.0, h) for side in ((along * w, np.full(13, v)),)]
    )
    rays = camera.unproject(border)
    if not np.isfinite(rays).all():
        return True
    steps = np.linspace(0.0, 1.0, 40)[:, None, None]
    inner = np.concatenate([rays[None, :, :2] * steps, np.ones((40, len(rays), 1))], axis=2)
    pixels = camera.project(inner.reshape(-1, 3)).reshape(40, -1, 2)
    radius = np.linalg.norm(pixels - [camera.cx, camera.cy], axis=2)
    return bool((np.diff(radius, axis=0) <= 0).any())


def _checked_rig(fit: Adjusted, size: tuple[int, int], source: str) -> StereoRig:
    left, right = fit.estimate.left, fit.estimate.right
    if left is None or right is None:
        raise ValueError("expected an adjustment of two cameras")
    if not fit.rms_px <= MAX_RMS_WIDTHS * size[0]:
        raise InputError(
            f"{source}: expected pairs taken at the same moment by two fixed cameras, found a reprojection error "
            f"of {fit.rms_px:.2f} px"
        )
    for name, value in (("left", left.fx), ("right", right.fx)):
        std = math.sqrt(max(float(fit.covariance[(i := fit.names.index(f"{name} fx")), i]), 0.0))
        if not std <= MAX_FOCAL_STD * value:
            raise InputError(
                f"{source}: expected views that determine the {name} focal length, found {value:.0f} +- {std:.0f} px: "
                "tilt the board more, towards all sides"
            )
    rig = StereoRig(left, right, fit.estimate.right_SE3_left, source)
    turn = math.degrees(float(np.linalg.norm(rig.right_SE3_left.rotvec)))
    if turn > MAX_TURN_DEG:
        raise InputError(f"{source}: expected cameras that look the same way, found {turn:.0f} degrees between them")
    if not MIN_BASELINE_M <= rig.baseline_m <= MAX_BASELINE_M:
        raise InputError(
            f"{source}: expected a baseline of {MIN_BASELINE_M}-{MAX_BASELINE_M:g} m, found {rig.baseline_m:g} m: "
            "is --square right?"
        )
    return rig.check(source)


def _row_errors(rig: StereoRig, views: Sequence[View]) -> list[F64]:
    """(n, 2) per pair: zero and the row difference after rectification [px]."""
    errors = []
    for view in views:
        if view.left is None or view.right is None:
            continue
        _, i, j = np.intersect1d(view.left.ids, view.right.ids, return_indices=True)
        rays = (rig.left.unproject(view.left.pixels[i]), rig.right.unproject(view.right.pixels[j]))
        rows = [(ray @ turn.T) for ray, turn in zip(rays, rig.rectifying_rotations(), strict=True)]
        away = (rows[0][:, 1] / rows[0][:, 2] - rows[1][:, 1] / rows[1][:, 2]) * rig.left.fy
        errors.append(np.column_stack([np.zeros(len(away)), away]))
    return errors
