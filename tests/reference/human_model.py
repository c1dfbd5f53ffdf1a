"""Plain numpy twin of the human-model tracker's likelihood (``planview/tracking/human_model/_kernels.py``)."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F64, U8
from planview.tracking.body import TORSO
from planview.tracking.human_model.explanation import MaskView

Pose = tuple[float, float, float]


def cover_of(view: MaskView, pose: Pose) -> tuple[F64, F64]:
    """(H, W) how probably a body covers each pixel, and the relative height of its axis there."""
    x, y, h = pose
    t, ray = view.table, view.rays.astype(np.float64)
    ex, ey, cos, sin = (ray[..., k] for k in range(4))
    dz = 0.5 * h - view.camera.height_m
    along, scale = x * ex + y * ey, TORSO.height_m / h
    u = (np.abs(y * ex - x * ey) * scale / t.cell_m).astype(int)
    w = np.trunc((-(along * sin + dz * cos) * scale - t.w_min_m) / t.cell_m).astype(int)
    inside = (u < t.cover.shape[1]) & (w >= 0) & (w < t.cover.shape[2])
    cover = np.where(inside, t.cover[view.angle, np.where(inside, u, 0), np.where(inside, w, 0)], 0.0)
    height = (view.camera.height_m - sin * (along * cos - dz * sin)) / h
    return np.asarray(cover, np.float64), np.where(inside, height, 0.0)


def gain(
    view: MaskView, kind: U8, pose: Pose, tall_m: float, others: list[tuple[Pose, float]], spacing_m: float
) -> float:
    """Lam of people who are certain with one more at a pose, less Lam without, without colours.

    Args:
        others: poses and heights when upright.
        spacing_m: distance of the samples on the body.
    """
    b, p = view.beliefs, view.params
    nearest = sorted([(math.hypot(*o[:2]), o, t) for o, t in others] + [(math.hypot(*pose[:2]), pose, tall_m)])
    layers = [(*cover_of(view, o), _hidden(o, t, b), 0.005 if o == pose else 0.01, o == pose) for _, o, t in nearest]
    mine, _ = cover_of(view, pose)
    away = math.sqrt(pose[0] ** 2 + pose[1] ** 2 + (0.5 * pose[2] - b.camera_m) ** 2)
    step = max(1, int(spacing_m * b.focal_px / away + 0.5))
    total = 0.0
    for row in range(0, kind.shape[0], step):
        # A row's weight is that of its ray nearest to the body.
        shift = (row // step % 2) * (step // 2)
        rays = view.rays[row, shift::step].astype(np.float64)
        ray = rays[np.argmin(np.abs(pose[1] * rays[:, 0] - pose[0] * rays[:, 1]))]
        ahead = (pose[0] * ray[0] + pose[1] * ray[1]) * ray[2] - (0.5 * pose[2] - b.camera_m) * ray[3]
        patch_px = max(b.focal_px * p.patch_m * ray[4] / ahead, b.patch_px)
        for col in range(shift, kind.shape[1], step):
            if mine[row, col] < 0.005 or kind[row, col] == 1:
                continue
            what, near = int(kind[row, col]), any(_near(view, other, row, col) for other, _ in others)
            ground = (1 - b.background) if what == 0 else (b.near_people if near else b.background)
            value = []
            for with_one in (False, True):
                free, explained = 1.0, 0.0
                for cover, height, hidden, least, is_new in layers:
                    if cover[row, col] > least and (with_one or not is_new):
                        explained += free * cover[row, col] * _of_body(what, height[row, col], hidden, b)
                        free *= 1.0 - cover[row, col]
                value.append(explained + free * ground)
            total += (step / patch_px) ** 2 * math.log(value[1] / value[0])
    return total


def _hidden(pose: Pose, tall_m: float, b) -> float:  # type: ignore[no-untyped-def]
    return b.hidden_sitting if pose[2] < b.sitting_from * tall_m else b.hidden


def _of_body(kind: int, z: float, hidden: float, b) -> float:  # type: ignore[no-untyped-def]
    o = hidden if z < b.hidden_to else 0.0
    seen = (1 - o) * b.body + o * b.background
    return seen if kind == 2 else (1 - o) * (1 - b.body) + o * (1 - b.background)


def _near(view: MaskView, pose: Pose, row: int, col: int) -> bool:
    ex, ey, cos, sin, _ = view.rays[row, col].astype(np.float64)
    x, y, h = pose
    z = view.camera.height_m - sin * ((x * ex + y * ey) * cos - (0.5 * h - view.camera.height_m) * sin)
    return abs(y * ex - x * ey) < view.beliefs.reach_m and -0.1 < z < h + 0.2
