"""The choice of a lens model, judged on views left out of the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.board.adjust import adjust
from calib.board.model import Estimate, View, coefficient_names
from calib.camera import Camera, LensModel
from calib.types import F64, Bool

FOLD_TOLERANCE = 0.03
"""Share by which a lens may be worse on held-out views if it spares the image a fold (our choice)."""
FOLDS = 5


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
BASES: tuple[Lens, ...] = (LENSES[1], LENSES[5], LENSES[6])
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
