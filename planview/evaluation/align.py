"""A rotation and a translation of the floor that lay tracks over truth given in another world frame."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from calib.errors import WorkError
from calib.types import F64, I64
from planview.evaluation.metrics import (
    THRESHOLD,
    Similarity,
    best_pairs,
    box_similarity,
    build_sequence,
    floor_similarity,
)
from planview.evaluation.places import with_places
from planview.trajectories.table import Trajectories, rows_by_id

C128 = np.ndarray[Any, np.dtype[np.complex128]]
AS_COMPLEX = np.array([1.0, 1.0j])
"""``xy @ AS_COMPLEX``: (N, 2) places as (N,) complex numbers, which turn and scale by a product."""


@dataclass(frozen=True)
class FloorAlignment:
    """``truth_SE2_tracks``: p_truth = R(rotation_rad) p_tracks + (x_m, y_m); rms over ``pairs`` matched rows [m]."""

    rotation_rad: float
    x_m: float
    y_m: float
    rms_m: float
    pairs: int

    def to_json(self) -> dict[str, float]:
        values = asdict(self)
        return {"rotation_deg": math.degrees(values.pop("rotation_rad")), **values}

    def apply(self, xy: F64) -> F64:
        """(N, 2) positions in the frame of the truth."""
        return np.asarray(xy @ floor_rotation(self.rotation_rad).T + np.array([self.x_m, self.y_m]))


LONGEST = 12
"""People and tracks that are laid over each other: more of them only cost time."""
LEAST_ROWS = 10
"""Frames that a person and a track must have in common."""
LEAST_M = 0.5
"""Distance that a person and a track must go: a person who stands gives no rotation."""


def align_tracks(tracks: Trajectories, truth: Trajectories, gate_m: float) -> tuple[Trajectories, FloorAlignment]:
    """Find the rigid motion (no scale, no mirror) that lets most rows match, and apply it.

    Candidates come from pairs of boxes that overlap (IoU 0.5) where both tables have boxes, else from laying long
    tracks over long true paths; the best is refined on its own matches. Raises WorkError: nothing to align on."""
    candidates = [fit_rigid(_xy(tracks)[k], _xy(truth)[t]) for t, k in _pairs_to_lay(tracks, truth)]
    if not candidates:
        raise WorkError("expected tracks that move along with the truth to align them, found none in common frames")
    common = np.intersect1d(tracks.frame, truth.frame)
    # Frames on which candidates are compared.
    sample = common[:: 1 + len(common) // 200]
    thin_tracks = tracks.where(np.isin(tracks.frame, sample))
    thin_truth = truth.where(np.isin(truth.frame, sample))
    scores = [_score(candidate, thin_tracks, thin_truth, gate_m) for candidate in candidates]
    best = _score(max(scores, key=_rank), tracks, truth, gate_m)
    for _ in range(10):
        t, k = _matches(truth, move_tracks(tracks, best), floor_similarity(gate_m)).T
        if not _can_fit(complex_places(tracks)[k], complex_places(truth)[t]):
            break
        refined = _score(fit_rigid(_xy(tracks)[k], _xy(truth)[t]), tracks, truth, gate_m)
        if _rank(refined) <= _rank(best):
            break
        best = refined
    return move_tracks(tracks, best), best


def _rank(alignment: FloorAlignment) -> tuple[int, float]:
    return alignment.pairs, -alignment.rms_m


def move_tracks(tracks: Trajectories, alignment: FloorAlignment) -> Trajectories:
    """Tracks with positions, velocities and directions of facing in the frame of the truth."""
    xy = alignment.apply(_xy(tracks))
    velocity = tracks.velocity_mps @ floor_rotation(alignment.rotation_rad).T
    facing = (tracks.facing_deg + math.degrees(alignment.rotation_rad) + 180.0) % 360.0 - 180.0
    return replace(tracks, x_m=xy[:, 0], y_m=xy[:, 1], velocity_mps=velocity, facing_deg=facing)


def floor_rotation(angle_rad: float) -> F64:
    """(2, 2) rotation of the floor."""
    c = math.cos(angle_rad)
    s = math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def fit_turn(source: C128, target: C128) -> C128:
    """(...) turns and scales, as complex numbers, that lay (..., N) places over others by least squares, each around
    their means (Umeyama 1991)."""
    a = source - source.mean(axis=-1, keepdims=True)
    b = target - target.mean(axis=-1, keepdims=True)
    return np.asarray((a.conj() * b).sum(axis=-1) / (np.abs(a) ** 2).sum(axis=-1))


def fit_rigid(source: F64, target: F64) -> FloorAlignment:
    """Least-squares rotation and translation of (N, 2) source onto target points."""
    angle = float(np.angle(fit_turn(source @ AS_COMPLEX, target @ AS_COMPLEX)))
    shift = target.mean(axis=0) - floor_rotation(angle) @ source.mean(axis=0)
    result = FloorAlignment(angle, float(shift[0]), float(shift[1]), 0.0, len(source))
    return replace(result, rms_m=_rms(result.apply(source) - target))


def paths_to_lay(truth: Trajectories, tracks: Trajectories) -> Iterator[tuple[I64, I64]]:
    """Rows of a long true path and of a long track in their common frames, for every pair of these."""
    true_xy = complex_places(truth)
    track_xy = complex_places(tracks)
    for person, track in product(_longest(truth), _longest(tracks)):
        _, i, j = np.intersect1d(truth.frame[person], tracks.frame[track], return_indices=True)
        if len(i) >= LEAST_ROWS and _can_fit(true_xy[person[i]], track_xy[track[j]]):
            yield person[i], track[j]


def _longest(table: Trajectories) -> list[I64]:
    """Rows of the longest paths."""
    rows = [rows for _, rows in rows_by_id(table.track_id)]
    return sorted(rows, key=len, reverse=True)[:LONGEST]


def _can_fit(source: C128, target: C128) -> bool:
    """True if places can be laid over others: enough of them, known, and not on a spot."""
    if len(source) < 5 or not np.isfinite(source + target).all():
        return False
    return bool(min(np.abs(source - source[0]).max(), np.abs(target - target[0]).max()) >= LEAST_M)


def _pairs_to_lay(tracks: Trajectories, truth: Trajectories) -> Iterator[tuple[I64, I64]]:
    """Rows of the truth and of the tracks that may belong together."""
    if len(with_places(tracks, on_floor=False)) and len(with_places(truth, on_floor=False)):
        t, k = _matches(truth, tracks, box_similarity).T
        true_places = complex_places(truth)
        track_places = complex_places(tracks)
        has_both = np.isfinite(true_places[t] + track_places[k])
        t = t[has_both]
        k = k[has_both]
        if _can_fit(track_places[k], true_places[t]):
            yield t, k
    yield from paths_to_lay(truth, tracks)


def _matches(truth: Trajectories, tracks: Trajectories, similarity: Similarity) -> I64:
    """(K, 2) truth and track rows of the frame-by-frame matches."""
    pairs = build_sequence(truth, tracks, similarity)
    matched = best_pairs(pairs.pair_truth, pairs.pair_track, pairs.similarity, pairs.pair_frame)
    matched &= pairs.similarity >= THRESHOLD
    return np.column_stack([pairs.pair_truth[matched], pairs.pair_track[matched]])


def _score(alignment: FloorAlignment, tracks: Trajectories, truth: Trajectories, gate_m: float) -> FloorAlignment:
    """The alignment with the number and rms of the rows it matches."""
    laid = move_tracks(tracks, alignment)
    pairs = _matches(truth, laid, floor_similarity(gate_m))
    offset = _xy(laid)[pairs[:, 1]] - _xy(truth)[pairs[:, 0]]
    return replace(alignment, pairs=len(pairs), rms_m=_rms(offset) if len(pairs) else math.inf)


def _xy(table: Trajectories) -> F64:
    return np.column_stack([table.x_m, table.y_m])


def complex_places(table: Trajectories) -> C128:
    """(N,) positions as complex numbers."""
    return np.asarray(_xy(table) @ AS_COMPLEX)


def _rms(offset: F64) -> float:
    return float(np.sqrt((offset**2).sum(axis=1).mean()))
