"""Truth and tracks side by side: what every metric is computed on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from collections.abc import Sequence as Items
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from calib.types import F64, I64
from planview.trajectories.table import Trajectories

THRESHOLD = 0.5
"""A pair may match from this similarity on: the gate on the floor, or IoU 0.5 for boxes."""
EPS = float(np.finfo(np.float64).eps)

Similarity = Callable[[Trajectories, I64, Trajectories, I64], F64]
"""(truth, its rows (P,), tracks, their rows (P,)) -> (P,) similarity in 0..1 of each pair."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """Rows of truth and tracks, and the pairs of them that are in one frame and similar at all.

    Attributes:
        truth, tracks: (T,), (K,) dense person and track indices (0..n-1) of the rows, at most one row each per frame.
        truth_frame, track_frame: (T,), (K,) number of their frame among those that hold anything, ascending.
        pair_truth, pair_track: (P,) rows of every pair with a similarity above 0, by truth row, then track row.
        similarity: (P,) in 0..1.
        n_truth, n_tracks, n_frames: how many people, tracks, and frames that hold anything.
    """

    truth: I64
    tracks: I64
    truth_frame: I64
    track_frame: I64
    pair_truth: I64
    pair_track: I64
    similarity: F64
    n_truth: int
    n_tracks: int
    n_frames: int

    @property
    def truth_rows(self) -> int:
        return len(self.truth)

    @property
    def track_rows(self) -> int:
        return len(self.tracks)

    @property
    def pair_frame(self) -> I64:
        """(P,) number of each pair's frame, ascending."""
        return self.truth_frame[self.pair_truth]

    @staticmethod
    def joined(parts: Items[Sequence]) -> Sequence:
        """All rows of all parts, with people, tracks and frames of their own for each."""
        counts = ("n_truth", "n_tracks", "n_frames", "truth_rows", "track_rows")
        people, tracks, frames, truth_rows, track_rows = (
            np.cumsum([0, *(getattr(part, n) for part in parts)]).tolist() for n in counts
        )
        offsets = {
            "truth": people, "tracks": tracks, "truth_frame": frames, "track_frame": frames,
            "pair_truth": truth_rows, "pair_track": track_rows, "similarity": [0.0] * len(parts),
        }  # fmt: skip
        columns = {
            name: np.concatenate([getattr(part, name) + first for part, first in zip(parts, firsts, strict=False)])
            for name, firsts in offsets.items()
        }
        return Sequence(**columns, n_truth=people[-1], n_tracks=tracks[-1], n_frames=frames[-1])


_Columns = TypeVar("_Columns")


def joined_rows(parts: Items[_Columns]) -> _Columns:
    """Dataclasses of columns, (N,) each, as one with the rows of all parts in their order."""
    names = [field.name for field in fields(parts[0])]  # type: ignore[arg-type]
    return type(parts[0])(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def floor_similarity(gate_m: float) -> Similarity:
    """1 - d / (2 gate), not below 0: THRESHOLD falls on the gate.

    The convention of the MOT 2015 3D benchmark (gate 1 m there), so that CLEAR, IDF1 and HOTA share one value.
    """

    def similarity(truth: Trajectories, rows: I64, tracks: Trajectories, track_rows: I64) -> F64:
        dx = truth.x_m[rows] - tracks.x_m[track_rows]
        dy = truth.y_m[rows] - tracks.y_m[track_rows]
        return np.maximum(0.0, 1.0 - np.hypot(dx, dy) / (2.0 * gate_m))

    return similarity


def box_similarity(truth: Trajectories, rows: I64, tracks: Trajectories, track_rows: I64) -> F64:
    """Intersection over union of the image boxes."""
    a, b = truth.box_px[rows], tracks.box_px[track_rows]
    overlap = np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    both = np.prod(np.maximum(overlap, 0.0), axis=-1)
    union = np.prod(a[:, 2:], axis=-1) + np.prod(b[:, 2:], axis=-1) - both
    return np.asarray(np.where(union > 0, both / np.where(union > 0, union, 1.0), 0.0), dtype=np.float64)


def build_sequence(truth: Trajectories, tracks: Trajectories, similarity: Similarity) -> Sequence:
    """Pair the rows of two tables by frame.

    Args:
        truth, tracks: sorted by frame, one row per frame and id (as ``planview.trajectories.table`` reads them).
        similarity: ``floor_similarity(gate)`` or ``box_similarity``.
    """
    people, truth_index = np.unique(truth.track_id, return_inverse=True)
    ids, track_index = np.unique(tracks.track_id, return_inverse=True)
    frames = np.union1d(truth.frame, tracks.frame)
    parts = [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))]
    for t, k in _pairs_in_frames(truth.frame, tracks.frame):
        values = similarity(truth, t, tracks, k)
        near = values > 0
        parts.append((t[near], k[near], values[near]))
    t, k, values = (np.concatenate(column) for column in zip(*parts, strict=True))
    rows = truth_index, track_index, np.searchsorted(frames, truth.frame), np.searchsorted(frames, tracks.frame)
    return Sequence(*rows, t, k, values, len(people), len(ids), len(frames))


def _pairs_in_frames(truth_frame: I64, track_frame: I64) -> Iterator[tuple[I64, I64]]:
    """All pairs of rows in one frame, by truth row, then track row, in blocks."""
    first = np.searchsorted(track_frame, truth_frame)
    counts = np.searchsorted(track_frame, truth_frame, side="right") - first
    ends = np.cumsum(counts)
    start = 0
    while start < len(counts):
        done = ends[start - 1] if start else 0
        # Pairs whose similarity is computed at a time, most of which are too far apart to be kept.
        stop = max(start + 1, int(np.searchsorted(ends, done + 200_000, side="right")))
        some = counts[start:stop]
        since = np.arange(some.sum()) - np.repeat(ends[start:stop] - some - done, some)
        yield np.repeat(np.arange(start, stop), some), np.repeat(first[start:stop], some) + since
        start = stop
