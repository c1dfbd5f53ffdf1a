"""CLEAR-MOT: one-to-one matches that prefer to continue, MOTA and identity switches (Bernardin, Stiefelhagen 2008)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.types import I64
from planview.evaluation.sequence import EPS, THRESHOLD, FrameScores, Sequence

MOSTLY_TRACKED, MOSTLY_LOST = 0.8, 0.2
"""Shares of a person's rows (Wu, Nevatia 2006, as MOTChallenge counts them)."""
_CONTINUE = 1000.0
"""Weight of continuing the last frame's pair: above any sum of similarities in a frame."""


@dataclass(frozen=True, eq=False)
class ClearScores:
    """Counts over a sequence.

    Attributes:
        matches: (K, 2) int64, (truth row, track row) of every match in frame order.
        misses, false_positives, switches: counts.
        mota: 1 - (misses + false positives + switches) / truth rows; None without truth rows.
        mostly_tracked, mostly_lost: people matched in more than 80 % and less than 20 % of their rows, by any tracks.
        fragmentations: times that a person is matched again after frames without a match.
    """

    matches: I64
    misses: int
    false_positives: int
    switches: int
    mota: float | None
    mostly_tracked: int
    mostly_lost: int
    fragmentations: int


def clear_scores(sequence: Sequence, threshold: float = THRESHOLD) -> ClearScores:
    """Match frame by frame: first keep the pairs of the frame before, then maximise the similarity.

    A switch is a match of a person with another track than at that person's last match, however long ago. The frame
    before is the last one in which there were both people and tracks.
    """
    ever = np.full(sequence.n_truth, -1)  # each person's last track
    before = np.full(sequence.n_truth, -1)  # the same, if matched in the frame before
    matches: list[I64] = []
    matched, starts = np.zeros(sequence.n_truth), np.zeros(sequence.n_truth, dtype=np.int64)
    switches = 0
    for frame in sequence.frames:
        if not len(frame.truth) or not len(frame.tracks):
            continue
        rows, cols = _match(frame, before, threshold)
        people, tracks = frame.truth[rows], frame.tracks[cols]
        switches += int(np.count_nonzero((ever[people] >= 0) & (ever[people] != tracks)))
        starts[people] += before[people] < 0
        matched[people] += 1
        ever[people] = tracks
        before[:] = -1
        before[people] = tracks
        matches.append(np.column_stack([frame.truth_rows[rows], frame.track_rows[cols]]))
    pairs = np.concatenate(matches) if matches else np.empty((0, 2), dtype=np.int64)
    misses, extra = sequence.truth_rows - len(pairs), sequence.track_rows - len(pairs)
    mota = 1.0 - (misses + extra + switches) / sequence.truth_rows if sequence.truth_rows else None
    share = matched / np.maximum(1, _rows_per_person(sequence))
    tracked, lost = np.count_nonzero(share > MOSTLY_TRACKED), np.count_nonzero(share < MOSTLY_LOST)
    fragmentations = int(np.maximum(0, starts - 1).sum())
    return ClearScores(pairs, misses, extra, switches, mota, int(tracked), int(lost), fragmentations)


def _rows_per_person(sequence: Sequence) -> I64:
    rows = [frame.truth for frame in sequence.frames]
    return np.bincount(np.concatenate([np.empty(0, dtype=np.int64), *rows]), minlength=sequence.n_truth)


def _match(frame: FrameScores, before: I64, threshold: float) -> tuple[I64, I64]:
    score = _CONTINUE * (frame.tracks[None, :] == before[frame.truth][:, None]) + frame.similarity
    score[frame.similarity < threshold - EPS] = 0.0
    rows, cols = linear_sum_assignment(-score)
    good = score[rows, cols] > EPS
    return rows[good], cols[good]
