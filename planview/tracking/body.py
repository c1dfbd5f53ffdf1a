"""The human body of every tracker: anthropometric numbers, and how a body looks along a ray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from calib.people.model import ADULT_HEIGHT_M, ADULT_HEIGHT_STD_M, HumanModel
from calib.types import F32, F64

HEIGHT_MEAN_M = ADULT_HEIGHT_M
HEIGHT_STD_M = ADULT_HEIGHT_STD_M
HEIGHT_MIN_M = 0.80
HEIGHT_MAX_M = 2.10
"""Heights of a head [m], from somebody who sits on the floor to a very tall man who walks."""
THING_SHARE = 0.1
"""Share of what comes into view that is moved furniture and carried things, of any height up to a person's."""
THINGS = ((0.0, 0.12, 1.0), (0.0, 0.2, 1.0), (0.0, 0.34, 1.0), (0.6, 0.1, 0.1), (0.6, 0.25, 1.0), (0.0, 0.1, 0.1))
"""Shapes of things over the height of their top: where they begin, half breadth, and depth over breadth. Cylinders from
a pillar to a crate, something flat or thick that is carried, with nothing below, and something flat that stands, as
what shows of a door's leaf."""
LOADED_PER_M = 0.075
"""Density of the heights of what people carry above their head [1/m]: three in a hundred do, up to 0.4 m above the mean
height (our choice)."""
FIRST_SHARE = 0.5
"""Share of a newcomer's first frame that is evidence of its shape: the frame has also chosen the pose (our choice)."""
COAT_SHARE = 0.001
"""Share of people whose clothes hide their legs down to the floor (our choice): a thing has no head above it."""
SPEED_MAX_MPS = 2.5
"""Fastest walk [m/s]: men change to running at 2.0 to 2.5 m/s (Hreljac 1993)."""
SEEN_STD_M = 0.1
WANDER_MPS = 0.9
"""Deviation of a place when somebody is last seen, or seen again [m], and of the mean speed out of sight once a walker
no longer walks on [m/s]. Our choice: the prediction errs by about 0.1 m after 0.3 s and by half a metre after 1 s."""
COMES_BACK = 0.3
DOOR_STD_M = 0.3
"""Share of those who return by the door by which they left, and deviation of their place there, half a door [m]."""
ACCELERATION_MPS2 = 2.0
"""Deviation of a walker's acceleration [m/s^2]: walkers stop and turn within a second."""
SLOW_DOWN_S = 0.7
"""Time in which an unseen person's speed decays [s]."""
LEAVE_S = 0.7
"""Mean time that a person beyond the border stays unknown and near [s]."""
TURNING_RAD2_PS = 1.0
"""Variance of the rotation of a person within a second [rad^2/s]."""
SIDEWARD_RAD = 0.25
"""Deviation of a walker's chest from the direction of walking [rad]."""
STROLL_MPS = 0.5
"""Speed with which a person who does not walk moves in any direction, whatever the facing [m/s]."""
LOG_ODDS_MAX = 8.0
"""Existence is never surer than this."""
REACH_M = 0.9
"""From the body's axis to a hand that holds something [m]: shoulder breadth / 2 + arm of 0.73 m (NASA-STD-3000)."""
TORSO = HumanModel()
"""Zhang et al. 2008, table 1."""
CHEST_DEPTH = 0.65
"""A chest's depth over the breadth of torso and arms: 0.24 m over 0.42 m (NASA-STD-3000, median man)."""
HEAD_M = 0.08
HEAD_DEPTH = 1.25
"""Half breadth of a head [m], and its length over its breadth: 15 and 19 cm (NASA-STD-3000, median man), and hair."""
CHEST_FROM = 0.70
NECK_FROM = 0.82
"""Relative heights from which on a body leans with its shoulders, and with its head."""
Profile = tuple[tuple[float, float, float, float], ...]
TRUNK: Profile = (
    (0.00, 0.48, 0.13, 0.55),
    (0.48, CHEST_FROM, TORSO.torso_radius_m, CHEST_DEPTH),
    (CHEST_FROM, 0.78, TORSO.torso_radius_m, CHEST_DEPTH),
    (0.78, NECK_FROM, 0.17, CHEST_DEPTH),
)
HEAD: Profile = ((NECK_FROM, 0.87, 0.07, 1.0), (0.87, 0.97, HEAD_M, HEAD_DEPTH), (0.97, 1.00, 0.07, HEAD_DEPTH))
"""Legs, torso, chest and the slope of the shoulders; neck, head and crown: from and to [of the height], half breadth
[m] of a body of 1.76 m, depth over breadth. Hip, shoulder (0.818), chin (0.870) after Drillis and Contini 1966, radius
of the torso after Zhang, the other breadths ours."""
LIMBS: Profile = ((0.0, 0.42, 0.16, 2.0), (0.42, 0.78, 0.31, 0.4))
LIMBS_SHARE = 0.35
"""Place of striding legs before and behind the body and of arms next to it, and the share of time they are there."""
LEAN_M = 0.2
"""Head before the feet of somebody who looks at a phone, at the floor or into a shelf [m]; shoulders half of it."""
LEAN_STD_M = 0.15
"""Deviation of a lean [m]."""
LEAN_ERROR = 0.25
"""Deviation of a head's place for each metre by which it was seen before the feet (real recordings from above)."""
APART_M = 2.0 * TORSO.torso_radius_m
"""Axes of two bodies side by side [m]."""


def height_density(height_m: float, stature_m: float, std_m: float, low_share: float) -> float:
    """Density [1/m] of a person's height now: upright, or as likely anything lower."""
    off = (height_m - stature_m) / std_m
    upright = (1 - low_share) * math.exp(-0.5 * off * off) / (math.sqrt(2 * math.pi) * std_m)
    return upright + low_share / stature_m


def is_within_reach(gone_s: float, away_m: float) -> bool:
    """True if a walker unseen for a time can be this far from where it was seen last."""
    return gone_s > 0 and away_m <= TORSO.torso_radius_m + SPEED_MAX_MPS * gone_s


def walking_on_s(gone_s: float) -> float:
    """Time for which somebody unseen for ``gone_s`` has walked on at the speed when last seen [s]."""
    return SLOW_DOWN_S * (1.0 - math.exp(-max(gone_s, 0.0) / SLOW_DOWN_S))


def log_odds_same_place(gone_s: float, away_m: float, back_m: float, floor_m2: float) -> float:
    """Log-odds that whoever appears is a walker who was lost, rather than a stranger somewhere on the floor.

    Args:
        gone_s: time since the walker was seen last.
        away_m: distance from where the walker has walked on to (``walking_on_s``).
        back_m: distance from where the walker was seen last.
        floor_m2: size of the floor.
    """
    spread_m = min(SEEN_STD_M + WANDER_MPS * (gone_s - walking_on_s(gone_s)), math.sqrt(floor_m2) / 2)
    ahead = (1.0 - COMES_BACK) / spread_m**2 * math.exp(-0.5 * (away_m / spread_m) ** 2)
    back = COMES_BACK / DOOR_STD_M**2 * math.exp(-0.5 * (back_m / DOOR_STD_M) ** 2)
    return math.log(max(floor_m2 * (ahead + back) / (2 * math.pi), 1e-9))


def log_odds_same_height(
    height_m: float, std_m: float, stature_m: float, stature_std_m: float, low_share: float
) -> float:
    """Log-odds that a height, measured with a deviation, is that of a person of a stature rather than of a stranger or
    a thing."""
    same = height_density(height_m, stature_m, math.hypot(stature_std_m, std_m), low_share)
    stranger = height_density(height_m, HEIGHT_MEAN_M, math.hypot(HEIGHT_STD_M, std_m), low_share)
    return math.log(same / ((1 - THING_SHARE) * stranger + THING_SHARE / HEIGHT_MEAN_M))


BLUR_M = 0.04
"""Deviation of a body's outline from the cylinders: clothes, arms and posture [m] (Harville 2002: 1 to 4 cm)."""


class BodyPart(NamedTuple):
    """Cylinders of a body that are drawn together.

    Attributes:
        profile: of each, from and to [of the height], half breadth [m], depth over breadth.
        blur_m: deviation of its outline.
        covers: how often the part is there. Parts that always are have outlines before each other, as a head before
            shoulders, across which their surfaces do not mix.
    """

    profile: Profile
    blur_m: float = BLUR_M
    covers: float = 1.0


class BodyTable(NamedTuple):
    """Look of a body of ``TORSO.height_m`` along rays, by the depression angle of the ray and by where the body faces.

    A ray is described by where it passes the body's centre: ``u`` to the left of it, seen from the camera, and ``w``
    up, both perpendicular to the ray. Sizes scale with the body's height.

    Attributes:
        cover: (P, A, U, W) float32, probability that the body covers the ray, of every posture: FACINGS directions of
            facing relative to the level direction of the ray, counterclockwise, upright and then with a lean of
            ``LEAN_M``; one posture for what looks the same from everywhere.
        front: (P, A, U, W) float32 [m], how far the surface lies before the point of the ray nearest to the centre.
        angle_min_rad, angle_step_rad, cell_m, w_min_m: of the axes; u is 0 in the middle.
    """

    cover: F32
    front: F32
    angle_min_rad: float
    angle_step_rad: float
    cell_m: float
    w_min_m: float


ANGLE_MIN_DEG = -30.0
ANGLE_STEP_DEG = 5.0
ANGLES = 25
FACINGS = 16
"""Directions of facing in a table, 22.5 degrees apart."""
FACINGS_PER_RAD = FACINGS / (2.0 * math.pi)
HALF_TURN_RAD = [facing / FACINGS_PER_RAD for facing in range(FACINGS // 2 + 1)]
TABLE_CELL_M = 0.025
"""Side of a cell of a table, across and up [m]."""
SURFACE_STD_M = 0.10
"""Deviation of a body's surface from its table [m]."""
U_CELLS = 32
W_CELLS = 88


@cache
def body_table() -> BodyTable:
    """Table of a person: trunk and head, with arms and strides."""
    parts = BodyPart(TRUNK), BodyPart(HEAD), BodyPart(LIMBS, covers=LIMBS_SHARE)
    tables = list[F32]()
    # Upright it looks from behind as from before.
    for lean_m, period in ((0.0, FACINGS // 2), (LEAN_M, FACINGS)):
        half = build_table(parts, HALF_TURN_RAD[: period // 2 + 1], lean_m)
        table = np.stack(half[:2])
        # Seen from its right a body is the mirror image of itself seen from its left.
        around = np.concatenate([table, table[:, -2:0:-1, :, ::-1]], axis=1)
        tables += [around] * (FACINGS // period)
    cover, front = np.concatenate(tables, 1)
    return half._replace(cover=cover, front=front)


@cache
def thing_tables() -> tuple[BodyTable, ...]:
    """Tables of things, scaled as bodies are; front and back look the same."""
    tables = []
    for bottom, slimness, depth in THINGS:
        part = BodyPart(((bottom, 1.0, slimness * TORSO.height_m, depth),))
        turns_rad = HALF_TURN_RAD[:-1] if depth < 1.0 else HALF_TURN_RAD[:1]
        tables.append(build_table((part,), turns_rad, u_cells=2 * U_CELLS))
    return tuple(tables)


@cache
def coat_table() -> BodyTable:
    """Table of a person in clothes that reach the floor, who looks the same from all sides."""
    coat = BodyPart(((0.0, NECK_FROM, TORSO.torso_radius_m, 1.0),))
    return build_table((coat, BodyPart(HEAD)), HALF_TURN_RAD[:1])


def build_table(
    parts: Sequence[BodyPart],
    turns_rad: Sequence[float | None] = (None,),
    lean_m: float = 0.0,
    u_cells: int = U_CELLS,
) -> BodyTable:
    """Table of some postures: of the parts on a ray, the likeliest one; see ``enter_cylinders``."""
    across = _cell_centres(u_cells)[:, None]
    up = _cell_centres(W_CELLS)[None, :]
    angles = np.deg2rad(ANGLE_MIN_DEG + ANGLE_STEP_DEG * np.arange(ANGLES))
    cover = np.empty((len(turns_rad), ANGLES, u_cells, W_CELLS), np.float32)
    front = np.empty_like(cover)
    for k, turn_rad in enumerate(turns_rad):
        for a, depression in enumerate(angles.tolist()):
            cover[k, a], front[k, a] = _render_parts(parts, depression, across, up, turn_rad, lean_m)
    lowest_m = -W_CELLS * TABLE_CELL_M / 2
    return BodyTable(cover, front, float(angles[0]), float(np.deg2rad(ANGLE_STEP_DEG)), TABLE_CELL_M, lowest_m)


def _cell_centres(n: int) -> F64:
    """(n,) places of the cells of an axis whose middle is 0 [m]."""
    return np.asarray((np.arange(n) + 0.5 - n / 2) * TABLE_CELL_M)


def _render_parts(
    parts: Sequence[BodyPart], depression: float, u: F64, w: F64, turn_rad: float | None, lean_m: float
) -> tuple[F64, F64]:
    """Cover of rays by some parts, and the surface of the likeliest of them [m]."""
    entered = [enter_cylinders(depression, u, w, part.profile, turn_rad, lean_m) for part in parts]
    always_there = [enter for enter, part in zip(entered, parts, strict=True) if part.covers == 1.0]
    nearest = np.min(always_there, axis=0, initial=np.inf)
    cover, front, likeliest = np.zeros((3, *entered[0].shape))
    for enter, part in zip(entered, parts, strict=True):
        always = part.covers == 1.0
        blur = part.blur_m / TABLE_CELL_M
        shows = enter == nearest if always else np.isfinite(enter)
        hit = np.isfinite(enter) & shows
        inside = cv2.GaussianBlur(hit.astype(np.float64), (0, 0), blur)
        front_sum = cv2.GaussianBlur(np.where(hit, -enter, 0.0), (0, 0), blur)
        ahead = front_sum / np.maximum(inside, 1e-6)
        share = part.covers * inside
        sure = share + hit if always else share
        front = np.where(sure > likeliest, ahead, front)
        likeliest = np.maximum(likeliest, sure)
        cover = np.minimum(cover + share, 1.0) if always else np.maximum(cover, share)
    return cover, np.where(cover > 1e-3, front, 0.0)


def enter_cylinders(
    depression: float, u: F64, w: F64, profile: Profile, turn_rad: float | None = None, lean_m: float = 0.0
) -> F64:
    """Places where rays enter upright elliptic cylinders, from the point nearest to the body's centre on [m], or inf.

    Args:
        turn_rad: direction of facing relative to the level direction of the ray, counterclockwise; None for the mean
            over all of them.
        lean_m: of the head.
    """
    c = _nonzero(np.cos(depression))
    s = _nonzero(np.sin(depression))
    steep = np.sin(depression) ** 2
    ct = math.cos(turn_rad or 0.0)
    st = math.sin(turn_rad or 0.0)
    enter = np.full(np.broadcast_shapes(u.shape, w.shape), np.inf)
    for low_share, high_share, radius, ratio in profile:
        half = radius
        deep = ratio
        if turn_rad is None:  # From above it may face anywhere: a circle of the same area.
            half = radius * (1 - steep + steep * np.sqrt(ratio))
            deep = ratio ** (1 - steep)
        ahead = lean_m * lean_share(low_share)
        # ((q cos + u sin - lean) / depth)^2 + ((u cos - q sin) / breadth)^2 = 1 at q along the level ray (method, 5).
        per_depth = 1.0 / (half * deep) ** 2
        per_breadth = 1.0 / half**2
        a = ct * ct * per_depth + st * st * per_breadth
        b = ct * (u * st - ahead) * per_depth - st * ct * u * per_breadth
        inside = b * b - a * ((u * st - ahead) ** 2 * per_depth + (u * ct) ** 2 * per_breadth - 1.0)
        chord = np.sqrt(np.maximum(inside, 0.0)) / a
        middle = TORSO.height_m / 2 + w * c
        top = high_share * TORSO.height_m
        bottom = low_share * TORSO.height_m
        if s <= 0:  # the ray rises, and enters from below
            top, bottom = bottom, top
        first = np.maximum((-b / a - chord - w * s) / c, (middle - top) / s)
        last = np.minimum((-b / a + chord - w * s) / c, (middle - bottom) / s)
        enter = np.where((inside > 0) & (first < last) & (first < enter), first, enter)
    return enter


def _nonzero(value: float) -> float:
    """A cosine or sine by which can be divided."""
    return value if abs(value) > 1e-6 else 1e-6


def lean_share(height: float) -> float:
    """Share of the head's lean in that of a part that begins at a relative height: shoulders half."""
    return 0.5 * (height >= CHEST_FROM) + 0.5 * (height >= NECK_FROM)
