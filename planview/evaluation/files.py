"""Scores of tracks that are in memory or on disk."""

from __future__ import annotations

from pathlib import Path

from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.trajectories.formats import load_tracks, load_truth, tracks_file, truth_file
from planview.trajectories.table import Trajectories


def evaluate(
    tracks: Trajectories | Path | str,
    truth: Trajectories | Path | str,
    params: EvaluationParams | None = None,
    frames: tuple[int, int] | None = None,
) -> Evaluation:
    """Score tracks against truth; ``to_json()`` of the result gives every figure by name.

    Args:
        tracks: a table, a file in any layout that ``planview evaluate`` reads, or the folder of a run.
        truth: a table, a file, or the folder of a recording with its ``truth.csv``.
        params: what counts as a match; the defaults when None.
        frames: first and last frame to score, both included; all when None.
    Raises:
        InputError: a file that cannot be read, or rows without what the matching needs.
        WorkError: alignment was asked for and is not possible.
    """
    if not isinstance(tracks, Trajectories):
        tracks = load_tracks(tracks_file(Path(tracks)))
    if not isinstance(truth, Trajectories):
        truth = load_truth(truth_file(Path(truth)) or Path(truth))
    return evaluate_tracks(tracks, truth, params, frames)
