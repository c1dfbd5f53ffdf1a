"""A rotation and a translation of the floor that lay tracks over truth given in another world frame."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

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
from planview.trajectories.table import Trajectories


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


def align_tracks(tracks: Trajectories, truth: Trajectories, gate_m: float) -> tuple[Trajectories, FloorAlignment]:
    """Find the rigid motion (no scale, no mirror) that lets most rows match, and apply it.

    Candidates come from pairs of boxes that overlap (IoU 0.5) where both tables have boxes, else from laying long
    tracks over long true paths; the best is refined on its own matches. Raises WorkError: nothing to align on."""
    candidates = list(_candidates(tracks, truth))
    if not candidates:
        raise WorkError("expected tracks that move along with the truth to align them, found none in common frames")
    common = np.intersect1d(tracks.frame, truth.frame)
    # Frames on which candidates are compared.
    sample = common[:: 1 + len(common) // 200]
    thin = tuple(table.where(np.isin(table.frame, sample)) for table in (tracks, truth))
    best = max((_score(c, thin[0], thin[1], gate_m) for c in candidates), key=lambda a: (a.pairs, -a.rms_m))
    best = _score(best, tracks, truth, gate_m)
    for _ in range(10):
        pairs = _pairs(truth, moved(tracks, best), floor_similarity(gate_m))
        refit = next(_fit_pairs(tracks, truth, pairs), best)
        refined = _score(refit, tracks, truth, gate_m)
        if (refined.pairs, -refined.rms_m) <= (best.pairs, -best.rms_m):
            break
        best = refined
    return moved(tracks, best), best


def moved(tracks: Trajectories, alignment: FloorAlignment) -> Trajectories:
    """Tracks with positions, velocities and directions of facing in the frame of the truth."""
    xy = alignment.apply(_xy(tracks))
    velocity = tracks.velocity_mps @ floor_rotation(alignment.rotation_rad).T
    facing = (tracks.facing_deg + math.degrees(alignment.rotation_rad) + 180.0) % 360.0 - 180.0
    return replace(tracks, x_m=xy[:, 0], y_m=xy[:, 1], velocity_mps=velocity, facing_deg=facing)


def floor_rotation(angle_rad: float) -> F64:
    """(2, 2) rotation of the floor."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def fit_rigid(source: F64, target: F64) -> FloorAlignment:
    """Least-squares rotation and translation of (N, 2) source onto target points (Umeyama 1991 without scale)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    angle = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    shift = target.mean(axis=0) - floor_rotation(angle) @ source.mean(axis=0)
    result = FloorAlignment(angle, float(shift[0]), float(shift[1]), 0.0, len(source))
    return replace(result, rms_m=_rms(result.apply(source) - target))


def _candidates(tracks: Trajectories, truth: Trajectories) -> Iterator[FloorAlignment]:
    if np.isfinite(tracks.box_px).all(axis=1).any() and np.isfinite(truth.box_px).all(axis=1).any():
        yield from _fit_pairs(tracks, truth, _pairs(truth, tracks, box_similarity))
    for person in _longest(truth):
        for track in _longest(tracks):
            p, k = np.flatnonzero(truth.track_id == person), np.flatnonzero(tracks.track_id == track)
            _, i, j = np.intersect1d(truth.frame[p], tracks.frame[k], return_indices=True)
            yield from _fit_pairs(tracks, truth, np.column_stack([p[i], k[j]]))


def _longest(table: Trajectories) -> list[int]:
    ids, counts = np.unique(table.track_id, return_counts=True)
    # Longest tracks and people that are tried on each other; more only cost time.
    return [int(i) for i in ids[np.argsort(-counts, kind="stable")[:12]]]


def _fit_pairs(tracks: Trajectories, truth: Trajectories, pairs: I64) -> Iterator[FloorAlignment]:
    """A fit to (truth row, track row) pairs, unless they are too few or lie on a spot (no rotation to be had)."""
    target, source = _xy(truth)[pairs[:, 0]], _xy(tracks)[pairs[:, 1]]
    known = np.isfinite(source).all(axis=1) & np.isfinite(target).all(axis=1)
    source, target = source[known], target[known]
    if len(source) >= 5 and min(np.ptp(source, axis=0).max(), np.ptp(target, axis=0).max()) >= 0.5:
        yield fit_rigid(source, target)


def _pairs(truth: Trajectories, tracks: Trajectories, similarity: Similarity) -> I64:
    """(K, 2) truth and track rows of the frame-by-frame matches."""
    found = build_sequence(truth, tracks, similarity)
    matched = best_pairs(found.pair_truth, found.pair_track, found.similarity, found.pair_frame)
    matched &= found.similarity >= THRESHOLD
    return np.column_stack([found.pair_truth[matched], found.pair_track[matched]])


def _score(alignment: FloorAlignment, tracks: Trajectories, truth: Trajectories, gate_m: float) -> FloorAlignment:
    """The alignment with the number and rms of the rows it matches."""
    laid = moved(tracks, alignment)
    pairs = _pairs(truth, laid, floor_similarity(gate_m))
    offset = _xy(laid)[pairs[:, 1]] - _xy(truth)[pairs[:, 0]]
    return replace(alignment, pairs=len(pairs), rms_m=_rms(offset) if len(pairs) else math.inf)


def _xy(table: Trajectories) -> F64:
    return np.column_stack([table.x_m, table.y_m])


def _rms(offset: F64) -> float:
    return float(np.sqrt((offset**2).sum(axis=1).mean()))
