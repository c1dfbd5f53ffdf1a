"""A stereo rig from views of a board: fit, choice of the lens, outlier views, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.board.detect import SIDES, Board, BoardView, Side
from calib.board.fit import (
    REFIT_ITERATIONS,
    FitError,
    Lens,
    RigFit,
    fit_camera,
    fit_rig,
    held_out_error,
    rig_parameters,
    rms,
    standard_deviations,
)
from calib.camera import Camera, LensModel
from calib.errors import InputError
from calib.rig import MAX_BASELINE_M, MIN_BASELINE_M, StereoRig
from calib.types import F64, Bool

FOLDS = 5

LENSES: tuple[Lens, ...] = (
    Lens("no distortion", "brown", 4, cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_ZERO_TANGENT_DIST),
    Lens("brown (k1 k2)", "brown", 4, cv2.CALIB_ZERO_TANGENT_DIST),
    Lens("brown (k1 k2 p1 p2)", "brown", 4),
    Lens("fisheye (k1-k4)", "fisheye", 4),
    Lens("rational (k1-k6 p1 p2)", "rational", 8),
)
"""Simplest first. A coefficient that the lens does not have costs accuracy: p1 and p2 trade off against the principal
point, and that against the rotation between the cameras (0.02 degrees become 0.1 with 12 views)."""


@dataclass(frozen=True)
class LensChoice:
    """A lens model that was tried.

    Attributes:
        lens: the model.
        held_out_px: rms over views that were left out of the fit (k-fold), poses fitted only.
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


def fit_lens(views: Sequence[BoardView], points: F64, size: tuple[int, int], lens: Lens) -> RigFit:
    """A rig with this lens, from nothing but the views. Raises FitError: no rig fits."""
    left, right = (fit_camera(views, points, side, size, lens).camera for side in ("left", "right"))
    return fit_rig(views, points, (left, right), lens)


def compare_lenses(
    views: Sequence[BoardView], points: F64, size: tuple[int, int], lenses: Sequence[Lens] = LENSES
) -> tuple[LensChoice, ...]:
    """Judge lens models on views left out of their fit (k-fold). Raises FitError: no lens fits."""
    fits = _fits(views, points, size, lenses)
    best = min(fit.rms_px for fit in fits.values())
    # A lens whose fit is this many times worse than the best fit is not judged further: on views left out no lens
    # does better than on those it was fitted to (our choice).
    judged, folds = {}, np.arange(len(views)) % min(FOLDS, len(views))
    for lens, fit in fits.items():
        with suppress(FitError):  # a fold leaves too little to fit the lens to
            if fit.rms_px <= 1.5 * best:
                judged[lens] = [_held_out(views, points, fit, lens, folds == k) for k in range(folds.max() + 1)]
    if not judged:
        raise FitError("no lens model fits the views")
    table = np.array(list(judged.values()))
    differences = table - table[int(np.argmin(table.mean(axis=1)))]
    errors = differences.std(axis=1, ddof=1) / math.sqrt(table.shape[1])
    means = np.sqrt(table.mean(axis=1))
    return tuple(
        # The error of a mean square becomes that of its root.
        LensChoice(
            lens,
            float(mean),
            float(error / (2 * mean)),
            any(map(folds_back, (fits[lens].rig.left, fits[lens].rig.right))),
        )
        for lens, mean, error in zip(judged, means, errors, strict=True)
    )


def _fits(views: Sequence[BoardView], points: F64, size: tuple[int, int], lenses: Sequence[Lens]) -> dict[Lens, RigFit]:
    """The lenses that fit at all, each fitted to all views."""
    fits = {}
    for lens in lenses:
        with suppress(FitError):
            fits[lens] = fit_lens(views, points, size, lens)
    if not fits:
        raise FitError("no lens model fits the views")
    return fits


def best_base(
    views: Sequence[BoardView], points: F64, size: tuple[int, int], lenses: Sequence[Lens]
) -> tuple[Lens, RigFit]:
    """The simplest lens that fits within 5 % of the best, to find outliers with. Raises FitError: none fits."""
    fits = _fits(views, points, size, lenses)
    # A model with more freedom always fits a little better.
    limit = 1.05 * min(fit.rms_px for fit in fits.values())
    return next((lens, fit) for lens, fit in fits.items() if fit.rms_px <= limit)


def _held_out(views: Sequence[BoardView], points: F64, full: RigFit, lens: Lens, out: Bool) -> float:
    """Mean square error [px^2] over the fold's views of a rig fitted without them."""
    inside = [view for view, left_out in zip(views, out, strict=True) if not left_out]
    rig = fit_rig(inside, points, (full.rig.left, full.rig.right), lens, REFIT_ITERATIONS).rig
    judged = [(views[i], full.poses[i]) for i in np.flatnonzero(out).tolist()]
    squares = [held_out_error(rig, view, points, pose) for view, pose in judged]
    return float(np.average(squares, weights=[len(view.ids) for view, _ in judged]))


def choose_lens(tried: Sequence[LensChoice]) -> LensChoice:
    """The simplest lens that is no worse than the best by more than one standard error (Breiman's rule) or 0.5 %.

    One that turns back inside the image gives way to another that is worse by no more than 3 % (our choice).
    """
    best = min(one.held_out_px for one in tried)
    # A standard error from five folds is at times too small by chance (our choice; 0.0005 of tangential distortion
    # makes 1 %).
    near = [one for one in tried if one.held_out_px - best <= max(one.std_error_px, 0.005 * best)]
    whole = [one for one in near if not one.folds_back]
    whole = whole or [one for one in tried if not one.folds_back and one.held_out_px <= 1.03 * best]
    return (whole or near)[0]


def folds_back(camera: Camera) -> bool:
    """Does the lens model turn back, or have no ray, somewhere inside the image?"""
    w, h = camera.width - 1.0, camera.height - 1.0
    along = np.linspace(0.0, 1.0, 13)
    sides = [(np.full(13, u), along * h) for u in (0.0, w)] + [(along * w, np.full(13, v)) for v in (0.0, h)]
    rays = camera.unproject(np.column_stack([np.concatenate(axis) for axis in zip(*sides, strict=True)]))
    if not np.isfinite(rays).all():
        return True
    steps = np.linspace(0.0, 1.0, 40)[:, None, None]
    inner = np.concatenate([rays[None, :, :2] * steps, np.ones((40, len(rays), 1))], axis=2)
    pixels = camera.project(inner.reshape(-1, 3)).reshape(40, -1, 2)
    radius = np.linalg.norm(pixels - [camera.cx, camera.cy], axis=2)
    return bool((np.diff(radius, axis=0) <= 0).any())


MIN_PAIRS = 5
"""Fewer pairs leave focal length and distortion to chance (three orientations are the bare minimum; our choice)."""


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
        fit: reprojection errors and board poses.
        std: standard deviation of every parameter, by the names of ``rig_parameters``.
        rejected: pairs that were not used.
        lenses: models tried, simplest first.
    """

    rig: StereoRig
    board: Board
    views: tuple[BoardView, ...]
    fit: RigFit
    std: dict[str, float]
    rejected: tuple[RejectedView, ...]
    lenses: tuple[LensChoice, ...]

    @property
    def parameters(self) -> dict[str, float]:
        """Every parameter by its name."""
        return rig_parameters(self.rig)

    @property
    def chosen_lens(self) -> LensChoice:
        """The lens that was chosen."""
        return choose_lens(self.lenses)

    @property
    def baseline_squares(self) -> float:
        """Baseline in sides of a square: known from the images alone, whatever the square's size."""
        return self.rig.baseline_m / self.board.square_m

    @property
    def row_rms_px(self) -> float:
        """Rms difference of the rows of a corner in the rectified images [px]: what a matcher must bear."""
        errors = []
        for view in self.views:
            rays = self.rig.left.unproject(view.left), self.rig.right.unproject(view.right)
            rows = [(ray @ turn.T) for ray, turn in zip(rays, self.rig.rectifying_rotations(), strict=True)]
            away = (rows[0][:, 1] / rows[0][:, 2] - rows[1][:, 1] / rows[1][:, 2]) * self.rig.left.fy
            errors.append(np.column_stack([np.zeros(len(away)), away]))
        return rms(errors)

    def coverage(self, side: Side, cols: int = 8, rows: int = 6) -> F64:
        """(rows, cols) number of corners in each cell of the image."""
        pixels = np.concatenate([view.image_points(side) for view in self.views])
        edges = (
            np.linspace(-0.5, self.rig.left.height - 0.5, rows + 1),
            np.linspace(-0.5, self.rig.left.width - 0.5, cols + 1),
        )
        return np.asarray(np.histogram2d(pixels[:, 1], pixels[:, 0], bins=edges)[0], dtype=np.float64)

    def coverage_share(self, side: Side) -> float:
        """Share of the image's cells that hold a corner."""
        return float((self.coverage(side) > 0).mean())


def solve_board(
    views: Sequence[BoardView],
    board: Board,
    size: tuple[int, int],
    *,
    model: LensModel | None = None,
    rejected: Sequence[RejectedView] = (),
    source: str = "board images",
) -> BoardCalibration:
    """Calibrate a stereo rig.

    Args:
        views: corners per pair.
        board: the board they belong to.
        size: (width, height) of all images [px].
        model: lens model; None chooses by the error of views left out of the fit.
        rejected: pairs that were refused before, to be named with those refused here.
        source: for messages and the rig.
    Raises:
        InputError: too few or degenerate views, or views that no two cameras side by side can have taken.
    """
    if len(views) < MIN_PAIRS:
        first = f", e.g. {rejected[0].name}: {rejected[0].why}" if rejected else ""
        raise InputError(
            f"{source}: expected at least {MIN_PAIRS} pairs that show a {board.name} in both images, "
            f"found {len(views)} of {len(views) + len(rejected)}{first}"
        )
    # Fewer than three clearly different board poses cannot determine a camera, however many images show them.
    limit = 0.02 * size[0]
    distinct: list[BoardView] = []
    for view in views:
        if all(_apart(view, other) > limit for other in distinct):
            distinct.append(view)
    if len(distinct) < 3:
        raise InputError(
            f"{source}: expected the board in different places and tilts, found {len(distinct)} different "
            f"pose{'s' if len(distinct) > 1 else ''} in {len(views)} views (corners within {limit:.0f} px)"
        )
    try:
        lenses = [one for one in LENSES if model in {None, one.model}]
        points, kept, out = board.points, list(views), list(rejected)
        base, fit = best_base(kept, points, size, lenses)
        fit, kept = _without_outliers(fit, kept, out, points, base, source)
        # A better lens will fit better, but not this much better.
        _refuse_unfit(fit, size, source, slack=3.0)
        for side in SIDES:  # by the deviation that OpenCV gives for one camera
            alone = fit_camera(kept, points, side, size, base)
            _refuse_deviation(side, alone.camera.fx, alone.focal_std_px, source)
        tried = compare_lenses(kept, points, size, lenses)
        lens = choose_lens(tried).lens
        fit, kept = _without_outliers(fit_lens(kept, points, size, lens), kept, out, points, lens, source)
        std = standard_deviations(kept, points, fit, lens)
        rig = _checked_rig(fit, std, size, source)
        return BoardCalibration(rig, board, tuple(kept), replace(fit, rig=rig), std, tuple(out), tried)
    except FitError as error:
        raise InputError(f"{source}: expected views of a flat board by two fixed cameras: {error}") from error


def _apart(one: BoardView, other: BoardView) -> float:
    """Largest distance between the same corners of two left images; infinite when they share none."""
    _, i, j = np.intersect1d(one.ids, other.ids, return_indices=True)
    # A chessboard's order is known up to half a turn, so that turned orders count as the same pose.
    if len(i) == 0:
        return math.inf
    a, b = one.left[i], other.left[j]
    return float(min(np.linalg.norm(a - b, axis=1).max(), np.linalg.norm(a - b[::-1], axis=1).max()))


def _without_outliers(
    fit: RigFit, views: list[BoardView], out: list[RejectedView], points: F64, lens: Lens, source: str
) -> tuple[RigFit, list[BoardView]]:
    """Drop the worst view and fit again, until none stands out."""
    total = len(views)
    while True:
        each = fit.view_rms_px()
        worst, median = int(np.argmax(each)), float(np.median(each))
        # An outlier has 2.5 times the median rms of all views (good ones differ by up to 1.6) and more than 0.3 px:
        # corners are found no better than 0.1 to 0.3 px.
        if each[worst] <= max(2.5 * median, 0.3):
            return fit, views
        why = f"reprojection error {each[worst]:.2f} px, {each[worst] / median:.0f} times the median of {median:.2f} px"
        out.append(RejectedView(views[worst].name, why))
        views = views[:worst] + views[worst + 1 :]
        # When more views than this disagree, there is no telling which half is right.
        if len(views) < max(MIN_PAIRS, 0.5 * total):
            raise InputError(
                f"{source}: expected views that agree on one rig, found {total - len(views)} of {total} that do not, "
                f"the last {out[-1].name} with a {why}"
            )
        # From the start: what the bad view did to the cameras must not linger.
        fit = fit_lens(views, points, fit.rig.left.size, lens)


def _refuse_unfit(fit: RigFit, size: tuple[int, int], source: str, slack: float = 1.0) -> None:
    """Refuse views that no fixed pair of cameras explains."""
    # Share of the image width; a worse fit means images that do not belong together.
    if not fit.rms_px <= slack * 0.003 * size[0]:
        raise InputError(
            f"{source}: expected pairs taken at the same moment by two fixed cameras, found a reprojection error "
            f"of {fit.rms_px:.2f} px"
        )


def _refuse_deviation(side: Side, focal_px: float, std_px: float, source: str) -> None:
    """Refuse views that leave a focal length open."""
    # Relative standard deviation above which the views do not determine it (depth errs as much).
    if std_px > 0.02 * focal_px:
        raise InputError(
            f"{source}: expected views that determine the {side} focal length, found {focal_px:.0f} +- "
            f"{std_px:.0f} px: tilt the board more, towards all sides"
        )


def _checked_rig(fit: RigFit, std: dict[str, float], size: tuple[int, int], source: str) -> StereoRig:
    _refuse_unfit(fit, size, source)
    for side in SIDES:
        _refuse_deviation(side, getattr(fit.rig, side).fx, std[f"{side} fx"], source)
    rig = replace(fit.rig, source=source)
    if not MIN_BASELINE_M <= rig.baseline_m <= MAX_BASELINE_M:
        raise InputError(
            f"{source}: expected a baseline of {MIN_BASELINE_M}-{MAX_BASELINE_M:g} m, found {rig.baseline_m:g} m: "
            "is the size of a square right?"
        )
    return rig.check(source)
