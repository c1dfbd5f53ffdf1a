"""The human body of every tracker: anthropometric numbers, and how a body looks along a ray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from calib.people.model import ADULT_HEIGHT_M, ADULT_HEIGHT_STD_M, HumanModel
from calib.types import F32, F64, Bool

HEIGHT_MEAN_M, HEIGHT_STD_M = ADULT_HEIGHT_M, ADULT_HEIGHT_STD_M
HEIGHT_MIN_M, HEIGHT_MAX_M = 0.80, 2.10
"""Heights of a head [m], from somebody who sits on the floor to a very tall man who walks."""
THING_SHARE = 0.1
"""Share of what comes into view that is moved furniture and carried things, of any height up to a person's."""
THING_RADII = (0.12, 0.2, 0.34)
"""Radii of things over their heights, from a pillar to a crate."""
SPEED_MAX_MPS = 2.5
"""Fastest walk [m/s]: men change to running at 2.0 to 2.5 m/s (Hreljac 1993)."""
SPEED_STD_MPS = 1.0
"""Deviation of a walker's speed: of one who appears, and of the mean one out of sight [m/s]."""
ACCELERATION_MPS2 = 2.0
"""Deviation of a walker's acceleration [m/s^2]: walkers stop and turn within a second."""
SLOW_DOWN_S = 0.7
"""Time in which an unseen person's speed decays [s]."""
LEAVE_S = 0.7
"""Mean time that a person beyond the border stays unknown and near [s]."""
LOG_ODDS_MAX = 8.0
"""Existence is never surer than this."""
REACH_M = 0.9
"""From the body's axis to a hand that holds something [m]: shoulder breadth / 2 + arm of 0.73 m (NASA-STD-3000)."""
TORSO = HumanModel()
"""Zhang et al. 2008, table 1."""
CHEST_DEPTH = 0.65
"""A chest's depth over the breadth of torso and arms: 0.24 m over 0.42 m (NASA-STD-3000, median man)."""
Profile = tuple[tuple[float, float, float, float], ...]
PROFILE: Profile = (
    (0.00, 0.48, 0.13, 0.55),
    (0.48, 0.78, TORSO.torso_radius_m, CHEST_DEPTH),
    (0.78, 0.82, 0.17, CHEST_DEPTH),
    (0.82, 0.87, 0.07, 1.0),
    (0.87, 0.97, TORSO.head_radius_m, 0.6),
    (0.97, 1.00, 0.06, 0.6),
)
"""Legs, torso, the slope of the shoulders, neck, head and crown: from and to [of the height], half breadth [m] of a
body of 1.76 m, depth over breadth. Hip, shoulder (0.818), chin (0.870) after Drillis and Contini 1966, radii of torso
and head after Zhang, the other breadths ours."""
ARMS: Profile = ((0.0, 0.42, 0.27, 0.5), (0.42, 0.78, 0.31, 0.4))
ARMS_SHARE = 0.35
"""Where striding legs and arms may be next to the body, and how often they are there."""
APART_M = 2.0 * TORSO.torso_radius_m
"""Axes of two bodies side by side [m]."""


def stature(height_m: float, tall_m: float, std_m: float, low_share: float) -> float:
    """Density [1/m] of a person's height now: upright, or as likely anything lower."""
    off = (height_m - tall_m) / std_m
    return (1 - low_share) * math.exp(-0.5 * off * off) / (math.sqrt(2 * math.pi) * std_m) + low_share / tall_m


def within_reach(gone_s: float, away_m: float) -> bool:
    """Whether a walker unseen for a time can be this far from where it was seen last."""
    return gone_s > 0 and away_m <= TORSO.torso_radius_m + SPEED_MAX_MPS * gone_s


def same_place(gone_s: float, away_m: float, floor_m2: float) -> float:
    """Log-odds that whoever appears this far from where a walker was last seen is that walker, rather than a stranger
    somewhere on a floor of this size."""
    spread_m = min(TORSO.torso_radius_m + SPEED_STD_MPS * gone_s, math.sqrt(floor_m2) / 2)
    return math.log(floor_m2 / (2 * math.pi * spread_m**2)) - 0.5 * (away_m / spread_m) ** 2


def same_height(height_m: float, std_m: float, tall_m: float, tall_std_m: float, low_share: float) -> float:
    """Log-odds that a height, measured with a deviation, is that of a known person rather than of a stranger or a
    thing."""
    mine = stature(height_m, tall_m, math.hypot(tall_std_m, std_m), low_share)
    stranger = stature(height_m, HEIGHT_MEAN_M, math.hypot(HEIGHT_STD_M, std_m), low_share)
    return math.log(mine / ((1 - THING_SHARE) * stranger + THING_SHARE / HEIGHT_MEAN_M))


class BodyTable(NamedTuple):
    """How a body of ``TORSO.height_m`` looks along rays, for the depression angle of the ray.

    A ray is described by where it passes the body's centre: ``u`` across it and ``w`` up, both perpendicular to the
    ray. Sizes scale with the body's height.

    Attributes:
        cover: (A, U, W) float32, probability that the body covers the ray; symmetric in u, of which |u| is kept.
        front: (A, U, W) float32 [m], how far the surface lies before the point of the ray nearest to the centre.
        angle_min_rad, angle_step_rad, cell_m, w_min_m: of the axes.
    """

    cover: F32
    front: F32
    angle_min_rad: float
    angle_step_rad: float
    cell_m: float
    w_min_m: float


ANGLE_MIN_DEG, ANGLE_STEP_DEG, ANGLES = -30.0, 5.0, 25
CELL_M, FINE_M = 0.025, 0.0125
BLUR_M = 0.04
"""Deviation of a body's outline from the cylinders: clothes, arms and posture [m] (Harville 2002: 1 to 4 cm)."""
U_CELLS, W_CELLS = 16, 88


@lru_cache(maxsize=1)
def body_table() -> BodyTable:
    """Of Zhang's three cylinders, with arms and strides."""
    return table_of(((PROFILE, 1.0), (ARMS, ARMS_SHARE)), BLUR_M)


@lru_cache(maxsize=1)
def thing_tables() -> tuple[BodyTable, ...]:
    """Of things: upright cylinders with a flat top, scaled as bodies are."""
    radii_m = (slimness * TORSO.height_m for slimness in THING_RADII)
    return tuple(table_of(((((0.0, 1.0, r, 1.0),), 1.0),), BLUR_M, 2 * U_CELLS) for r in radii_m)


def table_of(parts: Sequence[tuple[Profile, float]], blur_m: float, u_cells: int = U_CELLS) -> BodyTable:
    """The table of parts that cover with a probability each: of those on a ray, the likeliest one."""
    fine = round(CELL_M / FINE_M)
    u = (np.arange(-u_cells * fine, u_cells * fine) + 0.5) * FINE_M
    w = (np.arange(W_CELLS * fine) + 0.5 - W_CELLS * fine / 2) * FINE_M
    across, up = np.meshgrid(u, w, indexing="ij")
    angles = np.deg2rad(ANGLE_MIN_DEG + ANGLE_STEP_DEG * np.arange(ANGLES))
    cover = np.empty((ANGLES, u_cells, W_CELLS), np.float32)
    front = np.empty_like(cover)
    for a, depression in enumerate(angles.tolist()):
        share, ahead = np.zeros((2, *across.shape))
        for profile, covers in parts:
            hit, near = cylinders(depression, across, up, profile)
            inside = cv2.GaussianBlur(hit.astype(np.float64), (0, 0), blur_m / FINE_M)
            near = cv2.GaussianBlur(near, (0, 0), blur_m / FINE_M) / np.maximum(inside, 1e-6)
            likelier = covers * inside > share
            share = np.where(likelier, covers * inside, share)
            ahead = np.where(likelier, near, ahead)
        for whole, table in ((share, cover), (np.where(share > 1e-3, ahead, 0.0), front)):
            half = whole[u_cells * fine :].reshape(u_cells, fine, W_CELLS, fine)
            table[a] = half.mean(axis=(1, 3))
    return BodyTable(cover, front, float(angles[0]), float(np.deg2rad(ANGLE_STEP_DEG)), CELL_M, -W_CELLS * CELL_M / 2)


def cylinders(depression: float, u: F64, w: F64, profile: Profile) -> tuple[Bool, F64]:
    """Which rays hit a cylinder, and how far before the point nearest to the body's centre [m]."""
    c, s = np.cos(depression), np.sin(depression)
    c = c if abs(c) > 1e-6 else 1e-6
    s = s if abs(s) > 1e-6 else 1e-6
    enter = np.full(u.shape, np.inf)
    for low_share, high_share, radius, ratio in profile:
        low, high = low_share * TORSO.height_m, high_share * TORSO.height_m
        # From above it may face anywhere: a circle of the same area.
        steep = np.sin(depression) ** 2
        radius = radius * (1 - steep + steep * np.sqrt(ratio))
        depth = ratio ** (1 - steep)
        chord = depth * np.sqrt(np.maximum(radius**2 - u**2, 0.0))
        sides = np.sort(np.stack([(-chord - w * s) / c, (chord - w * s) / c]), axis=0)
        middle = TORSO.height_m / 2 + w * c
        caps = np.sort(np.stack(np.broadcast_arrays((middle - high) / s, (middle - low) / s)), axis=0)
        first, last = np.maximum(sides[0], caps[0]), np.minimum(sides[1], caps[1])
        enter = np.where((np.abs(u) < radius) & (first < last), np.minimum(enter, first), enter)
    hit = np.isfinite(enter)
    return hit, np.where(hit, -enter, 0.0)
