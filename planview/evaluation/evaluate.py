"""All scores of tracks against truth: one call, one result."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from pydantic import Field

from calib.errors import InputError
from calib.params import Params
from calib.types import F64, I64, AnyArray, Bool
from planview.evaluation.align import FloorAlignment, align_tracks, moved
from planview.evaluation.clear import ClearScores, clear_scores
from planview.evaluation.hota import HotaScores, hota_scores
from planview.evaluation.identity import IdentityScores, identity_scores
from planview.evaluation.sequence import Similarity, box_similarity, build_sequence, floor_similarity
from planview.evaluation.significant import (
    PREDICTED,
    UNMATCHED,
    ErrorKind,
    PersonHistory,
    SignificantError,
    SignificantParams,
    TrackHistory,
    frame_period_s,
    significant_errors,
)
from planview.trajectories.table import Trajectories

KINDS: tuple[ErrorKind, ...] = ("lost", "missed", "swapped", "false_track")


class EvaluationParams(Params):
    """What counts as a match and which rows count."""

    gate_m: float = Field(0.5, gt=0, le=10)
    """Largest floor distance of a match [m]. Our choice: a torso's width (Harville's W_avg, 0.4 m) and a margin."""
    match_on: Literal["floor", "boxes"] = "floor"
    """Floor distance within the gate, or image boxes at IoU 0.5 (the usual protocol of image benchmarks)."""
    min_visible: float = Field(0.25, ge=0, le=1)
    """Truth rows less visible than this are ignored: neither a miss nor, for the track on them, a false positive.
    Harville 2002, section 5, leaves out what the camera cannot see; the fraction is our choice: less than a head and
    shoulders of a person (about a quarter of the silhouette)."""
    align: bool = False
    """Lay the tracks over the truth with a rigid motion of the floor first (other world frame)."""
    fps: float = Field(30.0, gt=0, le=1000)
    """Frame rate where the tracks carry no timestamps [1/s]; only durations of significant errors need it."""
    significant: SignificantParams = SignificantParams()
    """From when on an error is significant."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of one run.

    Attributes:
        truth_rows, ignored_rows: truth rows that count, and that are too little visible.
        track_rows: confirmed rows that count (those on ignored people do not).
        clear, identity, hota: the three families.
        position_error_m: (K,) floor distance of every match whose positions are known; none for boxes without
            alignment, since the world frames may then differ.
        height_error_m: (K,) absolute height difference of every match whose heights are known.
        significant: errors in the order of frames.
        alignment: the motion applied, if asked for.
    """

    truth_rows: int
    ignored_rows: int
    track_rows: int
    clear: ClearScores
    identity: IdentityScores
    hota: HotaScores
    position_error_m: F64
    height_error_m: F64
    significant: list[SignificantError]
    alignment: FloorAlignment | None

    def to_json(self) -> dict[str, Any]:
        """The ``--json`` object of ``planview evaluate``; a score that the data cannot give is null."""
        by_kind = Counter(error.kind for error in self.significant)
        return {
            "truth_rows": self.truth_rows,
            "mota": self.clear.mota,
            "motp_m": _mean(self.position_error_m),
            "idf1": self.identity.idf1,
            "hota": self.hota.hota,
            "switches": self.clear.switches,
            "misses": self.clear.misses,
            "false_positives": self.clear.false_positives,
            "position_error_mean_m": _mean(self.position_error_m),
            "position_error_std_m": float(self.position_error_m.std()) if len(self.position_error_m) else None,
            "height_error_mean_m": _mean(self.height_error_m),
            "significant_errors": {"total": len(self.significant), **{kind: by_kind[kind] for kind in KINDS}},
            "significant_error_list": [asdict(error) for error in self.significant],
            "ignored_rows": self.ignored_rows,
            "track_rows": self.track_rows,
            "matches": len(self.clear.matches),
            "deta": self.hota.deta,
            "assa": self.hota.assa,
            "alignment": _alignment_json(self.alignment),
        }


def evaluate_tracks(
    tracks: Trajectories,
    truth: Trajectories,
    params: EvaluationParams | None = None,
    frames: tuple[int, int] | None = None,
) -> Evaluation:
    """Score tracks against truth.

    Confirmed rows count. Tentative rows are not yet claimed and never count; lost rows are predictions: they
    match nothing and are no false positives, but a prediction within the gate keeps a hidden person from being a
    significant loss.

    Args:
        tracks, truth: as read from their files.
        frames: first and last frame to score, both included; all by default. A frame without truth rows is an
            empty scene, a frame without track rows one without detections.
    Raises:
        InputError: no row has what the matching needs (floor positions, or boxes).
        WorkError: alignment was asked for and is not possible.
    """
    params = params or EvaluationParams()
    tracks, truth = _within(tracks, frames), _within(truth, frames)
    frame_s = frame_period_s(tracks.frame, tracks.timestamp_s, 1.0 / params.fps)
    usable = _has_boxes if params.match_on == "boxes" else _has_floor
    claimed, predicted = _rows_of(tracks, "confirmed", usable), _rows_of(tracks, "lost", usable)
    people = _checked(truth, usable, params.match_on, "truth")
    if not len(claimed) and (tracks.state == "confirmed").any():
        _checked(tracks.where(tracks.state == "confirmed"), usable, params.match_on, "tracks")
    alignment = None
    if params.align:
        claimed, alignment = align_tracks(claimed, people, params.gate_m)
        predicted = moved(predicted, alignment)
    return _score(claimed, predicted, people, alignment, frame_s, params)


def _score(
    claimed: Trajectories,
    predicted: Trajectories,
    people: Trajectories,
    alignment: FloorAlignment | None,
    frame_s: float,
    params: EvaluationParams,
) -> Evaluation:
    similarity = box_similarity if params.match_on == "boxes" else floor_similarity(params.gate_m)
    ignored = people.visible < params.min_visible
    # Hidden people take their own tracks first, so that these are neither false nor given to another person.
    joint = clear_scores(build_sequence(people, claimed, similarity)).matches
    excused = np.zeros(len(claimed), dtype=np.bool_)
    excused[joint[ignored[joint[:, 0]], 1]] = True
    truth, tracks = people.where(~ignored), claimed.where(~excused)
    sequence = build_sequence(truth, tracks, similarity)
    clear = clear_scores(sequence)
    stray = ~excused
    stray[np.flatnonzero(~excused)[clear.matches[:, 1]]] = False
    persons = _person_histories(truth, tracks, clear.matches, _near_prediction(truth, predicted, similarity))
    histories = [
        TrackHistory(int(i), claimed.frame[claimed.track_id == i], stray[claimed.track_id == i])
        for i in np.unique(claimed.track_id)
    ]
    t, k = clear.matches.T
    apart = np.hypot(tracks.x_m[k] - truth.x_m[t], tracks.y_m[k] - truth.y_m[t])
    return Evaluation(
        len(truth),
        int(ignored.sum()),
        len(tracks),
        clear,
        identity_scores(sequence),
        hota_scores(sequence),
        _known(apart) if params.match_on == "floor" or alignment is not None else np.empty(0),
        _known(np.abs(tracks.height_m[k] - truth.height_m[t])),
        significant_errors(persons, histories, frame_s, params.significant),
        alignment,
    )


def _person_histories(truth: Trajectories, tracks: Trajectories, matches: I64, near: Bool) -> list[PersonHistory]:
    holder = np.where(near, PREDICTED, UNMATCHED)
    holder[matches[:, 0]] = tracks.track_id[matches[:, 1]]
    return [
        PersonHistory(int(i), truth.frame[truth.track_id == i], holder[truth.track_id == i])
        for i in np.unique(truth.track_id)
    ]


def _near_prediction(truth: Trajectories, predicted: Trajectories, similarity: Similarity) -> Bool:
    """(N,) whether a lost track is predicted at each true person."""
    near = np.zeros(len(truth), dtype=np.bool_)
    near[clear_scores(build_sequence(truth, predicted, similarity)).matches[:, 0]] = True
    return near


def _within(table: Trajectories, frames: tuple[int, int] | None) -> Trajectories:
    return table if frames is None else table.where((table.frame >= frames[0]) & (table.frame <= frames[1]))


def _has_floor(table: Trajectories) -> Bool:
    return np.isfinite(table.x_m) & np.isfinite(table.y_m)


def _has_boxes(table: Trajectories) -> Bool:
    return np.asarray(np.isfinite(table.box_px).all(axis=1))


def _rows_of(table: Trajectories, state: str, usable: Callable[[Trajectories], Bool]) -> Trajectories:
    return table.where((table.state == state) & usable(table))


def _checked(table: Trajectories, usable: Callable[[Trajectories], Bool], match_on: str, what: str) -> Trajectories:
    good = usable(table)
    if len(table) and not good.any():
        need = "image boxes" if match_on == "boxes" else "floor positions"
        raise InputError(f"expected {what} with {need} to match on, found rows without them")
    return table.where(good)


def _known(values: AnyArray) -> F64:
    return np.asarray(values[np.isfinite(values)], dtype=np.float64)


def _mean(values: F64) -> float | None:
    return float(values.mean()) if len(values) else None


def _alignment_json(alignment: FloorAlignment | None) -> dict[str, float] | None:
    if alignment is None:
        return None
    return {
        "rotation_deg": math.degrees(alignment.rotation_rad),
        "x_m": alignment.x_m,
        "y_m": alignment.y_m,
        "rms_m": alignment.rms_m,
        "pairs": alignment.pairs,
    }
