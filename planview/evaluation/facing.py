"""How well the directions fit in which people face."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.types import F64
from planview.trajectories.table import Trajectories, rows_by_id

WALKING_MPS = 0.5
"""Who is faster walks, and who is slower stands, by the truth [m/s]. Shuffling on the spot is slower."""
STEP_S = 0.25
"""Time before and after, between which the velocity of the truth is measured [s]. Half a stride, so that
the sway of a walker cancels."""


@dataclass(frozen=True, eq=False)
class FacingErrors:
    """Of every match whose track faces somewhere, (K,) each.

    Attributes:
        to_truth_deg: to where the truth faces, 0 to 180; NaN where it does not say.
        to_walk_deg: to where the true person moves, 0 to 180; NaN where that is unknown.
        speed_mps: of the true person; NaN where unknown.
    """

    to_truth_deg: F64
    to_walk_deg: F64
    speed_mps: F64

    def to_json(self) -> dict[str, Any]:
        """Rows and median differences [deg] of walkers and of standers against the truth; empty without any."""
        groups = {"walkers": self.speed_mps > WALKING_MPS, "standers": self.speed_mps <= WALKING_MPS}
        figures = {}
        for name, members in groups.items():
            known = self.to_truth_deg[members & np.isfinite(self.to_truth_deg)]
            if len(known):
                turned = float(np.median(np.minimum(known, 180.0 - known)))
                figures[name] = {
                    "rows": len(known), "median_deg": float(np.median(known)), "median_modulo_180_deg": turned,
                }  # fmt: skip
        return figures

    @property
    def walkers_deg(self) -> float | None:
        """Median difference of walkers to the truth, or where that does not say where people face, to the direction in
        which they walk; None without any."""
        against = self.to_truth_deg if np.isfinite(self.to_truth_deg).any() else self.to_walk_deg
        known = against[(self.speed_mps > WALKING_MPS) & np.isfinite(against)]
        return float(np.median(known)) if len(known) else None


def facing_errors(facing_deg: F64, truth: Trajectories, velocity_mps: F64) -> FacingErrors:
    """The errors of matches; (N,) facing of tracks, the truth rows that they match, and (N, 2) velocities of these."""
    known = np.isfinite(facing_deg)
    facing, (vx, vy) = facing_deg[known], velocity_mps[known].T
    to_truth, to_walk = (
        np.abs((facing - other + 180.0) % 360.0 - 180.0)
        for other in (truth.facing_deg[known], np.degrees(np.arctan2(vy, vx)))
    )
    return FacingErrors(to_truth, to_walk, np.hypot(vx, vy))


def velocities(table: Trajectories, frame_s: float) -> F64:
    """(N, 2) velocities of the rows of a table [m/s], from places STEP_S before and after; NaN for a single row."""
    velocity = np.full((len(table), 2), np.nan)
    for _, rows in rows_by_id(table.track_id):
        times = table.frame[rows] * frame_s
        before, after = np.maximum(times - STEP_S, times[0]), np.minimum(times + STEP_S, times[-1])
        span = np.where(after > before, after - before, np.nan)
        for axis, place in enumerate((table.x_m[rows], table.y_m[rows])):
            velocity[rows, axis] = (np.interp(after, times, place) - np.interp(before, times, place)) / span
    return velocity
