"""The choice of a lens model, judged on views left out of the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from calib.board.fit import REFIT_ITERATIONS, FitError, Lens, fit_camera, fit_rig, held_out_error
from calib.board.model import BoardView, RigFit
from calib.camera import Camera
from calib.types import F64, Bool

FOLD_TOLERANCE = 0.03
"""Share by which a lens may be worse on held-out views if it spares the image a fold (our choice)."""
FOLDS = 5
HOPELESS = 1.5
"""A lens whose fit is this many times worse than the best fit is not judged further: on views left out no lens does
better than on those it was fitted to (our choice)."""

LENSES: tuple[Lens, ...] = (
    Lens("no distortion", "brown", 4, frozenset()),
    Lens("brown (k1 k2)", "brown", 4, frozenset({"k1", "k2"})),
    Lens("brown (k1 k2 k3)", "brown", 5, frozenset({"k1", "k2", "k3"})),
    Lens("brown (k1 k2 p1 p2)", "brown", 4, frozenset({"k1", "k2", "p1", "p2"})),
    Lens("brown (k1 k2 k3 p1 p2)", "brown", 5, frozenset({"k1", "k2", "k3", "p1", "p2"})),
    Lens("fisheye (k1-k4)", "fisheye", 4, frozenset({"k1", "k2", "k3", "k4"})),
    Lens("rational (k1-k6)", "rational", 8, frozenset({"k1", "k2", "k3", "k4", "k5", "k6"})),
    Lens("rational (k1-k6 p1 p2)", "rational", 8, frozenset({"k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"})),
)
"""Simplest first. Tangential coefficients trade off against the principal point, so that they cost accuracy where
the lens has none."""
BASES: tuple[Lens, ...] = (LENSES[1], LENSES[5], LENSES[6])
"""Lenses to start from, one of each model."""


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
    """A rig with this lens, from nothing but the views.

    Raises:
        FitError: no rig fits.
    """
    left, right = (fit_camera(views, points, side, size, lens).camera for side in ("left", "right"))
    return fit_rig(views, points, (left, right), lens)


def compare_lenses(
    views: Sequence[BoardView], points: F64, size: tuple[int, int], lenses: Sequence[Lens] = LENSES
) -> tuple[LensChoice, ...]:
    """Judge lens models on views left out of their fit (k-fold).

    Raises:
        FitError: no lens fits.
    """
    fits = _fits(views, points, size, lenses)
    best = min(fit.rms_px for fit in fits.values())
    judged = {
        lens: squares
        for lens, fit in fits.items()
        if fit.rms_px <= HOPELESS * best and (squares := _judge(views, points, fit, lens)) is not None
    }
    if not judged:
        raise FitError("no lens model fits the views")
    table = np.array(list(judged.values()))
    differences = table - table[int(np.argmin(table.mean(axis=1)))]
    errors = differences.std(axis=1, ddof=1) / math.sqrt(table.shape[1])
    means = np.sqrt(table.mean(axis=1))
    return tuple(
        # The error of a mean square becomes that of its root.
        LensChoice(lens, float(mean), float(error / (2 * mean)), _either_folds_back(fits[lens]))
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
    """The lens of ``BASES`` that fits best, to find outliers with; the simplest one within 5 % of the best.

    Raises:
        FitError: none fits.
    """
    fits = _fits(views, points, size, [lens for lens in BASES if lens in lenses])
    # A model with more freedom always fits a little better.
    limit = 1.05 * min(fit.rms_px for fit in fits.values())
    return next((lens, fit) for lens, fit in fits.items() if fit.rms_px <= limit)


def _judge(views: Sequence[BoardView], points: F64, fit: RigFit, lens: Lens) -> list[float] | None:
    """Mean square error [px^2] of each fold; None when a fold leaves too little to fit the lens to."""
    folds = min(FOLDS, len(views))
    try:
        return [_held_out(views, points, fit, lens, np.arange(len(views)) % folds == k) for k in range(folds)]
    except FitError:
        return None


def _held_out(views: Sequence[BoardView], points: F64, full: RigFit, lens: Lens, out: Bool) -> float:
    """Mean square error [px^2] over the fold's views of a rig fitted without them."""
    inside = [view for view, left_out in zip(views, out, strict=True) if not left_out]
    rig = fit_rig(inside, points, (full.rig.left, full.rig.right), lens, REFIT_ITERATIONS).rig
    judged = [(views[i], full.poses[i]) for i in np.flatnonzero(out).tolist()]
    squares = [held_out_error(rig, view, points, pose) for view, pose in judged]
    return float(np.average(squares, weights=[len(view.ids) for view, _ in judged]))


def choose_lens(tried: Sequence[LensChoice]) -> LensChoice:
    """The simplest lens that is no worse than the best by more than one standard error (Breiman's rule).

    One that turns back inside the image gives way to another that is worse by no more than ``FOLD_TOLERANCE``.
    """
    best = min(one.held_out_px for one in tried)
    near = [one for one in tried if one.held_out_px - best <= one.std_error_px]
    whole = [one for one in near if not one.folds_back]
    whole = whole or [one for one in tried if not one.folds_back and one.held_out_px <= (1 + FOLD_TOLERANCE) * best]
    return (whole or near)[0]


def _either_folds_back(fit: RigFit) -> bool:
    return folds_back(fit.rig.left) or folds_back(fit.rig.right)


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
