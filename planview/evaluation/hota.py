"""HOTA: detection and association in equal parts over all localisation thresholds (Luiten et al. 2021)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.types import F64
from planview.evaluation.sequence import EPS, Sequence

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
    truth_count, track_count = _row_counts(sequence)
    alignment = _alignment(sequence, truth_count, track_count)
    matches = _count_matches(sequence, alignment)
    tp = matches.sum(axis=(1, 2))
    deta = tp / (n_truth + n_tracks - tp)
    union = np.maximum(1.0, truth_count[:, None] + track_count[None, :] - matches)
    assa = (matches * (matches / union)).sum(axis=(1, 2)) / np.maximum(1.0, tp)
    return HotaScores(float(np.sqrt(deta * assa).mean()), float(deta.mean()), float(assa.mean()))


def _row_counts(sequence: Sequence) -> tuple[F64, F64]:
    truth, tracks = np.zeros(sequence.n_truth), np.zeros(sequence.n_tracks)
    for frame in sequence.frames:
        truth[frame.truth] += 1
        tracks[frame.tracks] += 1
    return truth, tracks


def _alignment(sequence: Sequence, truth_count: F64, track_count: F64) -> F64:
    """Jaccard-like agreement of every person and track over the whole sequence."""
    potential = np.zeros((sequence.n_truth, sequence.n_tracks))
    for frame in sequence.frames:
        s = frame.similarity
        union = s.sum(axis=0, keepdims=True) + s.sum(axis=1, keepdims=True) - s
        share = np.where(union > EPS, s / np.where(union > EPS, union, 1.0), 0.0)
        potential[np.ix_(frame.truth, frame.tracks)] += share
    return potential / (truth_count[:, None] + track_count[None, :] - potential)


def _count_matches(sequence: Sequence, alignment: F64) -> F64:
    """(alphas, people, tracks) frames in which a pair is matched at a threshold."""
    counts = np.zeros((len(ALPHAS), sequence.n_truth, sequence.n_tracks))
    for frame in sequence.frames:
        if not len(frame.truth) or not len(frame.tracks):
            continue
        score = alignment[np.ix_(frame.truth, frame.tracks)] * frame.similarity
        rows, cols = linear_sum_assignment(-score)
        close = frame.similarity[rows, cols][None, :] >= ALPHAS[:, None] - EPS
        counts[:, frame.truth[rows], frame.tracks[cols]] += close
    return counts
