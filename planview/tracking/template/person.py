"""One person: where, how tall, how surely there, and in what clothes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from calib.types import F32, F64
from planview.maps.colour import CODES, smoothing
from planview.tracking.body import HEIGHT_MEAN_M, HEIGHT_STD_M
from planview.tracking.kalman import FloorKalman
from planview.tracking.template._kernels import PARTS

SMOOTHING = smoothing()
GAIT_M = 0.03
"""A head bobs while walking [m]."""
LOOK_STD_M = 0.08
"""Deviation of a height measured in one look [m]."""
PRIOR_LOOKS = 2.0
"""Weight of a common person's colours beside those seen [frames]."""


@dataclass(eq=False)
class Person:
    """A person followed.

    Attributes:
        track_id: positive, unique in a run.
        kalman: place and speed on the floor.
        height_m: of the head's top now.
        height_var: variance of ``height_m`` [m^2].
        tall_m, tall_var: of the head's top when upright, and its variance.
        log_odds: of existence.
        born_s, seen_s: time of birth and of the last look that measured the place.
        origin_m: where the track began.
        walked_m: farthest from there [m].
        moved: log-odds of a person against a thing from moving by itself.
        colours: (PARTS, CODES) float32, sums of normalised histograms of legs, torso and head.
        looks: frames in which colours were learned.
        confirmed: has been reported, and is until the end.
        evidence: LLR of the last frame.
        share: visible share of the body in the last frame.
        patches: patches of the body seen in the last frame.
        inside: share of the body inside the image.
    """

    track_id: int
    kalman: FloorKalman
    height_m: float
    log_odds: float
    born_s: float
    seen_s: float
    tall_m: float = HEIGHT_MEAN_M
    tall_var: float = HEIGHT_STD_M**2
    height_var: float = 0.03
    origin_m: tuple[float, float] = (0.0, 0.0)
    walked_m: float = 0.0
    moved: float = 0.0
    colours: F32 = field(default_factory=lambda: np.zeros((PARTS, CODES), np.float32))
    looks: float = 0.0
    confirmed: bool = False
    evidence: float = 0.0
    share: float = 1.0
    patches: float = 0.0
    inside: float = 1.0
    hidden_by: int = 0

    @property
    def at_m(self) -> tuple[float, float]:
        return self.kalman.x_m, self.kalman.y_m

    @property
    def upright(self) -> tuple[float, float]:
        """Height when upright and its deviation in one frame [m]: gait moves a head by 3 cm."""
        return self.tall_m, math.sqrt(self.tall_var + GAIT_M**2)

    def learn_height(self, looks: float, low_share: float) -> None:
        """The present height tells the one when upright, as far as the person is upright now."""
        _, std = self.upright
        off = self.height_m - self.tall_m
        upright = (1 - low_share) * math.exp(-0.5 * (off / std) ** 2) / std
        lower = low_share * math.sqrt(2 * math.pi) / self.tall_m
        gain = self.tall_var / (self.tall_var + LOOK_STD_M**2 / max(looks, 1e-3)) * upright / (upright + lower)
        self.tall_m += gain * off
        self.tall_var *= 1 - gain
        self.tall_var += 1e-6

    @property
    def existence(self) -> float:
        """Probability that the person is there."""
        return 1.0 / (1.0 + math.exp(-self.log_odds))

    def density(self) -> F32:
        """(PARTS, CODES) float32 distribution of the colours, smoothed; uniform where nothing was seen."""
        mass = self.colours @ SMOOTHING + PRIOR_LOOKS / CODES
        return np.asarray(mass / mass.sum(axis=1, keepdims=True), dtype=np.float32)


def colour_ratios(people: list[Person]) -> F32:
    """(N, PARTS, CODES) float32: colours of each person over those of all."""
    if not people:
        return np.ones((1, PARTS, CODES), np.float32)
    densities = np.stack([p.density() for p in people])
    common = 0.5 * densities.mean(axis=0) + 0.5 / CODES
    return np.clip(densities / common, 0.05, 20.0).astype(np.float32)


def learn_colours(person: Person, parts: F64, codes: np.ndarray) -> None:
    """Add the colours of a frame's pixels that the person surely owns; ``parts`` are their relative heights."""
    seen = False
    for part, (low, high) in enumerate(((0.0, 0.45), (0.45, 0.85), (0.85, 2.0))):
        chosen = codes[(parts >= low) & (parts < high)]
        if len(chosen) > 5:
            counts = np.bincount(chosen, minlength=CODES)[:CODES].astype(np.float32)
            person.colours[part] += counts / counts.sum()
            seen = True
    person.looks += seen
