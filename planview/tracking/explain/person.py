"""One person: place, height, stance, identity, and how surely it exists."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import cv2
import numpy as np

from calib.types import F32, F64, I64, U8
from planview.maps.view import View
from planview.tracking import body
from planview.tracking.explain.clothes import Clothes, colour_ratios
from planview.tracking.explain.explanation import People
from planview.tracking.explain.facing import FacingDistribution, Gait, Stance
from planview.tracking.explain.samples import TINY, PosePrior
from planview.tracking.kalman import FloorKalman
from planview.tracking.odds import probability

BENT_SHARE = 0.7
"""Deviation of a head's place for each metre by which it was seen lower than upright, of people who bow (our choice:
rendered people)."""
GAIT_M = 0.03
"""A head bobs while walking [m]."""
HEIGHT_SEEN_STD_M = 0.08
"""Deviation of a height measured in one observation [m]."""
SHOWS_S = 1.0
"""A newcomer's colours and head have been seen after this time, or cannot be soon: of somebody next to others [s]. The
heads of 26 rendered walkers came into view within 0.8 s of their feet."""
BORN_LOG_ODDS = -3.9
"""Log-odds of a newcomer before its first observation: one in fifty."""
OUTLINE_PATCHES = 0.5
"""Narrower strips of new surface are noise of the outline [patches]."""
EVIDENCE_MAX = 6.0
"""Largest evidence of one observation for or against a person, as a log-odds."""


@dataclass(eq=False)
class Stature:
    """Height of a person when upright.

    Attributes:
        mean_m, var: estimate [m] and its variance.
    """

    mean_m: float = body.HEIGHT_MEAN_M
    var: float = body.HEIGHT_STD_M**2

    @property
    def std_m(self) -> float:
        """Deviation of the height of somebody upright in one frame [m]."""
        return math.hypot(math.sqrt(self.var), GAIT_M)

    def learn(self, height_m: float, fresh: float, low_share: float) -> None:
        """Learn from the present height, as far as the person is upright now."""
        std_m = self.std_m
        off_m = height_m - self.mean_m
        upright = (1 - low_share) * math.exp(-0.5 * (off_m / std_m) ** 2) / std_m
        lower = low_share * math.sqrt(2 * math.pi) / self.mean_m
        measured_var = HEIGHT_SEEN_STD_M**2 / max(fresh, 1e-3)
        gain = self.var / (self.var + measured_var) * upright / (upright + lower)
        self.mean_m += gain * off_m
        self.var *= 1 - gain


@dataclass(eq=False)
class Travel:
    """Movement of a track away from where it began.

    Attributes:
        origin_m: where it began.
        farthest_m: farthest from there [m].
        evidence: that it moves by itself, as the tracker counts it.
    """

    origin_m: tuple[float, float]
    farthest_m: float = 0.0
    evidence: float = 0.0

    def extend(self, at_m: tuple[float, float], std_m: float = 0.0) -> float:
        """Take in a place known to ``std_m``; return how much farther from the origin it surely is than before [m]."""
        farther_m = max(0.0, math.dist(self.origin_m, at_m) - std_m - self.farthest_m)
        self.farthest_m += farther_m
        return farther_m


@dataclass(eq=False)
class Identity:
    """Properties of a person that do not depend on where it stands.

    Attributes:
        track_id: negative until confirmed, then positive; unique in a run.
    """

    track_id: int
    walk: Travel
    stature: Stature = field(default_factory=Stature)
    clothes: Clothes = field(default_factory=Clothes)


class Sighting(NamedTuple):
    """When and where a person was seen, and how fast it was.

    Attributes:
        time_s: of the observation.
        kalman: place and speed then.
    """

    time_s: float
    kalman: FloorKalman


class Glimpse(NamedTuple):
    """A person as one frame shows it.

    Attributes:
        evidence: log-likelihood ratio of with to without the person, plus the logarithm of the prior of the pose.
        visible_share: of the body, of what shows something.
        shown_share: share of the body in view of which the frame shows something.
        inside_share: share of the body inside the image.
        patches: of the body in view.
        head_in_view: the top of the head is inside of an image.
        shared_std_m: deviation of the place by the errors that all pixels share [m].
    """

    evidence: float
    visible_share: float
    shown_share: float = 1.0
    inside_share: float = 1.0
    patches: float = 0.0
    head_in_view: bool = False
    shared_std_m: float = 0.0

    @staticmethod
    def of(
        evidence: float, patches: F64, inside_share: float, head_in_view: bool = True, shared_std_m: float = 0.0
    ) -> Glimpse:
        """Glimpse by the (3,) patches of ``Samples.visible_patches``."""
        own, shown, in_view = patches.tolist()
        uncut = min(1.0, 1.25 * inside_share)  # the border may cut off a fifth
        visible_share = own / max(shown, TINY) * uncut
        shown_share = shown / in_view if in_view else 1.0
        return Glimpse(evidence, visible_share, shown_share, inside_share, in_view, head_in_view, shared_std_m)


@dataclass(eq=False)
class Proof:
    """Independent evidence, while a newcomer is not confirmed, that it exists and is a person.

    Attributes:
        log_odds: of existence.
        shape: (K,) log-likelihood ratios of a person's shape to those of things, which keep theirs; (1,) 0 at first.
        height_patches: over which the head has been in view.
        upright_density: mean density of the heights there as those of anybody upright [1/m].
        spent: by the camera's place in the rig (H, W) uint8, 1 where a pixel has been evidence; empty before the first
            frame.
    """

    log_odds: float = BORN_LOG_ODDS
    shape: F64 = field(default_factory=lambda: np.zeros(1))
    height_patches: float = 0.0
    upright_density: float = 0.0
    spent: dict[int, U8] = field(default_factory=dict)

    def count(self, shown: Sequence[tuple[View, I64, F32]], glimpse: Glimpse) -> float:
        """Add the evidence of pixels that have not been evidence before; return the share of the body that is new.

        A wrong pixel that stays the same is one error, however often it is seen: an observation is as independent
        of those before it as the share of the body that is new. The first frame adds nothing to the existence, since
        the search for the person has spent it, and half of it is new to the shape, whose pose it has chosen.

        Args:
            shown: every view, (M,) the person's pixels in it and (M,) the patches that each of them is.
        """
        first = not self.spent
        new_patches = 0.0
        for camera, (view, pixels, patches) in enumerate(shown):
            if len(pixels) == 0:
                continue
            spent = self.spent.setdefault(camera, np.zeros(view.kind.shape, np.uint8))
            per_pixel = float(patches.mean())
            fresh: U8 = np.zeros_like(spent)
            fresh.reshape(-1)[pixels] = 1
            fresh[spent > 0] = 0
            side = max(1, round(OUTLINE_PATCHES / math.sqrt(per_pixel)))
            square = np.ones((side, side), np.uint8)
            solid = np.asarray(cv2.morphologyEx(fresh, cv2.MORPH_OPEN, square), np.uint8)
            new_patches += per_pixel * cv2.countNonZero(solid)
            spent |= fresh if first else solid  # the search has spent outlines too
        new_share = min(new_patches / max(glimpse.patches, 1.0), 1.0)
        if first:
            return body.FIRST_SHARE * new_share
        self.log_odds += new_share * max(glimpse.evidence, 0.0)
        return new_share

    def count_height(self, height_m: float, glimpse: Glimpse, low_share: float) -> None:
        """Add a height by how much of the body shows: a single frame may show somebody else behind a thing."""
        density = body.height_density(height_m, body.HEIGHT_MEAN_M, body.HEIGHT_STD_M, low_share)
        upright = density - low_share / body.HEIGHT_MEAN_M
        if height_m > body.HEIGHT_MEAN_M:
            upright += body.LOADED_PER_M
        patches = glimpse.visible_share * glimpse.shown_share * glimpse.patches
        self.height_patches += patches
        self.upright_density += (upright - self.upright_density) * patches / max(self.height_patches, TINY)


@dataclass(eq=False)
class Person:
    """A person who is followed.

    Attributes:
        identity: what belongs to the person and not to the place.
        kalman: place and speed on the floor.
        height_m, height_var: of the head's top now [m], and its variance.
        stance: where the chest points, and the lean.
        log_odds: of existence.
        first_seen, last_seen: first observation, and last one that measured the place.
        glimpse: what the last frame shows of the person.
        proof: independent evidence while not confirmed.
        confirmed: has been reported, and is until the end.
        unseen_s: for how long the person has been looked for in vain [s].
        blind_s: for how long images have shown nothing since the first observation, or have lost their colours [s].
    """

    identity: Identity
    kalman: FloorKalman
    height_m: float
    height_var: float
    stance: Stance
    log_odds: float
    first_seen: Sighting
    last_seen: Sighting
    glimpse: Glimpse
    proof: Proof = field(default_factory=Proof)
    confirmed: bool = False
    unseen_s: float = 0.0
    blind_s: float = 0.0

    @classmethod
    def newcomer(cls, pose: F64, noise: F64, height_information: float, glimpse: Glimpse, now_s: float) -> Self:
        """Somebody without an id at a pose, with what was measured there (``Samples.precision``)."""
        kalman = FloorKalman.from_measurement(pose[:2], noise)
        seen = Sighting(now_s, kalman)
        identity = Identity(0, Travel(kalman.at_m))
        height_m, facing_rad, lean_m = pose[2:].tolist()
        height_var = 1.0 / (1.0 / body.HEIGHT_STD_M**2 + height_information)
        stance = Stance(facing_rad, lean_m)
        log_odds = BORN_LOG_ODDS + 0.25 * min(glimpse.evidence, EVIDENCE_MAX)
        return cls(identity, kalman, height_m, height_var, stance, log_odds, seen, seen, glimpse)

    @property
    def track_id(self) -> int:
        """Negative until confirmed, then positive; unique in a run."""
        return self.identity.track_id

    @track_id.setter
    def track_id(self, track_id: int) -> None:
        self.identity.track_id = track_id

    @property
    def at_m(self) -> tuple[float, float]:
        """Place on the floor."""
        return self.kalman.at_m

    @property
    def pose(self) -> F64:
        """(5,) float64 x, y, height [m], facing [rad], lean [m]."""
        return np.array([*self.at_m, self.height_m, self.stance.facing_rad, self.stance.lean_m])

    @property
    def head_m(self) -> tuple[float, float]:
        """Place below the head."""
        x_m, y_m = self.at_m
        facing_rad = self.stance.facing_rad
        lean_m = self.stance.lean_m
        return x_m + lean_m * math.cos(facing_rad), y_m + lean_m * math.sin(facing_rad)

    @property
    def head_std_m(self) -> float:
        """Deviation of the place below the head along each axis of the floor [m]: of the filter, of what all pixels
        have in common, and of how a body stands."""
        lower_m = max(self.identity.stature.mean_m - self.height_m, 0.0)
        leant_m = body.LEAN_ERROR * self.stance.lean_m
        place_std_m = math.sqrt(0.5 * np.trace(self.kalman.covariance[:2, :2]))
        return math.hypot(place_std_m, self.glimpse.shared_std_m, BENT_SHARE * lower_m, leant_m)

    @property
    def pose_prior(self) -> PosePrior:
        """Precision of the predicted pose before a frame."""
        gait = Gait.of(self.kalman)
        return PosePrior(
            *self.kalman.information,
            height=1.0 / self.height_var,
            facing=1.0 / self.stance.facing_var,
            back=self.stance.backward,
            walk=gait.concentration,
            heading=gait.heading_rad,
        )

    @property
    def existence(self) -> float:
        """Probability that the person is there."""
        return probability(self.log_odds)

    @property
    def seniority(self) -> tuple[bool, float, int]:
        """Larger for whoever exists more surely; of two equally sure ones, for whoever came first."""
        return self.confirmed, self.log_odds, -abs(self.track_id)

    def take_pose(self, pose: F64) -> None:
        """Jump to another place and posture (5,), speed and deviations unchanged."""
        x_m, y_m, self.height_m, self.stance.facing_rad, self.stance.lean_m = pose.tolist()
        self.kalman = self.kalman.move_to(x_m, y_m)

    def measure_height(self, height_m: float, information: float) -> None:
        """Take over the height of the pose that explains best; ``information`` on it [1/m^2]."""
        self.height_m = height_m
        self.height_var = 1.0 / (1.0 / self.height_var + information)

    def assume_upright(self) -> None:
        """Take the height when upright for the present one, which does not show without the head."""
        stature = self.identity.stature
        self.height_m = stature.mean_m
        self.height_var = stature.std_m**2

    def will_show_more(self, now_s: float, coloured: bool) -> bool:
        """True while the head or, where images are ``coloured``, the clothes will soon show who this is, or while more
        than half of the body and the head are outside."""
        soon = now_s - self.first_seen.time_s - self.blind_s < SHOWS_S
        head_hidden = not self.glimpse.head_in_view
        if soon and head_hidden:
            return True
        cut_off = head_hidden and self.glimpse.inside_share < 0.5
        return not self.identity.clothes.distinguish and (cut_off or (soon and coloured))

    def swap_identity(self, other: Person) -> None:
        """Exchange identities with another person: both stay where they are."""
        own = self.identity
        self.identity = other.identity
        other.identity = own


RECORDS = Person, Identity, Travel, Stature, Clothes, Sighting, Glimpse, Proof, Stance, FacingDistribution, FloorKalman
"""Types of a person's state, for checkpoints."""


def side_by_side(people: Sequence[Person], ratios: F32 | None = None) -> People:
    """Arrays of these people; ``ratios`` of their colours if they are computed already."""
    if ratios is None:
        ratios = colour_ratios([person.identity.clothes for person in people])
    poses = np.array([person.pose for person in people]).reshape(-1, 5)
    statures = [person.identity.stature for person in people]
    heights = np.array([(stature.mean_m, stature.std_m) for stature in statures]).reshape(-1, 2)
    existence = np.array([person.existence for person in people])
    return People(poses, existence, heights, ratios)
