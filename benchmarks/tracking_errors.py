"""Tracking errors of a sequence, counted as in table II of del-Blanco, Jaureguizar, Garcia 2012."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planview.evaluation.clear import clear_scores
from planview.evaluation.sequence import Similarity, box_similarity, build_sequence
from planview.trajectories.table import Trajectories, rows_by_id

GAP_FRAMES = 7
"""A person without a match for longer than this many frames is lost: one second of PETS S2-L1 (7 frames/s)."""


@dataclass(frozen=True)
class TrackingErrors:
    """Events over a whole sequence.

    Attributes:
        false_tracks: confirmed tracks that lie on no person in more than half of their frames.
        losses: times that a person goes without a match for more than ``GAP_FRAMES`` consecutive frames of the truth,
            before, between or after the matches; never being found is one loss.
        switches: matches of a person with another track than at its last match (CLEAR).
    """

    false_tracks: int
    losses: int
    switches: int

    @property
    def total(self) -> int:
        return self.false_tracks + self.losses + self.switches


def tracking_errors(
    truth: Trajectories, tracks: Trajectories, similarity: Similarity = box_similarity, gap_frames: int = GAP_FRAMES
) -> TrackingErrors:
    """Count false tracks, losses and switches (the paper counts "tracking errors" and does not say how: our choice).

    Args:
        truth, tracks: sorted by frame, one row per frame and id; only confirmed rows of the tracks count.
        similarity: image boxes at IoU 0.5, or ``floor_similarity(gate)``.
        gap_frames: see ``TrackingErrors.losses``.
    """
    tracks = tracks.where(tracks.state == "confirmed")
    scores = clear_scores(build_sequence(truth, tracks, similarity))
    on_somebody = np.zeros(len(tracks), dtype=np.bool_)
    on_somebody[scores.matches[:, 1]] = True
    found = np.zeros(len(truth), dtype=np.bool_)
    found[scores.matches[:, 0]] = True
    false_tracks = sum(bool(on_somebody[rows].mean() < 0.5) for _, rows in rows_by_id(tracks.track_id))
    losses = sum(_long_gaps(found[rows], gap_frames) for _, rows in rows_by_id(truth.track_id))
    return TrackingErrors(false_tracks, losses, scores.switches)


def _long_gaps(found: np.ndarray[tuple[int], np.dtype[np.bool_]], gap_frames: int) -> int:
    """Runs of False longer than the gap."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], found, [True]]).astype(np.int8)))
    return int(np.count_nonzero(np.diff(edges)[::2] > gap_frames))
