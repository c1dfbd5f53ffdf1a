"""One person: where, how tall, how surely there, in what clothes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import cv2
import numpy as np

from calib.types import F32, F64, I64, U8
from planview.maps.view import CODES, View, smoothing
from planview.tracking import body
from planview.tracking.body import HEIGHT_MEAN_M, HEIGHT_STD_M, LEAN_STD_M
from planview.tracking.explain.explanation import People
from planview.tracking.explain.facing import FacingBelief
from planview.tracking.explain.samples import LEGS_TO, PARTS, TINY, TORSO_TO, Known
from planview.tracking.kalman import FloorKalman

SMOOTHING = smoothing()
ANY_FACING = math.pi**2 / 3.0
"""Variance of a direction of which nothing is known [rad^2]."""
FACING_STD_MAX_RAD = 1.0
"""Facing is reported when the deviation of its axis is better [rad]."""
LEANING_M2_PS = 0.02
"""Variance of the change of a lean within a second [m^2/s]."""
SHAPE_STD_M = 0.015
"""Deviation of a place along each axis because a body is thicker or thinner than its table [m]: 2 cm along the ray."""
BENT_SHARE = 0.7
"""Deviation of a head's place for each metre by which it was found lower than upright or before the feet: how bent
bodies stand, and surfaces that look like a lean (our choice: rendered people)."""
GAIT_M = 0.03
"""A head bobs while walking [m]."""
HEIGHT_SEEN_STD_M = 0.08
"""Deviation of a height measured in one observation [m]."""
PRIOR_FRAMES = 2.0
"""Weight of anybody's colours next to those seen [frames]."""
COLOURED_FRAMES_MIN = 5
"""Frames from which on colours distinguish people."""
SHOWS_S = 1.0
"""A newcomer's colours and head have been seen after this time, or cannot be soon: of somebody next to others [s]. The
heads of 26 rendered walkers came into view within 0.8 s of their feet."""
RATIO_MAX = 20.0
"""Largest ratio of a person's colours to anybody's."""
BORN_LOG_ODDS = -3.9
"""Of a newcomer before its first observation: one in fifty."""
OUTLINE_PATCHES = 0.5
"""Narrower strips of new surface are the outline's noise [patches]."""


@dataclass(eq=False)
class Person:
    """A person followed.

    Attributes:
        track_id: negative until confirmed, then positive; unique in a run.
        kalman: place and speed on the floor.
        height_m, height_var: of the head's top now [m], and its variance.
        facing, facing_var: where the chest of the pose that explains best points, counterclockwise from x [rad], and
            the variance within which the next pose is searched.
        facings: how probably the chest points to each side.
        lean_m, lean_var: head before the feet [m], and its variance.
        log_odds: of existence.
        seen_s: time of the last observation that measured the place.
        seen: place and speed then.
        tall_m, tall_var: height when upright [m], and its variance.
        born_s, born_m: when and where it was seen first.
        blind_s: for how long since then images have shown nothing, or have lost their colours [s].
        origin_m: where the track began.
        walked_m: farthest from there [m].
        moved: log-odds of a person against a thing from moving by itself.
        shape: log-likelihood ratio of a person's shape to a thing's in the last frame.
        likeness: the same from independent evidence, see ``count_evidence``.
        colours: (PARTS, CODES) float32, sums of normalised histograms of legs, torso and head.
        densities: (PARTS, CODES) float32 of colours, neighbours and anybody's prior taken in.
        coloured_frames: in which colours were learned.
        confirmed: has been reported, and is until the end.
        evidence: of the last frame: log-likelihood ratio of with to without the person, plus the prior of the pose.
        shared_m: deviation of the place by the error of disparity that all pixels share [m].
        share: visible share of the body in the last frame, of what shows something.
        known: share of the body in view of which the last frame shows something.
        unseen_s: for how long it has been looked for in vain [s].
        inside: share of the body inside the image.
        patches: of the body in view in the last frame.
        head_in_view: whether the top of the head was inside of an image in the last frame.
        height_patches: over which the head has been in view while unconfirmed.
        upright_density: mean density of the heights there as those of anybody upright [1/m].
        proven: log-odds of existence from independent evidence, see ``count_evidence``.
        counted: by the camera's place in the rig (H, W) uint8, 1 where a pixel has been evidence; empty before the
            first frame, and when confirmed.
    """

    track_id: int
    kalman: FloorKalman
    height_m: float
    log_odds: float
    seen_s: float
    seen: FloorKalman
    height_var: float = HEIGHT_STD_M**2
    facing: float = 0.0
    facing_var: float = ANY_FACING
    facings: FacingBelief = field(default_factory=FacingBelief.unknown)
    lean_m: float = 0.0
    lean_var: float = LEAN_STD_M**2
    tall_m: float = HEIGHT_MEAN_M
    tall_var: float = HEIGHT_STD_M**2
    born_s: float = 0.0
    born_m: tuple[float, float] = (0.0, 0.0)
    blind_s: float = 0.0
    origin_m: tuple[float, float] = (0.0, 0.0)
    walked_m: float = 0.0
    moved: float = 0.0
    shape: float = 0.0
    likeness: float = 0.0
    colours: F32 = field(default_factory=lambda: np.zeros((PARTS, CODES), np.float32))
    densities: F32 = field(default_factory=lambda: np.full((PARTS, CODES), 1 / CODES, np.float32))
    coloured_frames: int = 0
    confirmed: bool = False
    evidence: float = 0.0
    shared_m: float = 0.0
    share: float = 1.0
    known: float = 1.0
    unseen_s: float = 0.0
    inside: float = 1.0
    patches: float = 0.0
    head_in_view: bool = False
    height_patches: float = 0.0
    upright_density: float = 0.0
    proven: float = BORN_LOG_ODDS
    counted: dict[int, U8] = field(default_factory=dict)

    @classmethod
    def born(cls, pose: F64, noise: F64, up: float, log_odds: float, now_s: float) -> Self:
        """A newcomer without id at a pose, with what was measured there (``Samples.noise``)."""
        kalman = FloorKalman.measured(pose[:2], noise)
        at_m = kalman.x_m, kalman.y_m
        height_var = 1.0 / (1.0 / HEIGHT_STD_M**2 + up)
        facing, lean_m = pose[3:].tolist()
        return cls(
            0, kalman, float(pose[2]), log_odds, now_s, kalman, height_var, facing, lean_m=lean_m, born_s=now_s,
            born_m=at_m, origin_m=at_m,
        )  # fmt: skip

    @property
    def at_m(self) -> tuple[float, float]:
        """Place on the floor."""
        return self.kalman.x_m, self.kalman.y_m

    @property
    def pose(self) -> F64:
        """(5,) float64 x, y, height [m], facing [rad], lean [m]."""
        return np.array([*self.at_m, self.height_m, self.facing, self.lean_m])

    @property
    def head_m(self) -> tuple[float, float]:
        """Place below the head."""
        x_m, y_m = self.at_m
        return x_m + self.lean_m * math.cos(self.facing), y_m + self.lean_m * math.sin(self.facing)

    @property
    def head_std_m(self) -> float:
        """Deviation of the place below the head along each axis of the floor [m]: of the filter, of what all pixels
        have in common, and of how a body is shaped and stands."""
        bent_m = BENT_SHARE * (max(self.tall_m - self.height_m, 0.0) + self.lean_m)
        place_var = 0.5 * float(np.trace(self.kalman.covariance[:2, :2]))
        return math.sqrt(place_var + self.shared_m**2 + SHAPE_STD_M**2 + bent_m**2)

    @property
    def still(self) -> float:
        """How surely the person stands or strolls, whatever the facing, rather than walks ahead: 0 to below 1."""
        k = self.kalman
        spread = body.STROLL_MPS**2 + float(k.covariance[2, 2] + k.covariance[3, 3])
        return spread / (spread + max(k.vx_mps**2 + k.vy_mps**2, 1e-6))

    @property
    def prior(self) -> Known:
        """What is known of the pose before a frame."""
        k, back, still = self.kalman, 1.0 - self.facings.near(self.facing)[1], self.still
        walk = 1.0 / (body.SIDEWARD_RAD**2 + still / (1.0 - still))
        heading = math.atan2(k.vy_mps, k.vx_mps)
        return Known(*k.information, 1.0 / self.height_var, 1.0 / self.facing_var, back, walk, heading)

    @property
    def faces(self) -> tuple[float, float]:
        """Where the chest points, -180 to 180 [deg], and how probably this is not back to front; NaN while the axis is
        not known."""
        if self.facings.axis_var >= FACING_STD_MAX_RAD**2:
            return math.nan, math.nan
        facing, probability = self.facings.best
        return math.degrees(facing), probability

    def predict_facing(self, dt: float) -> None:
        """Where a person faces and leans is known less surely after dt [s]."""
        self.facings = self.facings.predicted(dt, self.still)
        self.facing_var = min(self.facing_var + body.TURNING_RAD2_PS * dt, ANY_FACING)
        self.lean_var = min(self.lean_var + LEANING_M2_PS * dt, LEAN_STD_M**2)

    def measure_facing(self, pose: F64, log_ratios: F64, curvature: F64, fresh: float) -> None:
        """Take over how a pose faces and leans.

        Args:
            log_ratios: (FACINGS / 2,) of the body there by its facing.
            curvature: (2,) of the log-likelihood ratio in the facing and in the lean.
            fresh: the independent share of this frame.
        """
        if not log_ratios.any():  # seen so that a body looks the same from everywhere
            return
        prior, before = self.prior, self.facing
        self.facings = self.facings.seen(log_ratios, fresh, prior.walk, prior.heading)
        self.facing = math.remainder(float(pose[3]), 2.0 * math.pi)
        self.facing_var = 1.0 / (1.0 / self.facing_var + fresh * (max(float(curvature[0]), 0.0) + prior.walk))
        gain = 1.0 - 1.0 / (1.0 + fresh * max(float(curvature[1]), 0.0) * self.lean_var)
        lean_m = self.lean_m * math.cos(self.facing - before)
        self.lean_m, self.lean_var = max(lean_m + gain * (float(pose[4]) - lean_m), 0.0), self.lean_var * (1.0 - gain)

    def see(self, visible: F64, inside: float) -> None:
        """Take over the patches of a frame (``Samples.visible``), and the share of the body inside the image."""
        mine, known, self.patches = visible.tolist()
        self.inside, self.known = inside, known / self.patches if self.patches else 1.0
        self.share = mine / max(known, TINY) * min(1.0, 1.25 * inside)  # the border may cut off a fifth

    @property
    def existence(self) -> float:
        """Probability that the person is there."""
        return 1.0 / (1.0 + math.exp(-self.log_odds))

    @property
    def upright(self) -> tuple[float, float]:
        """Height when upright and its deviation in one frame [m]."""
        return self.tall_m, math.hypot(math.sqrt(self.tall_var), GAIT_M)

    def shows_more_after(self, now_s: float, coloured: bool) -> bool:
        """Whether more will show of somebody who it is: the head or, where images are ``coloured``, the colours soon,
        or more than half of the body or the head."""
        soon = now_s - self.born_s - self.blind_s < SHOWS_S
        cut_off = not self.head_in_view and self.inside < 0.5
        colours = self.coloured_frames < COLOURED_FRAMES_MIN and (cut_off or (soon and coloured))
        return colours or (soon and not self.head_in_view)

    @property
    def standing(self) -> tuple[bool, float, int]:
        """Larger for who is more surely there; of two equally sure ones, for who came first."""
        return self.confirmed, self.log_odds, -abs(self.track_id)

    def count_evidence(self, owned: Sequence[tuple[View, I64, F32]]) -> None:
        """Add the evidence of pixels that have not been evidence before.

        A wrong pixel that stays the same is one error, however often it is seen: an observation is as independent
        of those before it as the share of the body that is new. The first one found the person: the search spent it.

        Args:
            owned: every view, (M,) the person's pixels in each and (M,) the patches that each is.
        """
        first, new_patches = not self.counted, 0.0
        for camera, (view, pixels, patches) in enumerate(owned):
            if len(pixels) == 0:
                continue
            counted = self.counted.setdefault(camera, np.zeros(view.kind.shape, np.uint8))
            per_pixel = float(patches.mean())
            fresh: U8 = np.zeros_like(counted)
            fresh.reshape(-1)[pixels] = 1
            fresh[counted > 0] = 0
            if not first:
                side = max(1, round(OUTLINE_PATCHES / math.sqrt(per_pixel)))
                fresh = np.asarray(cv2.morphologyEx(fresh, cv2.MORPH_OPEN, np.ones((side, side), np.uint8)), np.uint8)
                new_patches += per_pixel * cv2.countNonZero(fresh)
            counted |= fresh
        share_new = min(new_patches / max(self.patches, 1.0), 1.0)
        self.proven += share_new * max(self.evidence, 0.0)
        self.likeness += share_new * self.shape

    def count_height(self, low_share: float) -> None:
        """Add the height to those that tell a person from a thing, by how much shows: one frame's may be of somebody
        else who shows behind a thing."""
        upright = body.stature(self.height_m, HEIGHT_MEAN_M, HEIGHT_STD_M, low_share) - low_share / HEIGHT_MEAN_M
        patches = self.share * self.known * self.patches
        self.height_patches += patches
        self.upright_density += (upright - self.upright_density) * patches / max(self.height_patches, TINY)

    def learn_height(self, fresh: float, low_share: float) -> None:
        """Learn the height when upright from the present height, as far as the person is upright now."""
        _, std = self.upright
        off = self.height_m - self.tall_m
        upright = (1 - low_share) * math.exp(-0.5 * (off / std) ** 2) / std
        lower = low_share * math.sqrt(2 * math.pi) / self.tall_m
        gain = self.tall_var / (self.tall_var + HEIGHT_SEEN_STD_M**2 / max(fresh, 1e-3)) * upright / (upright + lower)
        self.tall_m += gain * off
        self.tall_var *= 1 - gain

    def learn_colours(self, counts: F32) -> None:
        """Add the (PARTS, CODES) colours of a frame's pixels that the person surely owns."""
        pixels = counts.sum(axis=1, keepdims=True)
        seen = pixels[:, 0] > 5
        self.colours[seen] += counts[seen] / pixels[seen]
        self.coloured_frames += bool(seen.any())
        mass = self.colours @ SMOOTHING + PRIOR_FRAMES / CODES
        self.densities = mass / mass.sum(axis=1, keepdims=True)

    def take_identity(self, other: Person) -> None:
        """Exchange with another person everything that belongs to the identity and not to the place."""
        colours = "colours", "densities", "coloured_frames"
        for name in ("track_id", *colours, "tall_m", "tall_var", "origin_m", "walked_m", "moved"):
            mine = getattr(self, name)
            setattr(self, name, getattr(other, name))
            setattr(other, name, mine)


def colour_counts(n: int, owner: I64, heights: F64 | F32, codes: U8) -> F32:
    """(n, PARTS, CODES) float32: pixels by owner, part of the body and colour; ``heights`` are relative."""
    part = (heights >= LEGS_TO).astype(np.int64) + (heights >= TORSO_TO)
    counts = np.bincount((owner * PARTS + part) * CODES + codes, minlength=n * PARTS * CODES)
    return counts.reshape(n, PARTS, CODES).astype(np.float32)


def colour_ratios(people: Sequence[Person]) -> F32:
    """(N, PARTS, CODES) float32: colours of each person over those of anybody."""
    if not people:
        return np.ones((0, PARTS, CODES), np.float32)
    densities = np.stack([q.densities for q in people])
    anybody = 0.5 * densities.mean(axis=0) + 0.5 / CODES
    return np.asarray(np.clip(densities / anybody, 1 / RATIO_MAX, RATIO_MAX), dtype=np.float32)


def side_by_side(people: Sequence[Person], ratios: F32 | None = None) -> People:
    """The arrays of these people; ``ratios`` of their colours where they are known already."""
    poses = np.array([q.pose for q in people]).reshape(-1, 5)
    tall = np.array([q.upright for q in people]).reshape(-1, 2)
    return People(
        poses, np.array([q.existence for q in people]), tall, colour_ratios(people) if ratios is None else ratios
    )
