"""Affine model of the row offsets of matched corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64
from stereo.rig_correction import MatchParams as VerticalParams
from stereo.rig_correction import RigCorrection as VerticalFit
from stereo.rig_correction import match_corners

__all__ = ["VerticalFit", "VerticalModel", "VerticalParams", "fit_affine", "match_corners"]


@dataclass(frozen=True)
class VerticalModel:
    """Row offset v_right - v_left of matching points, affine over the right image.

    Attributes:
        offset_px: at the image's pixel (0, 0) [px].
        per_u, per_v: change per pixel along a row and down a column.
    """

    offset_px: float = 0.0
    per_u: float = 0.0
    per_v: float = 0.0

    def __call__(self, u: F64, v: F64) -> F64:
        """Offsets [px] at pixels of any shape."""
        return np.asarray(self.offset_px + self.per_u * u + self.per_v * v, dtype=np.float64)

    @property
    def matrix(self) -> F64:
        """(3, 3) homogeneous pixel (u, v) to (u, v + offset)."""
        return np.array([[1.0, 0.0, 0.0], [self.per_u, 1.0 + self.per_v, self.offset_px], [0.0, 0.0, 1.0]])


def fit_affine(matches: F64, slopes: bool = True) -> VerticalModel:
    """Robust fit of the row offsets, by iteratively reweighted least squares (Huber).

    Args:
        matches: (N, 4) as from ``match_corners``.
        slopes: whether the offset may change over the image.
    """
    u, v, target = matches[:, 2], matches[:, 1], matches[:, 3]
    if not slopes:
        return VerticalModel(float(np.median(target)))
    columns = np.column_stack([np.ones_like(u), u - u.mean(), v - v.mean()])
    solution = np.array([np.median(target), 0.0, 0.0])
    for _ in range(20):
        residual = target - columns @ solution
        scale = max(1.4826 * float(np.median(np.abs(residual))), 0.02)
        weight = np.where(np.abs(residual) < 4.0 * scale, 1.0 / np.maximum(np.abs(residual), scale), 0.0)
        normal = columns.T @ (columns * weight[:, None])
        solution = np.linalg.lstsq(normal, columns.T @ (weight * target), rcond=None)[0]
    offset = solution[0] - solution[1] * u.mean() - solution[2] * v.mean()
    return VerticalModel(float(offset), float(solution[1]), float(solution[2]))
