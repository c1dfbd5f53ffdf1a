"""A stereo rig from views of a board: fit, choice of the lens, outlier views, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from calib.board.detect import Board, BoardView, Side
from calib.board.fit import (
    REFIT_ITERATIONS,
    FitError,
    Lens,
    RigFit,
    fit_camera,
    fit_rig,
    held_out_error,
    standard_deviations,
)
from calib.camera import LensModel
from calib.errors import InputError
from calib.rig import MAX_BASELINE_M, MIN_BASELINE_M, StereoRig
from calib.types import F64

FOLDS = 5
"""Parts of the views that are left out of a fit in turn."""

LENSES: tuple[Lens, ...] = (
    Lens("brown (k1 k2)", "brown", 4, cv2.CALIB_ZERO_TANGENT_DIST),
    Lens("brown (k1 k2 p1 p2)", "brown", 4),
    Lens("fisheye (k1-k4)", "fisheye", 4),
)
"""Simplest first. A coefficient that the lens does not have costs accuracy: p1 and p2 trade off against the principal
point, and that against the rotation between the cameras (0.02 degrees become 0.1 with 12 views)."""
RATIONAL = Lens("rational (k1-k6 p1 p2)", "rational", 8)
"""Only by name: its eight coefficients follow noise, and turn back inside the image."""


class LensChoice(NamedTuple):
    """A lens model that was tried, and its rms over views left out of its fit (k-fold) [px]."""

    lens: Lens
    held_out_px: float

    @property
    def name(self) -> str:
        """E.g. "brown (k1 k2)"."""
        return self.lens.name


def fit_lens(views: Sequence[BoardView], points: F64, size: tuple[int, int], lens: Lens) -> RigFit:
    """A rig with this lens, from nothing but the views. Raises FitError: no rig fits."""
    left = fit_camera(views, points, "left", size, lens)
    right = fit_camera(views, points, "right", size, lens)
    return fit_rig(views, points, (left, right), lens)


def fit_lenses(
    views: Sequence[BoardView], points: F64, size: tuple[int, int], lenses: Sequence[Lens]
) -> dict[Lens, RigFit]:
    """The lenses that fit about as well as the best one, each fitted to all views. Raises FitError: none fits."""
    fits = {}
    for lens in lenses:
        with suppress(FitError):
            fits[lens] = fit_lens(views, points, size, lens)
    if not fits:
        raise FitError("no lens model fits the views")
    # On views left out, no lens does better than on those it was fitted to.
    limit = 1.5 * min(fit.rms_px for fit in fits.values())
    return {lens: fit for lens, fit in fits.items() if fit.rms_px <= limit}


def compare_lenses(views: Sequence[BoardView], points: F64, fits: Mapping[Lens, RigFit]) -> tuple[LensChoice, ...]:
    """Judge lens models on views left out of their fit (k-fold)."""
    tried = []
    folds = min(FOLDS, len(views))
    for lens, full in fits.items():
        cameras = (full.rig.left, full.rig.right)
        squares = []  # mean square errors [px^2] of every view by a rig fitted without its fold
        with suppress(FitError):  # a fold leaves too little to fit the lens to
            for fold in range(folds):
                inside = [view for i, view in enumerate(views) if i % folds != fold]
                rig = fit_rig(inside, points, cameras, lens, REFIT_ITERATIONS).rig
                for i in range(fold, len(views), folds):
                    squares.append(held_out_error(rig, views[i], points, full.poses[i]))
            tried.append(LensChoice(lens, float(np.sqrt(np.mean(squares)))))
    if not tried:
        raise FitError("no lens model fits the views")
    return tuple(tried)


def choose_lens(tried: Sequence[LensChoice]) -> LensChoice:
    """The simplest lens that is no worse than the best by more than 1 % (less is chance, and 0.0005 of
    tangential distortion makes more)."""
    best = min(choice.held_out_px for choice in tried)
    return next(choice for choice in tried if choice.held_out_px <= 1.01 * best)


MIN_PAIRS = 5
"""Fewer pairs leave focal length and distortion to chance (three orientations are the bare minimum)."""


class RejectedView(NamedTuple):
    """A pair that was not used, and why."""

    name: str
    why: str


@dataclass(frozen=True, eq=False)
class BoardCalibration:
    """A rig and how far to trust it: the board and the views it was made from, reprojection errors and board poses,
    the standard deviation of every parameter by the names of ``rig_parameters``, pairs that were not used, and the lens
    models tried, simplest first."""

    rig: StereoRig
    board: Board
    views: tuple[BoardView, ...]
    fit: RigFit
    std: dict[str, float]
    rejected: tuple[RejectedView, ...]
    lenses: tuple[LensChoice, ...]

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
        left_turn, right_turn = self.rig.rectifying_rotations()
        left = self.rig.left.unproject(np.concatenate([view.left for view in self.views])) @ left_turn.T
        right = self.rig.right.unproject(np.concatenate([view.right for view in self.views])) @ right_turn.T
        differences = left[:, 1] / left[:, 2] - right[:, 1] / right[:, 2]
        return float(np.sqrt(np.mean(differences**2))) * self.rig.left.fy

    def coverage_share(self, side: Side) -> float:
        """Share of 8 x 6 cells of the image that hold a corner."""
        u, v = np.concatenate([view.image_points(side) for view in self.views]).T
        width, height = self.rig.left.size
        limits = [(-0.5, width - 0.5), (-0.5, height - 0.5)]
        counts = np.histogram2d(u, v, bins=(8, 6), range=limits)[0]
        return float((counts > 0).mean())


def solve_board(
    views: Sequence[BoardView],
    board: Board,
    size: tuple[int, int],
    *,
    model: LensModel | None = None,
    rejected: Sequence[RejectedView] = (),
    source: str = "board images",
) -> BoardCalibration:
    """Calibrate a stereo rig from views of a board. Raises InputError: too few or degenerate views, or views that no
    two cameras side by side can have taken.

    Args:
        size: (width, height) of all images [px].
        model: lens model; None chooses by the error of views left out of the fit.
        rejected: pairs that were refused before, to be named with those refused here.
        source: for messages and the rig.
    """
    if len(views) < MIN_PAIRS:
        actual = f"{len(views)} of {len(views) + len(rejected)}"
        if rejected:
            actual += f", e.g. {rejected[0].name}: {rejected[0].why}"
        expected = f"at least {MIN_PAIRS} pairs that show a {board.name} in both images"
        raise InputError(f"{source}: expected {expected}, found {actual}")
    _refuse_alike(views, 0.02 * size[0], source)
    lenses = LENSES
    if model is not None:
        lenses = tuple(lens for lens in (*LENSES, RATIONAL) if lens.model == model)
    try:
        points = board.points
        out = list(rejected)
        fits = fit_lenses(views, points, size, lenses)
        # Outliers are found with the simplest lens; a better one will fit better, but not three times better.
        base = next(iter(fits))
        _refuse_unfit(fits[base], size, source, slack=3.0)
        _, good = _leave_out_outliers(fits[base], list(views), out, points, base, source)
        if len(good) < len(views):
            fits = fit_lenses(good, points, size, lenses)
        tried = compare_lenses(good, points, fits)
        lens = choose_lens(tried).lens
        fit, good = _leave_out_outliers(fit_lens(good, points, size, lens), good, out, points, lens, source)
    except FitError as error:
        raise InputError(f"{source}: expected views of a flat board by two fixed cameras: {error}") from error
    std = standard_deviations(good, points, fit)
    _refuse_unfit(fit, size, source)
    _refuse_uncertain(fit.rig, std, source)
    rig = replace(fit.rig, source=source)
    if not MIN_BASELINE_M <= rig.baseline_m <= MAX_BASELINE_M:
        actual = f"{rig.baseline_m:g} m: is the size of a square right?"
        raise InputError(f"{source}: expected a baseline of {MIN_BASELINE_M}-{MAX_BASELINE_M:g} m, found {actual}")
    rig = rig.check(source)
    return BoardCalibration(rig, board, tuple(good), replace(fit, rig=rig), std, tuple(out), tried)


def _refuse_alike(views: Sequence[BoardView], limit: float, source: str) -> None:
    """Refuse fewer than three clearly different board poses, which cannot determine a camera."""
    distinct: list[BoardView] = []
    for view in views:
        if all(_distance(view, other) > limit for other in distinct):
            distinct.append(view)
    if len(distinct) < 3:
        poses = f"{len(distinct)} different pose{'s' if len(distinct) > 1 else ''}"
        actual = f"{poses} in {len(views)} views (corners within {limit:.0f} px)"
        raise InputError(f"{source}: expected the board in different places and tilts, found {actual}")


def _distance(one: BoardView, other: BoardView) -> float:
    """Largest distance between the same corners of two left images; infinite when they share none."""
    _, i, j = np.intersect1d(one.ids, other.ids, return_indices=True)
    if len(i) == 0:
        return math.inf
    a = one.left[i]
    b = other.left[j]
    # A chessboard looks the same after half a turn: turned orders count as the same pose.
    straight = np.linalg.norm(a - b, axis=1).max()
    turned = np.linalg.norm(a - b[::-1], axis=1).max()
    return float(min(straight, turned))


def _leave_out_outliers(
    fit: RigFit, views: list[BoardView], out: list[RejectedView], points: F64, lens: Lens, source: str
) -> tuple[RigFit, list[BoardView]]:
    """Drop the worst view and fit again, until none stands out."""
    total = len(views)
    while True:
        errors_px = fit.view_rms_px()
        worst = int(np.argmax(errors_px))
        worst_px = float(errors_px[worst])
        median_px = float(np.median(errors_px))
        # An outlier has 2.5 times the median rms of all views (good ones differ by up to 1.6) and more than 0.3 px:
        # corners are found no better than 0.1 to 0.3 px.
        if worst_px <= max(2.5 * median_px, 0.3):
            return fit, views
        times = f"{worst_px / median_px:.0f} times the median of {median_px:.2f} px"
        why = f"reprojection error {worst_px:.2f} px, {times}"
        out.append(RejectedView(views[worst].name, why))
        views = views[:worst] + views[worst + 1 :]
        # When more views than this disagree, nothing shows which half is right.
        if len(views) < max(MIN_PAIRS, 0.5 * total):
            actual = f"{total - len(views)} of {total} that do not, the last {out[-1].name} with a {why}"
            raise InputError(f"{source}: expected views that agree on one rig, found {actual}")
        # From the start: what the bad view did to the cameras must not linger.
        fit = fit_lens(views, points, fit.rig.left.size, lens)


def _refuse_unfit(fit: RigFit, size: tuple[int, int], source: str, slack: float = 1.0) -> None:
    """Refuse views that no fixed pair of cameras explains; the limit is a share of the image's width."""
    if not fit.rms_px <= slack * 0.003 * size[0]:
        actual = f"a reprojection error of {fit.rms_px:.2f} px"
        raise InputError(f"{source}: expected pairs taken at the same moment by two fixed cameras, found {actual}")


def _refuse_uncertain(rig: StereoRig, std: Mapping[str, float], source: str) -> None:
    """Refuse views that do not determine the focal lengths."""
    for side, camera in (("left", rig.left), ("right", rig.right)):
        std_px = std[f"{side} fx"]
        # Relative standard deviation above which the views do not determine it (depth errs as much).
        if std_px > 0.02 * camera.fx:
            actual = f"{camera.fx:.0f} +- {std_px:.0f} px: tilt the board more, towards all sides"
            raise InputError(f"{source}: expected views that determine the {side} focal length, found {actual}")
