"""Fragments of one person, joined by one assignment of ends to starts over the whole recording.

The scheme of Huang, Wu, Nevatia 2008 ("Robust object tracking by hierarchical association of detection responses",
section 3.2): every end continues in one start or in none, at the smallest sum of costs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.types import F64
from planview.offline.params import RefineParams

FragmentSimilarity = Callable[[int, int], float]
"""(id that ends, id that starts) -> likelihood 0..1 that both look like one person, relative to the best case."""


@dataclass(frozen=True, eq=False)
class End:
    """One end of a fragment: frame, time [s], (2,) position [m] and (2,) velocity [m/s]."""

    frame: int
    time_s: float
    xy_m: F64
    velocity_mps: F64


@dataclass(frozen=True, eq=False)
class Fragment:
    """A track from its first row to its last confirmed one; median height [m], NaN where unknown."""

    track_id: int
    start: End
    end: End
    height_m: float


@dataclass(frozen=True)
class Join:
    """``later`` continues ``earlier``, at a cost."""

    earlier: int
    later: int
    cost: float


def joins(
    fragments: Sequence[Fragment], params: RefineParams, similarity: FragmentSimilarity | None = None
) -> list[Join]:
    """The joins of the cheapest assignment; leaving an end alone costs ``cost_max``."""
    n = len(fragments)
    if n < 2:
        return []
    from scipy.optimize import linear_sum_assignment  # half a second and 60 MB, and one track needs none

    costs = np.array([[join_cost(a, b, params, similarity) for b in fragments] for a in fragments])
    allowed = costs < params.cost_max
    far = params.cost_max * (n + 1)
    alone = np.full((n, n), far)
    np.fill_diagonal(alone, params.cost_max)
    rows, cols = linear_sum_assignment(np.hstack([np.where(allowed, costs, far), alone]))
    return [
        Join(fragments[i].track_id, fragments[j].track_id, float(costs[i, j]))
        for i, j in zip(rows, cols, strict=True)
        if j < n and allowed[i, j]
    ]


def join_cost(a: Fragment, b: Fragment, params: RefineParams, similarity: FragmentSimilarity | None = None) -> float:
    """Squared normalised differences of prediction and height, minus twice the log similarity; infinite if impossible.

    The deviation of a prediction grows with the time between; a height that is unknown decides nothing.
    """
    gap_s = b.start.time_s - a.end.time_s
    if b.start.frame <= a.end.frame or not 0 < gap_s <= params.join_s:
        return math.inf
    way_m = float(np.hypot(*(b.start.xy_m - a.end.xy_m)))
    if way_m > params.speed_max_mps * gap_s + 2 * params.position_std_m:
        return math.inf
    apart_m = prediction_error_m(a.end, b.start)
    cost = (apart_m / (2 * params.position_std_m + params.drift_mps * gap_s)) ** 2
    if math.isfinite(a.height_m - b.height_m):
        cost += ((a.height_m - b.height_m) / (math.sqrt(2) * params.height_std_m)) ** 2
    if similarity is not None:
        alike = similarity(a.track_id, b.track_id)
        cost += -2 * math.log(alike) if alike > 0 else math.inf
    return cost


def prediction_error_m(end: End, start: End) -> float:
    """Mean distance of the two predictions at constant velocity, of the start from the end and of the end back [m]."""
    gap_s = start.time_s - end.time_s
    ahead = end.xy_m + gap_s * end.velocity_mps - start.xy_m
    back = start.xy_m - gap_s * start.velocity_mps - end.xy_m
    return float(np.hypot(*ahead) + np.hypot(*back)) / 2
