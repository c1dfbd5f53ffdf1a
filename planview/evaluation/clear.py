"""CLEAR-MOT: one-to-one matches that prefer to continue, MOTA and identity switches (Bernardin, Stiefelhagen 2008)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.types import I64
from planview.evaluation.sequence import EPS, THRESHOLD, FrameScores, Sequence

_CONTINUE = 1000.0
"""Weight of continuing the last frame's pair: above any sum of similarities in a frame."""


@dataclass(frozen=True, eq=False)
class ClearScores:
    """Counts over a sequence.

    Attributes:
        matches: (K, 2) int64, (truth row, track row) of every match in frame order.
        misses, false_positives, switches: counts.
        mota: 1 - (misses + false positives + switches) / truth rows; None without truth rows.
    """

    matches: I64
    misses: int
    false_positives: int
    switches: int
    mota: float | None


def clear_scores(sequence: Sequence, threshold: float = THRESHOLD) -> ClearScores:
    """Match frame by frame: first keep the pairs of the frame before, then maximise the similarity.

    A switch is a match of a person with another track than at that person's last match, however long ago. The frame
    before is the last one in which there were both people and tracks.
    """
    ever = np.full(sequence.n_truth, -1)  # each person's last track
    before = np.full(sequence.n_truth, -1)  # the same, if matched in the frame before
    matches: list[I64] = []
    switches = 0
    for frame in sequence.frames:
        if not len(frame.truth) or not len(frame.tracks):
            continue
        rows, cols = _match(frame, before, threshold)
        people, tracks = frame.truth[rows], frame.tracks[cols]
        switches += int(np.count_nonzero((ever[people] >= 0) & (ever[people] != tracks)))
        ever[people] = tracks
        before[:] = -1
        before[people] = tracks
        matches.append(np.column_stack([frame.truth_rows[rows], frame.track_rows[cols]]))
    pairs = np.concatenate(matches) if matches else np.empty((0, 2), dtype=np.int64)
    misses, extra = sequence.truth_rows - len(pairs), sequence.track_rows - len(pairs)
    mota = 1.0 - (misses + extra + switches) / sequence.truth_rows if sequence.truth_rows else None
    return ClearScores(pairs, misses, extra, switches, mota)


def _match(frame: FrameScores, before: I64, threshold: float) -> tuple[I64, I64]:
    score = _CONTINUE * (frame.tracks[None, :] == before[frame.truth][:, None]) + frame.similarity
    score[frame.similarity < threshold - EPS] = 0.0
    rows, cols = linear_sum_assignment(-score)
    good = score[rows, cols] > EPS
    return rows[good], cols[good]
