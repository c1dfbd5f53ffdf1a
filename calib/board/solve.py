"""A stereo rig from views of a board: joint adjustment, outlier views, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.board.adjust import adjust
from calib.board.detect import Board
from calib.board.guess import first_guess
from calib.board.lens import LENSES, LensChoice, choose_lens, compare_lenses, with_lens
from calib.board.model import SIDES, Adjusted, Corners, Side, View, rms
from calib.camera import LensModel
from calib.errors import InputError
from calib.rig import MAX_BASELINE_M, MIN_BASELINE_M, StereoRig
from calib.types import F64

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
    # A better lens will explain more, but not this much more.
    _refuse_unfit(fit, size, source, slack=3.0)
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


def _refuse_unfit(fit: Adjusted, size: tuple[int, int], source: str, slack: float = 1.0) -> None:
    """Refuse views that no fixed pair of cameras explains, or that leave a focal length open."""
    if not fit.rms_px <= slack * MAX_RMS_WIDTHS * size[0]:
        raise InputError(
            f"{source}: expected pairs taken at the same moment by two fixed cameras, found a reprojection error "
            f"of {fit.rms_px:.2f} px"
        )
    for side in SIDES:
        camera, place = fit.estimate.camera(side), fit.names.index(f"{side} fx")
        std = math.sqrt(max(float(fit.covariance[place, place]), 0.0))
        if camera is not None and not std <= MAX_FOCAL_STD * camera.fx:
            raise InputError(
                f"{source}: expected views that determine the {side} focal length, found {camera.fx:.0f} +- "
                f"{std:.0f} px: tilt the board more, towards all sides"
            )


def _checked_rig(fit: Adjusted, size: tuple[int, int], source: str) -> StereoRig:
    left, right = fit.estimate.left, fit.estimate.right
    if left is None or right is None:
        raise ValueError("expected an adjustment of two cameras")
    _refuse_unfit(fit, size, source)
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
