"""One tracked person: footprint filter, motion state and stability state."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from calib.types import F64
from planview.tracking.human_model.params import ExistenceParams, StabilityParams
from planview.tracking.human_model.seat import Seat
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import Existence

Motion = Literal["moving", "stopped", "stationary"]
Stability = Literal["appearing", "disappearing", "occlusion", "stable"]
SPEED_STD_MPS = 1.5
"""Standard deviation of a new target's velocity [m/s]: a brisk walk (our choice)."""
HEAD_M = 0.3
"""Standard deviation of a place told by the head [m]. Our choice: 3 % of the height, the bob of a step, is so much on
the floor where the camera hangs 1.3 m above the head 7 m away."""
WALKED_SIGMAS = 1.5
"""Deviations of the measured place from which on a target has walked (our choice): one in three errors is larger, and
with twice as much people who walk towards the camera are confirmed late."""
FIRST_WIDTH = 1.3
"""Width of a silhouette over the model's before it is measured: arms and stride (our choice)."""


class Sample(NamedTuple):
    """One frame in a target's recent past: time [s], floor position [m], moving and visible fractions of the model."""

    time_s: float
    x_m: float
    y_m: float
    moving: float
    visible: float


@dataclass(slots=True, eq=False)
class Build:
    """What stays with a person when identities are exchanged.

    Attributes:
        scale: standing height over the average person's.
        width: observed width over the model's.
        origin_m: (2,) where the target was spawned.
        travel_m: how far it has been from there.
        measured_s: for how long the height has been measured on a whole body [s].
    """

    scale: float
    origin_m: F64
    width: float = FIRST_WIDTH
    travel_m: float = 0.0
    measured_s: float = 0.0


@dataclass(slots=True, eq=False)
class Target:
    """A person (or a tentative one) and what is remembered about it.

    Attributes:
        existence: id, state and times.
        kalman: footprint on the floor.
        build: height, width and origin.
        foot_px: (2,) where the model stands in the image.
        seat: where the person sits, None for a person who stands or walks.
        places: time [s] and floor position [m] of the last frames as the head of a standing person tells it.
        left_seat: the seat that the person seems to have got up from, until it is found empty.
        motion, stability: the two automata.
        trail: the recent past, oldest first.
        inside: visible fraction of the model in the image.
        seen_m: (2,) footprint when the person was last observed [m].
        splits: it was found beside another target in one blob.
        still_since_s: since when it has been stationary without a break, NaN if it is not.
        shared: fraction of the model that other models cover too.
        depth_known: whether an end of the body tells how far from the camera the person is.
        hidden: whether too little of it is left for foreground of its own to be asked for.
        matches: frames with a blob.
        whole: whether it has been observed as a whole person, with few gaps.
        outdone_since_s: since when sitters would account for more than this standing model, NaN if they do not [s].
        support_s: evidence of existence: for so long the person is still believed in without any [s].
        score: matching score M of the last frame.
        precision: foreground fraction of the model's own part in the last frame.
    """

    existence: Existence
    kalman: FloorKalman
    build: Build
    foot_px: F64
    places: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=256))
    seat: Seat | None = None
    left_seat: Seat | None = None
    motion: Motion = "moving"
    stability: Stability = "appearing"
    trail: deque[Sample] = field(default_factory=lambda: deque(maxlen=256))
    inside: float = 1.0
    seen_m: F64 = field(init=False)
    splits: bool = False
    still_since_s: float = math.nan
    shared: float = 0.0
    hidden: bool = False
    depth_known: bool = True
    matches: int = 1
    support_s: float = 0.0
    score: float = 0.0
    precision: float = 1.0
    whole: bool = True
    outdone_since_s: float = math.nan

    def __post_init__(self) -> None:
        self.seen_m = self.xy_m

    @property
    def model_scale(self) -> float:
        """Height of the model over the average person's: seated people are lower."""
        return self.build.scale if self.seat is None else self.seat.scale

    @property
    def xy_m(self) -> F64:
        """(2,) footprint."""
        return np.array([self.kalman.x_m, self.kalman.y_m])

    def restart(self, kalman: FloorKalman, foot_px: F64, scale: float) -> None:
        """Go on at the place where this lost person is reacquired."""
        self.kalman, self.foot_px, self.build.scale = kalman, foot_px, scale
        self.seat = self.left_seat = None

    def go_on_as(self, other: Target) -> None:
        """Go on where this lost person was observed as another target."""
        self.restart(other.kalman, other.foot_px, other.build.scale)
        self.trail, self.motion, self.inside, self.support_s = other.trail, other.motion, other.inside, other.support_s

    def measure(self, now_s: float, x_m: float, y_m: float, window_s: float) -> None:
        """Add a measured place, and forget those older than two windows."""
        self.places.append((now_s, x_m, y_m))
        while self.places[0][0] < now_s - 2.0 * window_s - 1e-6:
            self.places.popleft()

    def way(self, now_s: float, window_s: float) -> tuple[F64, F64, float] | None:
        """(2,) place a window ago [m], (2,) velocity before that [m/s] and the variance of places about it [m^2].

        None where too few places are known.
        """
        rows = np.array([row for row in self.places if row[0] <= now_s - window_s + 1e-6])
        if len(rows) < 4 or rows[-1, 0] - rows[0, 0] < 0.5 * window_s:
            return None
        middle, t = rows.mean(axis=0), rows[:, 0] - rows[:, 0].mean()
        velocity = t @ (rows[:, 1:] - middle[1:]) / (t @ t + (HEAD_M / SPEED_STD_MPS) ** 2)
        rest = rows[:, 1:] - middle[1:] - t[:, None] * velocity
        velocity *= min(1.0, SPEED_STD_MPS / max(float(np.hypot(*velocity)), 1e-9))
        return middle[1:] + (now_s - window_s - middle[0]) * velocity, velocity, float((rest**2).sum(axis=1).mean())

    def remember(self, now_s: float, moving: float, visible: float, window_s: float) -> None:
        """Add what this frame showed to the recent past."""
        self.trail.append(Sample(now_s, self.kalman.x_m, self.kalman.y_m, moving, visible))
        while len(self.trail) > 2 and self.trail[1].time_s <= now_s - window_s:
            self.trail.popleft()
        if self.existence.observed:
            self.seen_m = self.xy_m
            self._travel()

    def _travel(self) -> None:
        """How far it has been, unless that may be an error of measurement: far away a pixel is metres."""
        k = self.kalman
        x, y = k.x_m - float(self.build.origin_m[0]), k.y_m - float(self.build.origin_m[1])
        way_m = math.hypot(x, y)
        # The squared distance in deviations, times the determinant of their matrix.
        off, determinant = k.c_yy * x * x - 2.0 * k.c_xy * x * y + k.c_xx * y * y, k.c_xx * k.c_yy - k.c_xy**2
        if way_m > self.build.travel_m and off >= WALKED_SIGMAS**2 * determinant:
            self.build.travel_m = way_m

    def weigh(self, dt_s: float, hidden: bool, params: ExistenceParams) -> None:
        """Weigh what the last ``dt_s`` showed for the person's existence: own foreground, none, or nothing either way.

        A person whom others hide cannot show any; one who is partly outside the image may show little.
        """
        if hidden:
            return
        if self.existence.observed:
            self.support_s = min(params.patience_s, self.support_s + params.trust * dt_s)
        else:
            self.support_s -= dt_s / max(self.inside, 1e-3)

    @property
    def moving_fraction(self) -> float:
        """Largest moving fraction of the model in the recent past."""
        return max(sample.moving for sample in self.trail)

    def next_motion(self, params: StabilityParams) -> Motion:
        """Moving while the footprint moves; else stopped with internal motion, stationary without."""
        first, last = self.trail[0], self.trail[-1]
        dt = last.time_s - first.time_s
        if dt < 0.5 * params.window_s:
            return self.motion
        if math.hypot(last.x_m - first.x_m, last.y_m - first.y_m) / dt >= params.moving_mps:
            return "moving"
        return "stopped" if self.moving_fraction >= params.internal_motion else "stationary"

    def next_stability(self, params: StabilityParams) -> Stability:
        """Occlusion while models share pixels; else by the trend of the visible fraction."""
        if self.shared >= params.occlusion:
            return "occlusion"
        change = self.trail[-1].visible - sum(sample.visible for sample in self.trail) / len(self.trail)
        if abs(change) < params.trend:
            return "stable"
        return "appearing" if change > 0 else "disappearing"
