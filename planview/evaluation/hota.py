"""HOTA: detection and association in equal parts over all localisation thresholds (Luiten et al. 2021)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64, I64
from planview.evaluation.assignment import best_pairs
from planview.evaluation.sequence import EPS, Sequence, common_pairs

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
    n_truth, n_tracks = sequence.truth_rows, sequence.track_rows
    if n_truth + n_tracks == 0:
        return HotaScores(None, None, None)
    common = common_pairs(sequence)
    # (C,) rows of the person and of the track of every common pair together.
    truth = np.bincount(sequence.truth, minlength=sequence.n_truth)[common.truth]
    tracks = np.bincount(sequence.tracks, minlength=sequence.n_tracks)[common.track]
    union = np.asarray(truth + tracks, dtype=np.float64)
    # (P,) share of each pair in what its two rows are similar to in their frame, as an intersection over union.
    s = sequence.similarity
    of_truth = np.bincount(sequence.pair_truth, s, sequence.truth_rows)[sequence.pair_truth]
    of_track = np.bincount(sequence.pair_track, s, sequence.track_rows)[sequence.pair_track]
    shares = np.asarray(s / np.maximum(of_track + of_truth - s, EPS))
    potential = np.bincount(common.of_pair, shares, len(common.truth))
    score = (potential / (union - potential))[common.of_pair] * sequence.similarity
    matched = best_pairs(sequence.pair_truth, sequence.pair_track, score, sequence.pair_frame)
    matches = _count_matches(sequence.similarity[matched], common.of_pair[matched], len(common.truth))
    tp = matches.sum(axis=1)
    deta = tp / (n_truth + n_tracks - tp)
    assa = (matches * (matches / np.maximum(1.0, union - matches))).sum(axis=1) / np.maximum(1.0, tp)
    return HotaScores(float(np.sqrt(deta * assa).mean()), float(deta.mean()), float(assa.mean()))


def _count_matches(similarity: F64, common: I64, n_common: int) -> F64:
    """(alphas, C) frames in which a common pair is matched at a threshold."""
    counts = [np.bincount(common[similarity >= alpha - EPS], minlength=n_common) for alpha in ALPHAS]
    return np.array(counts, dtype=np.float64)
