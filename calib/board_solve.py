"""A stereo rig from views of a board: first guess, joint adjustment, outlier views, choice of the lens model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.board import Board
from calib.board_adjust import SIDES, Adjusted, Corners, Estimate, Side, View, adjust, coefficient_names, rms
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
FOLD_TOLERANCE = 0.03
"""Share by which a lens may be worse on held-out views if it spares the image a fold (our choice)."""
_FOCALS = (0.35, 0.5, 0.7, 1.0, 1.5, 2.5)
FOLDS = 5
_GUESS_VIEWS = 8
_GUESS_ROUNDS = 3


@dataclass(frozen=True)
class Lens:
    """A lens model to try: OpenCV's model and number of coefficients, and those that stay zero."""

    name: str
    model: LensModel
    count: int
    frozen: frozenset[str] = frozenset()


_TANGENTIAL = frozenset({"p1", "p2"})
LENSES: tuple[Lens, ...] = (
    Lens("no distortion", "brown", 4, _TANGENTIAL | {"k1", "k2"}),
    Lens("brown (k1 k2)", "brown", 4, _TANGENTIAL),
    Lens("brown (k1 k2 k3)", "brown", 5, _TANGENTIAL),
    Lens("brown (k1 k2 p1 p2)", "brown", 4),
    Lens("brown (k1 k2 k3 p1 p2)", "brown", 5),
    Lens("fisheye (k1-k4)", "fisheye", 4),
    Lens("rational (k1-k6)", "rational", 8, _TANGENTIAL),
    Lens("rational (k1-k6 p1 p2)", "rational", 8),
)
"""Simplest first. Tangential coefficients trade off against the principal point, so that they cost accuracy where
the lens has none."""
_BASES: tuple[Lens, ...] = (LENSES[1], LENSES[5], LENSES[6])
"""Lenses to start from, one of each model."""


@dataclass(frozen=True)
class LensChoice:
    """A lens model that was tried.

    Attributes:
        lens: the model.
        held_out_px: rms over views that were left out of the fit (k-fold), poses adjusted only.
        std_error_px: standard error of its difference to the best model over the folds.
        folds_back: whether the fitted lens turns back inside the image, which makes it useless there.
    """

    lens: Lens
    held_out_px: float
    std_error_px: float
    folds_back: bool

    @property
    def name(self) -> str:
        """E.g. "brown (k1 k2)"."""
        return self.lens.name


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
        lenses: models tried, simplest first.
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
    def chosen_lens(self) -> LensChoice:
        """The lens that was chosen."""
        return choose_lens(self.lenses)

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
        model: lens model; None chooses among all; which coefficients it gets is judged by views left out of the fit.
        rejected: pairs that were refused before, to be named with those refused here.
        source: for messages and the rig.
    Raises:
        InputError: too few or degenerate views, or views that no two cameras side by side can have seen.
    """
    points = board.points
    _refuse_few(views, rejected, board, source)
    _refuse_repeated(views, size, source)
    kept, out = list(views), list(rejected)
    lenses = [one for one in LENSES if model in {None, one.model}]
    fit = adjust(kept, points, first_guess(kept, points, size, lenses, source))
    fit, kept = _without_outliers(fit, kept, out, points, source)
    tried = compare_lenses(kept, points, fit.estimate, lenses)
    fit = adjust(kept, points, with_lens(fit.estimate, choose_lens(tried).lens))
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
    views: Sequence[View], points: F64, size: tuple[int, int], lenses: Sequence[Lens], source: str
) -> Estimate:
    """Both cameras on their own, then the median of the transforms that each pair gives."""
    bases = [base for base in _BASES if any(base.model == one.model for one in lenses)]
    best: tuple[_Single, _Single] | None = None
    for base in bases:
        focals = _FOCALS if best is None else (best[0].camera.fx / size[0], _FOCALS[1])
        left, right = (_single(views, points, size, side, base, focals) for side in SIDES)
        # A model with more freedom always fits a little better.
        if best is None or left.rms_px + right.rms_px < 0.95 * (best[0].rms_px + best[1].rms_px):
            best = (left, right)
    if best is None or not math.isfinite(best[0].rms_px + best[1].rms_px):
        raise InputError(f"{source}: expected views of a flat board, found none that a camera could have taken")
    left, right = best
    pairs = [i for i in left.poses if i in right.poses]
    stereo = np.median([_vector(_pose(right.poses[i]) @ _pose(left.poses[i]).inverse()) for i in pairs], axis=0)
    back = _pose(stereo).inverse()
    poses = [left.poses[i] if i in left.poses else _vector(back @ _pose(right.poses[i])) for i in range(len(views))]
    return Estimate(left.camera, right.camera, stereo, np.array(poses), left.frozen)


@dataclass(frozen=True, eq=False)
class _Single:
    """One camera calibrated on its own, with the board's pose in each view it saw."""

    camera: Camera
    poses: dict[int, F64]
    rms_px: float
    frozen: frozenset[str]


def _single(
    views: Sequence[View], points: F64, size: tuple[int, int], side: Side, base: Lens, focals: Sequence[float]
) -> _Single:
    """One camera from its own images: the focal length that fits best of a few, then the adjustment."""
    index = [i for i, view in enumerate(views) if view.side(side) is not None]
    seen = [View(views[i].name, views[i].side(side), None) for i in index]
    some = seen[:: max(1, len(seen) // _GUESS_VIEWS)]
    guesses = [_guess(some, points, _plain_camera(size, focal, base), base) for focal in focals]
    camera, _ = min(guesses, key=lambda guess: guess[1].rms_px if math.isfinite(guess[1].rms_px) else math.inf)
    camera, fit = _guess(seen, points, camera, base)
    return _Single(camera, dict(zip(index, fit.estimate.poses, strict=True)), fit.rms_px, base.frozen)


def _plain_camera(size: tuple[int, int], focal_widths: float, base: Lens) -> Camera:
    focal = focal_widths * size[0]
    return Camera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2, base.model, (0.0,) * base.count)


def _guess(views: Sequence[View], points: F64, camera: Camera, base: Lens) -> tuple[Camera, Adjusted]:
    """Adjust one camera, putting boards right that started tilted the wrong way, while that helps."""
    fit = _adjusted_single(views, points, camera, _start_poses(views, points, camera), base)
    for _ in range(_GUESS_ROUNDS):
        camera = fit.estimate.left or camera
        poses, turned = _best_poses(views, points, fit)
        if not turned:
            break
        again = _adjusted_single(views, points, camera, poses, base)
        if not again.rms_px < fit.rms_px:
            break
        fit = again
    return fit.estimate.left or camera, fit


def _adjusted_single(views: Sequence[View], points: F64, camera: Camera, poses: F64, base: Lens) -> Adjusted:
    return adjust(views, points, Estimate(camera, None, np.zeros(6), poses, base.frozen), max_iterations=30)


def _start_poses(views: Sequence[View], points: F64, camera: Camera) -> F64:
    return np.array([board_poses(camera, view.left, points)[0] for view in views if view.left is not None])


def _best_poses(views: Sequence[View], points: F64, fit: Adjusted) -> tuple[F64, bool]:
    """Per view the best of the pose found and the two that a plane allows, and whether any changed."""
    camera = fit.estimate.left
    if camera is None:
        raise ValueError("expected a left camera")
    both = [board_poses(camera, view.left, points) for view in views if view.left is not None]
    best, poses, turned = fit.view_rms_px(), fit.estimate.poses.copy(), False
    for k in range(2):
        start = replace(fit.estimate, poses=np.array([pair[k] for pair in both]))
        judged = adjust(views, points, start, fix_shared=True, max_iterations=10)
        for i, value in enumerate(judged.view_rms_px()):
            if value < 0.9 * best[i] or (math.isfinite(value) and not math.isfinite(best[i])):
                best[i], poses[i], turned = value, judged.estimate.poses[i], True
    return poses, turned


def board_poses(camera: Camera, corners: Corners, points: F64) -> tuple[F64, F64]:
    """The two (6,) camera_SE3_board that a flat board allows, the better one first (infinitesimal plane-based pose).

    Where there is none (a wild first guess of the lens), the board is put a little ahead of the camera.
    """
    extent = float(np.ptp(points, axis=0).max())
    ahead = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 3.0 * extent])
    rays = camera.unproject(corners.pixels)[:, :2]
    good = np.isfinite(rays).all(axis=1)
    if good.sum() < 4:
        return ahead, ahead
    plane, image = np.ascontiguousarray(points[corners.ids][good]), np.ascontiguousarray(rays[good])
    _, rotations, translations, _ = cv2.solvePnPGeneric(plane, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    poses = [
        np.concatenate([np.asarray(r).reshape(3), np.asarray(t).reshape(3)])
        for r, t in zip(rotations, translations, strict=True)
    ]
    usable = [pose for pose in poses if np.isfinite(pose).all() and pose[5] > 0] or [ahead]
    return usable[0], usable[-1]


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


def with_lens(estimate: Estimate, wanted: Lens) -> Estimate:
    """The estimate with another lens model for both cameras."""
    left, right = (None if one is None else _with_lens(one, wanted) for one in (estimate.left, estimate.right))
    return replace(estimate, left=left, right=right, frozen=wanted.frozen)


def _with_lens(camera: Camera, wanted: Lens) -> Camera:
    """The camera with another model; coefficients of the same meaning are kept, frozen ones are zero."""
    kept = dict(zip(coefficient_names(camera), camera.coefficients, strict=True))
    if (camera.model == "fisheye") != (wanted.model == "fisheye"):
        kept = {}
    plain = replace(camera, model=wanted.model, distortion=(0.0,) * wanted.count)
    names = coefficient_names(plain)
    return replace(plain, distortion=tuple(0.0 if n in wanted.frozen else float(kept.get(n, 0.0)) for n in names))


def compare_lenses(
    views: Sequence[View], points: F64, start: Estimate, lenses: Sequence[Lens] = LENSES
) -> tuple[LensChoice, ...]:
    """Judge lens models on views left out of their fit (k-fold)."""
    count = min(FOLDS, len(views))
    folds = [np.arange(len(views)) % count == k for k in range(count)]
    squares, fold_backs = [], []
    for one in lenses:
        fit = adjust(views, points, with_lens(start, one))
        fold_backs.append(any(c is not None and folds_back(c) for c in (fit.estimate.left, fit.estimate.right)))
        squares.append([_held_out(views, points, fit.estimate, fold) for fold in folds])
    table = np.array(squares)
    differences = table - table[int(np.argmin(table.mean(axis=1)))]
    errors = differences.std(axis=1, ddof=1) / math.sqrt(len(folds))
    means = np.sqrt(table.mean(axis=1))
    return tuple(
        # The error of a mean square becomes that of its root.
        LensChoice(one, float(mean), float(error / (2 * mean)), back)
        for one, mean, error, back in zip(lenses, means, errors, fold_backs, strict=True)
    )


def _held_out(views: Sequence[View], points: F64, start: Estimate, fold: Bool) -> float:
    """Mean square error [px^2] over the fold's views of a rig fitted without them."""
    inside = [view for view, out in zip(views, fold, strict=True) if not out]
    outside = [view for view, out in zip(views, fold, strict=True) if out]
    fit = adjust(inside, points, replace(start, poses=start.poses[~fold]), max_iterations=20)
    judged = adjust(outside, points, replace(fit.estimate, poses=start.poses[fold]), fix_shared=True, max_iterations=20)
    return judged.rms_px**2


def choose_lens(tried: Sequence[LensChoice]) -> LensChoice:
    """The simplest lens that is no worse than the best by more than one standard error (Breiman's rule).

    One that turns back inside the image gives way to another that is worse by no more than ``FOLD_TOLERANCE``.
    """
    best = min(one.held_out_px for one in tried)
    near = [one for one in tried if one.held_out_px - best <= one.std_error_px]
    whole = [one for one in near if not one.folds_back]
    whole = whole or [one for one in tried if not one.folds_back and one.held_out_px <= (1 + FOLD_TOLERANCE) * best]
    return (whole or near)[0]


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
