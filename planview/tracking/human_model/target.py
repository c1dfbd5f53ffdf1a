"""One tracked person: footprint filter, motion state and stability state."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from calib.types import F32, F64
from planview.tracking.human_model.params import StateParams
from planview.tracking.human_model.seat import Seat

Motion = Literal["moving", "stopped", "stationary"]
Stability = Literal["appearing", "disappearing", "occlusion", "stable"]


class FootprintKalman:
    """Constant-velocity filter of the 3D footprint; the measurement's error differs by direction.

    Attributes:
        state: (4,) float64 x, y [m], vx, vy [m/s].
        covariance: (4, 4) float64.
    """

    def __init__(self, xy_m: F64, noise: F64, speed_std_mps: float = 1.5) -> None:
        """Args: xy_m (2,) first position; noise (2, 2) its covariance [m^2]."""
        self.state = np.array([xy_m[0], xy_m[1], 0.0, 0.0])
        self.covariance = np.zeros((4, 4))
        self.covariance[:2, :2] = noise
        self.covariance[2:, 2:] = speed_std_mps**2 * np.eye(2)

    def predict(self, dt_s: float, acceleration_mps2: float) -> None:
        """Advance by dt with a random acceleration that is constant over dt."""
        f = np.eye(4)
        f[0, 2] = f[1, 3] = dt_s
        g = np.array([dt_s**2 / 2, dt_s**2 / 2, dt_s, dt_s])
        q = np.zeros((4, 4))
        for axis in (0, 1):
            block = np.ix_((axis, axis + 2), (axis, axis + 2))
            q[block] = np.outer(g[axis::2], g[axis::2]) * acceleration_mps2**2
        self.state = f @ self.state
        self.covariance = f @ self.covariance @ f.T + q

    def update(self, xy_m: F64, noise: F64) -> None:
        """Correct with a measured (2,) position of (2, 2) covariance."""
        innovation = self.covariance[:2, :2] + noise
        gain = self.covariance[:, :2] @ np.linalg.inv(innovation)
        self.state = self.state + gain @ (xy_m - self.state[:2])
        self.covariance = self.covariance - gain @ self.covariance[:2, :]


@dataclass(slots=True, eq=False)
class Target:
    """A person (or a candidate for one) and what is remembered about it.

    Attributes:
        track_id: positive, never reused.
        kalman: footprint on the floor.
        born_s, seen_s: time of birth and of the last matching blob [s].
        scale: height over the average person's, standing.
        seat: where the person sits, None who stands or walks.
        left: the seat that the person seems to have got up from, until it is seen to be empty.
        confirmed: whether it is believed to be a person.
        matched: whether it had a blob in the last frame.
        matches: frames with a blob.
        foot_px: (2,) where the model stands in the image.
        motion, stability: the two automata.
        trail: recent (time, x, y, internal motion, visible fraction).
        inside: visible fraction of the model in the image.
        still_since_s, moving_since_s, covered_since_s: stationary, moving, covered by others:
            since when without a break, NaN if not now.
        shared: fraction of the model that other models cover too.
        born_xy, travel_m: where it was born and how far it has been from there.
        colours: (parts, bins) mean colour histogram, None before it was seen alone.
        half_width: observed half width over the model's.
        score: matching score M of the last frame.
        precision: foreground fraction of the model's own part in the last frame.
    """

    track_id: int
    kalman: FootprintKalman
    born_s: float
    seen_s: float
    born_xy: F64
    foot_px: F64
    scale: float = 1.0
    seat: Seat | None = None
    left: Seat | None = None
    confirmed: bool = False
    matched: bool = True
    matches: int = 1
    motion: Motion = "moving"
    stability: Stability = "appearing"
    trail: deque[tuple[float, float, float, float, float]] = field(default_factory=lambda: deque(maxlen=256))
    inside: float = 1.0
    still_since_s: float = np.nan
    moving_since_s: float = np.nan
    covered_since_s: float = np.nan
    shared: float = 0.0
    travel_m: float = 0.0
    colours: F32 | None = None
    half_width: float = 1.3
    score: float = 0.0
    precision: float = 1.0

    @property
    def drawn(self) -> float:
        """Scale of the model as it is drawn: seated people are lower."""
        return self.scale if self.seat is None else self.seat.scale

    def take_up(self, kalman: FootprintKalman, foot_px: F64, scale: float, now_s: float) -> None:
        """Go on at the place where this lost person was seen again."""
        self.kalman, self.foot_px, self.scale = kalman, foot_px, scale
        self.seen_s, self.matched, self.seat, self.left = now_s, True, None, None

    def swap_with(self, other: Target) -> None:
        """Exchange who the two are; places and motion stay."""
        for name in ("track_id", "colours", "scale", "half_width", "born_s", "born_xy", "travel_m", "confirmed"):
            mine = getattr(self, name)
            setattr(self, name, getattr(other, name))
            setattr(other, name, mine)

    def remember(self, now_s: float, internal: float, visible: float, window_s: float) -> None:
        """Add what this frame showed to the recent past."""
        x, y = self.kalman.state[:2]
        self.trail.append((now_s, float(x), float(y), internal, visible))
        while len(self.trail) > 2 and self.trail[1][0] <= now_s - window_s:
            self.trail.popleft()
        self.travel_m = max(self.travel_m, float(np.hypot(x - self.born_xy[0], y - self.born_xy[1])))

    def next_motion(self, params: StateParams) -> Motion:
        """Moving while the footprint moves; else stopped with internal motion, stationary without."""
        first, last = self.trail[0], self.trail[-1]
        dt = last[0] - first[0]
        if dt < 0.5 * params.window_s:
            return self.motion
        if np.hypot(last[1] - first[1], last[2] - first[2]) / dt >= params.moving_mps:
            return "moving"
        return "stopped" if max(row[3] for row in self.trail) >= params.internal_motion else "stationary"

    def next_stability(self, shared: float, params: StateParams) -> Stability:
        """Occlusion while models share pixels; else by the trend of the visible fraction."""
        if shared >= params.occlusion:
            return "occlusion"
        change = self.trail[-1][4] - float(np.mean([row[4] for row in self.trail]))
        if abs(change) < params.trend:
            return "stable"
        return "appearing" if change > 0 else "disappearing"

    def advance(self, now_s: float, covered: bool) -> None:
        """Start or stop the clocks of the motion state and of being covered."""
        self.covered_since_s = _clock(self.covered_since_s, covered, now_s)
        self.still_since_s = _clock(self.still_since_s, self.motion == "stationary", now_s)
        self.moving_since_s = _clock(self.moving_since_s, self.motion == "moving", now_s)


def _clock(since_s: float, running: bool, now_s: float) -> float:
    if not running:
        return np.nan
    return now_s if np.isnan(since_s) else since_s
