"""The five qualities that pedestrian tracking is benchmarked by: flux, density, position, trajectory, continuity.

After Pouw et al. 2021, "Benchmarking high-fidelity pedestrian tracking systems for research, real-time monitoring and
crowd control" (arXiv 2108.11719), whose abstract names what the five tests concern, each giving a single number. The
formulas here are ours (``docs/trackers.md``): figures are not to be compared with published ones.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from calib.errors import InputError
from calib.types import F64
from planview.evaluation.align import align_tracks
from planview.evaluation.evaluate import EvaluationParams
from planview.evaluation.metrics import clear_scores
from planview.evaluation.sequence import build_sequence, floor_similarity
from planview.trajectories.table import Trajectories, rows_by_id

LINES = (0.25, 0.5, 0.75)
"""Quantiles of the true positions along x and y at which lines are laid across the floor."""
BEYOND_M = 0.2
"""How far beyond a line somebody must be on both sides to have crossed it [m]: the sway of a step."""


@dataclass(frozen=True)
class Benchmark:
    """One number each; NaN where the truth has nothing to measure it on.

    Attributes:
        flux: 1 - wrong over true crossings, of lines across the floor in either direction; at most 1, which is best.
        density: 1 - wrong over true number of people on the floor, frame by frame; at most 1.
        position_m: mean distance of matched positions [m].
        trajectory_m: root mean square distance between a person's path and what follows it, without the mean offset of
            all people [m]: jitter and lag.
        continuity: share of a person's rows that one track follows, over all people; at most 1.
    """

    flux: float
    density: float
    position_m: float
    trajectory_m: float
    continuity: float

    def to_json(self) -> dict[str, float | None]:
        """Plain values; null for NaN."""
        return {name: value if math.isfinite(value) else None for name, value in asdict(self).items()}


def benchmark(
    tracks: Trajectories,
    truth: Trajectories,
    params: EvaluationParams | None = None,
    frames: tuple[int, int] | None = None,
) -> Benchmark:
    """Score confirmed tracks against truth on the floor.

    Args:
        tracks, truth: as read from their files.
        params: the gate of a match [m], and whether tracks are laid over the truth first.
        frames: first and last frame to score, both included; all by default.
    Raises:
        InputError: tracks or truth without floor positions.
    """
    params = params or EvaluationParams()
    if frames is not None:
        tracks, truth = (t.where((t.frame >= frames[0]) & (t.frame <= frames[1])) for t in (tracks, truth))
    found = tracks.where((tracks.state == "confirmed") & np.isfinite(tracks.x_m) & np.isfinite(tracks.y_m))
    true = truth.where(np.isfinite(truth.x_m) & np.isfinite(truth.y_m))
    for table, rows, what in ((truth, true, "truth"), (tracks, found, "tracks")):
        if len(table) and not len(rows) and (what == "truth" or (table.state == "confirmed").any()):
            raise InputError(f"--benchmark: expected {what} with floor positions, found rows without them")
    if params.align:
        found, _ = align_tracks(found, true, params.gate_m)
    t, k = clear_scores(build_sequence(true, found, floor_similarity(params.gate_m))).matches.T
    off = np.column_stack([found.x_m[k] - true.x_m[t], found.y_m[k] - true.y_m[t]])
    own = off - off.mean(axis=0) if len(off) else off
    followed = 0
    for _, mine in rows_by_id(true.track_id[t]):
        followed += int(np.unique(found.track_id[k[mine]], return_counts=True)[1].max())
    return Benchmark(
        flux=_flux(found, true),
        density=_density(found, true),
        position_m=float(np.hypot(*off.T).mean()) if len(off) else math.nan,
        trajectory_m=float(np.sqrt((own**2).sum(axis=1).mean())) if len(off) else math.nan,
        continuity=followed / len(true) if len(true) else math.nan,
    )


def _flux(found: Trajectories, true: Trajectories) -> float:
    if not len(true):
        return math.nan
    wrong = crossed = 0
    for axis in ("x_m", "y_m"):
        for place in np.quantile(getattr(true, axis), LINES):
            expected, counted = _crossings(true, axis, place), _crossings(found, axis, place)
            wrong += int(np.abs(expected - counted).sum())
            crossed += int(expected.sum())
    return 1.0 - wrong / crossed if crossed else math.nan


def _crossings(table: Trajectories, axis: str, place_m: float) -> F64:
    """(2,) crossings of a line towards higher and towards lower values."""
    counts = np.zeros(2)
    for _, rows in rows_by_id(table.track_id):
        off = getattr(table, axis)[rows] - place_m
        sides = np.sign(off[np.abs(off) > BEYOND_M])
        turns = np.diff(sides)
        counts += (turns > 0).sum(), (turns < 0).sum()
    return counts


def _density(found: Trajectories, true: Trajectories) -> float:
    if not len(true):
        return math.nan
    seen, which = np.unique(np.concatenate([true.frame, found.frame]), return_inverse=True)
    expected = np.bincount(which[: len(true)], minlength=len(seen))
    counted = np.bincount(which[len(true) :], minlength=len(seen))
    return float(1.0 - np.abs(expected - counted).sum() / expected.sum())
