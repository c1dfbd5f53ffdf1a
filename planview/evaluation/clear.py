"""CLEAR-MOT: one-to-one matches that prefer to continue, MOTA and identity switches (Bernardin, Stiefelhagen 2008)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import I64
from planview.evaluation.assignment import groups_of, lone_pairs, solved
from planview.evaluation.sequence import EPS, THRESHOLD, Sequence

MOSTLY_TRACKED, MOSTLY_LOST = 0.8, 0.2
"""Shares of a person's rows (Wu, Nevatia 2006, as MOTChallenge counts them)."""


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
    # (n_frames,) number of each frame among those with both people and tracks; -1 for the others.
    both = np.zeros(sequence.n_frames, dtype=np.bool_)
    both[np.intersect1d(sequence.truth_frame, sequence.track_frame)] = True
    turn = np.where(both, np.cumsum(both) - 1, -1)
    pairs = _matches(sequence, turn, threshold)
    misses, extra = sequence.truth_rows - len(pairs), sequence.track_rows - len(pairs)
    rows = pairs[np.argsort(sequence.truth[pairs[:, 0]], kind="stable")]
    person, track, at = sequence.truth[rows[:, 0]], sequence.tracks[rows[:, 1]], turn[sequence.truth_frame[rows[:, 0]]]
    again = np.diff(person) == 0
    switches = int(np.count_nonzero(again & (np.diff(track) != 0)))
    mota = 1.0 - (misses + extra + switches) / sequence.truth_rows if sequence.truth_rows else None
    matched, present = (np.bincount(who, minlength=sequence.n_truth) for who in (person, sequence.truth))
    share = matched / np.maximum(1, present)
    tracked, lost = np.count_nonzero(share > MOSTLY_TRACKED), np.count_nonzero(share < MOSTLY_LOST)
    fragmentations = int(np.count_nonzero(again & (np.diff(at) != 1)))
    return ClearScores(pairs, misses, extra, switches, mota, int(tracked), int(lost), fragmentations)


def _matches(sequence: Sequence, turn: I64, threshold: float) -> I64:
    """(K, 2) truth and track rows matched, in the order of frames."""
    near = np.flatnonzero(sequence.similarity >= threshold - EPS)
    rows, cols, similarity = sequence.pair_truth[near], sequence.pair_track[near], sequence.similarity[near]
    row_before = _row_before(sequence.truth, turn[sequence.truth_frame])[rows]
    col_before = _row_before(sequence.tracks, turn[sequence.track_frame])[cols]
    chosen = lone_pairs(rows, cols)
    partner = np.full(sequence.truth_rows + 1, -2)  # the last one is the partner of no row
    partner[rows[chosen]] = cols[chosen]
    for pairs in groups_of(sequence.truth_frame[rows], ~chosen):
        goes_on = (partner[row_before[pairs]] == col_before[pairs]) & (col_before[pairs] >= 0)
        # Weight of continuing the last frame's pair: above any sum of similarities in a frame.
        taken = solved(rows[pairs], cols[pairs], similarity[pairs] + 1000.0 * goes_on)
        chosen[pairs] = taken
        partner[rows[pairs[taken]]] = cols[pairs[taken]]
    return np.column_stack([rows[chosen], cols[chosen]])


def _row_before(who: I64, turn: I64) -> I64:
    """(N,) row of the same person or track in the turn before; -1 without one."""
    order = np.lexsort((turn, who))
    goes_on = (np.diff(who[order]) == 0) & (np.diff(turn[order]) == 1) & (turn[order[:-1]] >= 0)
    before = np.full(len(who), -1)
    before[order[1:][goes_on]] = order[:-1][goes_on]
    return before
