"""Truth and tracks side by side, frame by frame: what every metric is computed on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from collections.abc import Sequence as Items
from dataclasses import dataclass

import numpy as np

from calib.types import F64, I64
from planview.trajectories.table import Trajectories

THRESHOLD = 0.5
"""A pair may match from this similarity on: the gate on the floor, or IoU 0.5 for boxes."""
EPS = float(np.finfo(np.float64).eps)

Similarity = Callable[[Trajectories, I64, Trajectories, I64], F64]
"""(truth, its rows (n,), tracks, their rows (m,)) -> (n, m) similarity in 0..1."""


@dataclass(frozen=True, eq=False)
class FrameScores:
    """One frame.

    Attributes:
        truth, tracks: (n,), (m,) dense person and track indices (0..N-1 over the sequence), each at most once.
        truth_rows, track_rows: (n,), (m,) where these stand in their tables.
        similarity: (n, m) float64 in 0..1.
    """

    truth: I64
    tracks: I64
    truth_rows: I64
    track_rows: I64
    similarity: F64

    def shifted(self, truth: int, tracks: int, truth_rows: int, track_rows: int) -> FrameScores:
        """The frame with offsets added to its indices and rows."""
        return FrameScores(
            self.truth + truth,
            self.tracks + tracks,
            self.truth_rows + truth_rows,
            self.track_rows + track_rows,
            self.similarity,
        )


@dataclass(frozen=True, eq=False)
class Sequence:
    """All frames that hold anything, in order; n_truth people and n_tracks tracks in all."""

    frames: tuple[FrameScores, ...]
    n_truth: int
    n_tracks: int

    @property
    def truth_rows(self) -> int:
        return sum(len(frame.truth) for frame in self.frames)

    @property
    def track_rows(self) -> int:
        return sum(len(frame.tracks) for frame in self.frames)

    @staticmethod
    def joined(parts: Items[Sequence]) -> Sequence:
        """All frames of all parts, with indices and rows of their own for each."""
        frames: list[FrameScores] = []
        n_truth = n_tracks = truth_rows = track_rows = 0
        for part in parts:
            frames += [frame.shifted(n_truth, n_tracks, truth_rows, track_rows) for frame in part.frames]
            n_truth, n_tracks = n_truth + part.n_truth, n_tracks + part.n_tracks
            truth_rows, track_rows = truth_rows + part.truth_rows, track_rows + part.track_rows
        return Sequence(tuple(frames), n_truth, n_tracks)


def floor_similarity(gate_m: float) -> Similarity:
    """1 - d / (2 gate), not below 0: THRESHOLD falls on the gate.

    The convention of the MOT 2015 3D benchmark (gate 1 m there), so that CLEAR, IDF1 and HOTA share one matrix.
    """

    def similarity(truth: Trajectories, rows: I64, tracks: Trajectories, track_rows: I64) -> F64:
        dx = truth.x_m[rows][:, None] - tracks.x_m[track_rows][None, :]
        dy = truth.y_m[rows][:, None] - tracks.y_m[track_rows][None, :]
        return np.maximum(0.0, 1.0 - np.hypot(dx, dy) / (2.0 * gate_m))

    return similarity


def box_similarity(truth: Trajectories, rows: I64, tracks: Trajectories, track_rows: I64) -> F64:
    """Intersection over union of the image boxes."""
    a, b = truth.box_px[rows][:, None, :], tracks.box_px[track_rows][None, :, :]
    overlap = np.minimum(a[..., :2] + a[..., 2:], b[..., :2] + b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    both = np.prod(np.maximum(overlap, 0.0), axis=-1)
    union = np.prod(a[..., 2:], axis=-1) + np.prod(b[..., 2:], axis=-1) - both
    return np.asarray(np.where(union > 0, both / np.where(union > 0, union, 1.0), 0.0), dtype=np.float64)


def build_sequence(truth: Trajectories, tracks: Trajectories, similarity: Similarity) -> Sequence:
    """Pair the rows of two tables by frame.

    Args:
        truth, tracks: sorted by frame, one row per frame and id (as ``planview.trajectories.table`` reads them).
        similarity: ``floor_similarity(gate)`` or ``box_similarity``.
    """
    people, truth_index = np.unique(truth.track_id, return_inverse=True)
    ids, track_index = np.unique(tracks.track_id, return_inverse=True)
    frames = tuple(
        FrameScores(truth_index[t], track_index[k], t, k, similarity(truth, t, tracks, k))
        for t, k in _rows_by_frame(truth.frame, tracks.frame)
    )
    return Sequence(frames, len(people), len(ids))


def _rows_by_frame(truth_frame: I64, track_frame: I64) -> Iterator[tuple[I64, I64]]:
    frames = np.union1d(truth_frame, track_frame)
    bounds = [
        (np.searchsorted(a, frames), np.searchsorted(a, frames, side="right")) for a in (truth_frame, track_frame)
    ]
    (t0, t1), (k0, k1) = bounds
    for i in range(len(frames)):
        yield np.arange(t0[i], t1[i]), np.arange(k0[i], k1[i])
