"""One person in one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

SURE_FACING = 0.9
"""Confidence from which a direction of facing is shown and scored as one: at most one in ten is back to front. Below,
only its axis is."""
State = Literal["tentative", "confirmed", "lost"]


@dataclass(frozen=True)
class TrackState:
    """One person in one frame: a row of ``tracks.csv``. NaN where a tracker does not measure it.

    Attributes:
        track_id: from 1 in the order in which people are confirmed, and negative while tentative; unique in a run.
        state: tentative (not yet confirmed), confirmed, or lost (predicted only).
        x_m, y_m: floor position of the head's vertical projection [m], world frame.
        vx_mps, vy_mps: velocity [m/s].
        height_m: height of the top of the head above the floor [m].
        box_px: (left, top, width, height) in the (rectified left) image [px].
        facing_deg: where the chest points on the floor, 0 along X and 90 along Y, -180 to 180 [deg].
        facing_confidence: how probably ``facing_deg`` is not back to front, 0.5 to 1.
        confidence: the probability that somebody is there.
        std_m: standard deviation of the place along each axis of the floor [m].
    """

    track_id: int
    state: State
    x_m: float = math.nan
    y_m: float = math.nan
    vx_mps: float = math.nan
    vy_mps: float = math.nan
    height_m: float = math.nan
    box_px: tuple[float, float, float, float] = (math.nan, math.nan, math.nan, math.nan)
    facing_deg: float = math.nan
    facing_confidence: float = math.nan
    confidence: float = math.nan
    std_m: float = math.nan

    def __repr__(self) -> str:
        place = f"x_m={self.x_m:.2f}, y_m={self.y_m:.2f}, height_m={self.height_m:.2f}"
        return f"TrackState({self.track_id}, {self.state}, {place})"
