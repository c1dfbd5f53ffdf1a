"""Truth and tracks side by side, and their CLEAR, identity and HOTA scores, each a function of the similar pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from collections.abc import Sequence as Items
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import TypeVar

import numpy as np

from calib.types import F64, I64, Bool
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
    a = truth.box_px[rows]
    b = tracks.box_px[track_rows]
    overlap = np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    both = np.prod(np.maximum(overlap, 0.0), axis=-1)
    union = np.prod(a[:, 2:], axis=-1) + np.prod(b[:, 2:], axis=-1) - both
    return np.asarray(np.where(union > 0, both / np.where(union > 0, union, 1.0), 0.0))


def build_sequence(truth: Trajectories, tracks: Trajectories, similarity: Similarity) -> Sequence:
    """Pair the rows of two tables, sorted by frame, with one row per frame and id."""
    people, truth_index = np.unique(truth.track_id, return_inverse=True)
    ids, track_index = np.unique(tracks.track_id, return_inverse=True)
    frames = np.union1d(truth.frame, tracks.frame)
    blocks = [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))]
    for t, k in pairs_in_frames(truth.frame, tracks.frame):
        values = similarity(truth, t, tracks, k)
        near = values > 0
        blocks.append((t[near], k[near], values[near]))
    pair_truth, pair_track, values = map(np.concatenate, zip(*blocks, strict=True))
    return Sequence(
        truth=truth_index,
        tracks=track_index,
        truth_frame=np.searchsorted(frames, truth.frame),
        track_frame=np.searchsorted(frames, tracks.frame),
        pair_truth=pair_truth,
        pair_track=pair_track,
        similarity=values,
        n_truth=len(people),
        n_tracks=len(ids),
        n_frames=len(frames),
    )


PAIRS_MAX = 200_000
"""Pairs of rows at a time, most of which are too far apart to be kept; a block has those of one row at least."""


def pairs_in_frames(frames: I64 | F64, others: I64 | F64) -> Iterator[tuple[I64, I64]]:
    """All pairs of rows in one frame, by row, then other row, whose frames ascend, in blocks."""
    first = np.searchsorted(others, frames)
    counts = np.searchsorted(others, frames, side="right") - first
    ends = np.cumsum(counts)
    for block in np.split(np.arange(len(frames)), np.flatnonzero(np.diff(ends // PAIRS_MAX)) + 1):
        rows = np.repeat(block, counts[block])
        before = np.cumsum(counts[block]) - counts[block]
        since = np.arange(len(rows)) - np.repeat(before, counts[block])
        yield rows, first[rows] + since


def best_pairs(rows: I64, cols: I64, weight: F64, group: I64) -> Bool:
    """(P,) the pairs whose weights, above 0, have the largest sum, every row and column at most once. Groups ascend,
    and rows and columns of different ones differ."""
    chosen = lone_pairs(rows, cols)
    for pairs in groups_of(group, ~chosen):
        chosen[pairs] = solved(rows[pairs], cols[pairs], weight[pairs])
    return chosen


def lone_pairs(rows: I64, cols: I64) -> Bool:
    """(P,) whether a pair is the only one of its row and of its column."""
    return np.asarray((np.bincount(rows)[rows] == 1) & (np.bincount(cols)[cols] == 1)) if len(rows) else rows > 0


def groups_of(group: I64, members: Bool) -> Iterator[I64]:
    """The indices of the members of each group, of those that have any."""
    indices = np.flatnonzero(members)
    cuts = np.flatnonzero(np.diff(group[indices])) + 1
    bounds = [0, *cuts.tolist(), len(indices)]
    return (indices[a:b] for a, b in pairwise(bounds) if b > a)


def solved(rows: I64, cols: I64, weight: F64) -> Bool:
    """As ``best_pairs``, of one group."""
    from scipy.optimize import linear_sum_assignment  # half a second and 60 MB, and only what is ambiguous needs it

    row_values, i = np.unique(rows, return_inverse=True)
    col_values, j = np.unique(cols, return_inverse=True)
    matrix = np.zeros((len(row_values), len(col_values)))
    matrix[i, j] = -weight
    partner = np.full(len(row_values), -1)
    a, b = linear_sum_assignment(matrix)
    partner[a] = b
    return np.asarray(partner[i] == j)


def idf1(sequence: Sequence) -> float | None:
    """2 IDTP / (truth rows + track rows), with the most rows (IDTP) that one track for each person, of its own, can
    match; None without any rows."""
    near = sequence.similarity >= THRESHOLD - EPS
    pairs = sequence.truth[sequence.pair_truth[near]], sequence.tracks[sequence.pair_track[near]]
    (person, track), common = np.unique(np.stack(pairs), axis=1, return_counts=True)
    matched = int(common[best_pairs(person, track, common.astype(np.float64), np.zeros_like(person))].sum())
    rows = sequence.truth_rows + sequence.track_rows
    return 2.0 * matched / rows if rows else None


ALPHAS: F64 = np.arange(1, 20, dtype=np.float64) * 0.05
"""Localisation thresholds 0.05 to 0.95; on the floor alpha is a distance of 2 gate (1 - alpha)."""


@dataclass(frozen=True)
class HotaScores:
    """Means over ALPHAS: hota of sqrt(DetA AssA), deta of detection, assa of association; None without any rows."""

    hota: float | None
    deta: float | None
    assa: float | None


def hota_scores(sequence: Sequence) -> HotaScores:
    """HOTA with its two passes: global alignment of people and tracks, then matches that favour aligned pairs."""
    rows = sequence.truth_rows + sequence.track_rows
    if rows == 0:
        return HotaScores(None, None, None)
    # (C,) people and tracks that are similar in any frame, each pair once, and (P,) which of them a pair of rows is.
    n_tracks = max(1, sequence.n_tracks)
    keys = sequence.truth[sequence.pair_truth] * n_tracks + sequence.tracks[sequence.pair_track]
    common, of_pair = np.unique(keys, return_inverse=True)
    person, track = np.divmod(common, n_tracks)
    # (C,) rows of the person and of the track of every common pair together.
    person_rows = np.bincount(sequence.truth, minlength=sequence.n_truth)[person]
    track_rows = np.bincount(sequence.tracks, minlength=sequence.n_tracks)[track]
    union = (person_rows + track_rows).astype(np.float64)
    # (P,) share of each pair in what its two rows are similar to in their frame, as an intersection over union.
    similarity = sequence.similarity
    of_truth = np.bincount(sequence.pair_truth, similarity, sequence.truth_rows)[sequence.pair_truth]
    of_track = np.bincount(sequence.pair_track, similarity, sequence.track_rows)[sequence.pair_track]
    shares = similarity / np.maximum(of_track + of_truth - similarity, EPS)
    potential = np.bincount(of_pair, shares, len(common))
    alignment = potential / (union - potential)
    matched = best_pairs(sequence.pair_truth, sequence.pair_track, alignment[of_pair] * similarity, sequence.pair_frame)
    # (alphas, C) frames in which a common pair is matched at a threshold.
    matches = np.empty((len(ALPHAS), len(common)))
    for row, alpha in zip(matches, ALPHAS, strict=True):
        row[:] = np.bincount(of_pair[matched & (similarity >= alpha - EPS)], minlength=len(common))
    tp = matches.sum(axis=1)
    deta = tp / (rows - tp)
    association = matches / np.maximum(1.0, union - matches)
    assa = (matches * association).sum(axis=1) / np.maximum(1.0, tp)
    return HotaScores(float(np.sqrt(deta * assa).mean()), float(deta.mean()), float(assa.mean()))


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


def clear_scores(sequence: Sequence) -> ClearScores:
    """Match frame by frame: first keep the pairs of the frame before, then maximise the similarity.

    A switch is a match of a person with another track than at that person's last match, however long ago. The frame
    before is the last one in which there were both people and tracks.
    """
    # (n_frames,) number of each frame among those with both people and tracks; -1 for the others.
    both = np.zeros(sequence.n_frames, dtype=np.bool_)
    both[np.intersect1d(sequence.truth_frame, sequence.track_frame)] = True
    turn = np.where(both, np.cumsum(both) - 1, -1)
    pairs = _matches(sequence, turn)
    misses = sequence.truth_rows - len(pairs)
    false_positives = sequence.track_rows - len(pairs)
    by_person = pairs[np.argsort(sequence.truth[pairs[:, 0]], kind="stable")]
    person = sequence.truth[by_person[:, 0]]
    track = sequence.tracks[by_person[:, 1]]
    at = turn[sequence.truth_frame[by_person[:, 0]]]
    again = np.diff(person) == 0
    switches = int(np.count_nonzero(again & (np.diff(track) != 0)))
    matched = np.bincount(person, minlength=sequence.n_truth)
    present = np.bincount(sequence.truth, minlength=sequence.n_truth)
    # Shares of a person's rows (Wu, Nevatia 2006, as MOTChallenge counts them).
    share = matched / np.maximum(1, present)
    errors = misses + false_positives + switches
    return ClearScores(
        matches=pairs,
        misses=misses,
        false_positives=false_positives,
        switches=switches,
        mota=1.0 - errors / sequence.truth_rows if sequence.truth_rows else None,
        mostly_tracked=int(np.count_nonzero(share > 0.8)),
        mostly_lost=int(np.count_nonzero(share < 0.2)),
        fragmentations=int(np.count_nonzero(again & (np.diff(at) != 1))),
    )


def _matches(sequence: Sequence, turn: I64) -> I64:
    """(K, 2) truth and track rows matched, in the order of frames."""
    near = np.flatnonzero(sequence.similarity >= THRESHOLD - EPS)
    rows = sequence.pair_truth[near]
    cols = sequence.pair_track[near]
    row_before = _row_before(sequence.truth, turn[sequence.truth_frame])[rows]
    col_before = _row_before(sequence.tracks, turn[sequence.track_frame])[cols]
    chosen = lone_pairs(rows, cols)
    partner = np.full(sequence.truth_rows + 1, -2)  # the last one is the partner of no row
    partner[rows[chosen]] = cols[chosen]
    for pairs in groups_of(sequence.truth_frame[rows], ~chosen):
        goes_on = (partner[row_before[pairs]] == col_before[pairs]) & (col_before[pairs] >= 0)
        # Continuing the last frame's pair weighs more than any sum of similarities in a frame.
        weight = sequence.similarity[near[pairs]] + 1000.0 * goes_on
        taken = solved(rows[pairs], cols[pairs], weight)
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
