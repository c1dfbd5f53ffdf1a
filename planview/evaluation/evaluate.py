"""All scores of tracks against truth: one call, one result."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from calib.doubt import Finding, Hypothesis
from calib.errors import InputError
from calib.params import Params
from calib.types import F64, I64, Bool
from planview.evaluation.align import FloorAlignment, align_tracks, move_tracks
from planview.evaluation.coverage import coverage, usual_step
from planview.evaluation.metrics import (
    ClearScores,
    Sequence,
    Similarity,
    box_similarity,
    build_sequence,
    clear_scores,
    floor_similarity,
)
from planview.evaluation.misfit import misfit
from planview.evaluation.places import with_places
from planview.evaluation.result import Evaluation, FacingErrors, TruthRows
from planview.evaluation.significant import (
    EVENT_S,
    PREDICTED,
    UNMATCHED,
    PersonHistory,
    PredictionHistory,
    TrackHistory,
    grouped_events,
    significant_errors,
    strict_identity_changes,
)
from planview.trajectories.ends import velocities
from planview.trajectories.file import warn_of
from planview.trajectories.state import SURE_FACING
from planview.trajectories.table import (
    IGNORED,
    Trajectories,
    frame_period_s,
    frame_step,
    ordinal,
    people_of,
    rows_by_id,
)

HEIGHTS_APART = 1.25
"""Ratio of median heights that no two ways to measure a body have (shoulders are 0.82 of it)."""
STRANGE = 0.1
"""A track with a smaller share of its rows near people of the truth is that of nobody there."""
WALKS_S = 2.0
"""And one that is longer and goes farther than this walks as people do: flickers do not (our choice)."""
WALKS_M = 1.0


class EvaluationParams(Params):
    """Rules for what counts as a match and which rows count."""

    gate_m: float = Field(0.5, gt=0, le=10)
    """Largest floor distance of a match [m]. A torso's width (Harville's W_avg, 0.4 m) and a margin."""
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


def evaluate_tracks(
    tracks: Trajectories,
    truth: Trajectories,
    params: EvaluationParams | None = None,
    frames: tuple[int, int] | None = None,
) -> Evaluation:
    """Score tracks against truth.

    Confirmed rows count. Tentative rows are not yet claimed and never count; lost rows are predictions: they match
    nothing and are no false positives, but a prediction within the gate keeps a hidden person from being a significant
    loss, and one that strays from its person for long is a significant error. Raises InputError: no row has what the
    matching needs (floor positions, or boxes). Raises WorkError: ``align`` is set, and no alignment is possible.

    Args:
        frames: first and last frame to score, both included; by default those that were tracked, or where that is not
            known, all with rows. A frame without truth rows is an empty scene, a frame without track rows one without
            detections; where most frames between those with truth rows have none, only some frames were annotated, and
            the others are left out.
    """
    params = params or EvaluationParams()
    first, last = frames or tracks.tracked or _frames_with_rows(tracks, truth)
    scored_tracks = tracks.where((tracks.frame >= first) & (tracks.frame <= last))
    scored_truth = truth.where((truth.frame >= first) & (truth.frame <= last))
    step = frame_step(np.unique(scored_truth.frame))
    if step > 1 and usual_step(scored_truth) <= step:  # of everybody
        result = _score_some_frames(scored_tracks, scored_truth, params)
    else:
        result = _score(scored_tracks, scored_truth, params, last - first + 1)
    return replace(result, cause=_cause(scored_tracks, truth, params, result))


def evaluate_named(
    tracks: Trajectories,
    truth: Trajectories,
    params: EvaluationParams,
    span: tuple[int, int] | None,
    names: tuple[str, str],
) -> Evaluation:
    """Score tracks against truth (``evaluate_tracks``), and warn of what does not fit together; ``names`` of the tracks
    and the truth. Raises InputError: tables without a common frame, or without what they are matched on."""
    if len(tracks) and len(truth):
        first = int(tracks.frame.min())
        last = int(tracks.frame.max())
        begin = int(truth.frame.min())
        end = int(truth.frame.max())
        if begin > last or end < first:
            expected = f"expected truth of the frames {first} to {last} of {names[0]}, found {begin} to {end}"
            cause = misfit(truth, tracks, params.match_on == "floor")
            raise InputError(f"{names[1]}: {expected}" + (f"; {cause}" if cause else ""))
    try:
        result = evaluate_tracks(tracks, truth, params, span)
    except InputError as error:
        raise error.about(f"{names[0]} and {names[1]}") from error
    warn_of("" if span else _beyond(tracks, truth))
    warn_of(result.doubts and f"{names[1]}: {result.doubts}")
    return result


def _beyond(tracks: Trajectories, truth: Trajectories) -> str:
    """A sentence on truth outside of the frames that were tracked; empty without any."""
    if tracks.tracked is not None:
        first, last = tracks.tracked
        remedy = "are left out"
        place = f"outside of the frames {first} to {last} that were tracked"
    else:
        first = 0
        last = int(tracks.frame.max(initial=0))
        remedy = f"count as misses, unless the frames are limited to 0:{last}"
        place = f"after the last track (frame {last})"
    beyond = np.count_nonzero((truth.frame < first) | (truth.frame > last))
    return f"{beyond} truth rows lie {place} and {remedy}" if beyond else ""


def _frames_with_rows(tracks: Trajectories, truth: Trajectories) -> tuple[int, int]:
    """First and last frame with rows in any table."""
    frames = np.concatenate([tracks.frame, truth.frame])
    return (int(frames.min()), int(frames.max())) if len(frames) else (0, -1)


def _score(tracks: Trajectories, truth: Trajectories, params: EvaluationParams, n_frames: int) -> Evaluation:
    """Scores of the rows of a number of frames, without what would explain them."""
    frame_s = frame_period_s(tracks, 1.0 / params.fps)
    on_floor = params.match_on == "floor"
    confirmed, predicted, people, alignment = _comparable(tracks, truth, params)
    covered = coverage(people, confirmed, on_floor, frame_s)
    judged = confirmed.where(covered.judged)
    similarity = floor_similarity(params.gate_m) if on_floor else box_similarity
    is_hidden, is_excused = _hidden_rows(people, judged, params.min_visible, similarity)
    counted = people.where(~is_hidden)
    followed = judged.where(~is_excused)
    sequence = build_sequence(counted, followed, similarity)
    clear = clear_scores(sequence)
    t, k = clear.matches.T
    persons = _person_histories(counted, followed, predicted, clear.matches, similarity)
    predictions = []
    if on_floor:
        predictions = _prediction_histories(predicted, people, followed.where(k), counted.where(t), params.gate_m)
    significant = significant_errors(persons, _track_histories(judged, is_excused, k), frame_s, predictions)
    share_world = on_floor or alignment is not None
    height_error_m = np.abs(followed.height_m[k] - counted.height_m[t])
    height_ratio = counted.height_m[t] / followed.height_m[k]
    velocity_mps = velocities(people, frame_s * people.frame.astype(np.float64))[~is_hidden][t]
    return Evaluation(
        sequence=sequence,
        clear=clear,
        rows=_truth_rows(counted, followed, clear.matches, share_world),
        ignored_rows=int(is_hidden.sum()),
        height_error_m=height_error_m[np.isfinite(height_error_m)],
        height_ratio=_median(height_ratio),
        facing=_facing_errors(followed.where(k if share_world else k[:0]), counted.where(t), velocity_mps),
        significant=significant,
        events=len(grouped_events(significant, EVENT_S / frame_s)),
        strict_identity_changes=strict_identity_changes(persons, frame_s),
        duration_s=n_frames * frame_s,
        tracked_people=len(people_of(followed, frame_s)),
        track_frames=len(np.unique(judged.frame)),
        covered_frames=len(np.intersect1d(judged.frame, people.frame)),
        alignment=alignment,
        unplaced_rows=len(truth) - len(people) + int((tracks.state == "confirmed").sum()) - len(confirmed),
        unjudged_rows=len(confirmed) - len(judged),
        limits=covered.limits,
        strangers=_strangers(sequence, clear, followed, frame_s) if on_floor else (),
    )


def _cause(tracks: Trajectories, truth: Trajectories, params: EvaluationParams, result: Evaluation) -> Finding | None:
    """The change that would make a bad score of confirmed rows good; ``truth`` with the rows of frames that were not
    scored, since their numbers may be what is wrong."""
    on_floor = params.match_on == "floor"
    truth = truth.where(truth.visible != IGNORED)
    tracks = tracks.where(tracks.state == "confirmed")
    if result.alignment is not None:
        tracks = move_tracks(tracks, result.alignment)
    explanation = misfit(truth.where(truth.visible >= params.min_visible), tracks, on_floor)
    if explanation is None and max(result.height_ratio, 1.0 / result.height_ratio) > HEIGHTS_APART:
        measured = f"they are {result.height_ratio:.3g} times those of the tracks"
        heights = "the truth's heights are of another unit or part of the body"
        return Finding(Hypothesis(heights, "convert them", lambda table: table), measured)
    return explanation


def _strangers(sequence: Sequence, clear: ClearScores, tracks: Trajectories, frame_s: float) -> tuple[int, ...]:
    """Indices of tracks that are near nobody all along and yet walk as people do."""
    matched = np.bincount(sequence.tracks[clear.matches[:, 1]], minlength=sequence.n_tracks)
    strangers = []
    for index, (_, rows) in enumerate(rows_by_id(tracks.track_id)):
        went_m = max(np.ptp(tracks.x_m[rows]), np.ptp(tracks.y_m[rows]))
        if matched[index] < STRANGE * len(rows) and len(rows) * frame_s > WALKS_S and went_m > WALKS_M:
            strangers.append(index)
    return tuple(strangers)


def _median(values: F64) -> float:
    """Median of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else math.nan


def _comparable(
    tracks: Trajectories, truth: Trajectories, params: EvaluationParams
) -> tuple[Trajectories, Trajectories, Trajectories, FloorAlignment | None]:
    """Confirmed and lost rows of tracks and the rows of the truth that have what is matched on, in one world frame."""
    on_floor = params.match_on == "floor"
    people = _rows_to_match(truth, on_floor, "truth")
    confirmed = _rows_to_match(tracks.where(tracks.state == "confirmed"), on_floor, "tracks")
    predicted = with_places(tracks.where(tracks.state == "lost"), on_floor)
    if not params.align:
        return confirmed, predicted, people, None
    confirmed, alignment = align_tracks(confirmed, people, params.gate_m)
    return confirmed, move_tracks(predicted, alignment), people, alignment


def _rows_to_match(table: Trajectories, on_floor: bool, what: str) -> Trajectories:
    """The rows with a place. Raises InputError: there are rows, and none has one."""
    rows = with_places(table, on_floor)
    if len(table) and not len(rows):
        need = "floor positions" if on_floor else "image boxes"
        remedy = "boxes=True" if on_floor and len(with_places(table, False)) else ""
        raise InputError(f"expected {what} with {need} to match on, found none", remedy=remedy)
    return rows


def _hidden_rows(
    people: Trajectories, tracks: Trajectories, min_visible: float, similarity: Similarity
) -> tuple[Bool, Bool]:
    """Masks of people who are too hidden to count, and of their tracks, which are neither false nor another's."""
    is_hidden = people.visible < min_visible
    is_theirs = np.zeros(len(tracks), dtype=np.bool_)
    if is_hidden.any():
        t, k = clear_scores(build_sequence(people, tracks, similarity)).matches.T
        is_theirs[k[is_hidden[t]]] = True
    return is_hidden, is_theirs


def _truth_rows(truth: Trajectories, tracks: Trajectories, matches: I64, share_world: bool) -> TruthRows:
    """Distance, visibility, company and match of every row of the truth, and its error in a world of both."""
    t, k = matches.T
    matched = np.zeros(len(truth), dtype=np.bool_)
    matched[t] = True
    error_m = np.full(len(truth), np.nan)
    if share_world:
        error_m[t] = np.hypot(tracks.x_m[k] - truth.x_m[t], tracks.y_m[k] - truth.y_m[t])
    _, frame_number, people = np.unique(truth.frame, return_inverse=True, return_counts=True)
    return TruthRows(np.hypot(truth.x_m, truth.y_m), truth.visible, people[frame_number], matched, error_m)


def _person_histories(
    truth: Trajectories, tracks: Trajectories, predicted: Trajectories, matches: I64, similarity: Similarity
) -> list[PersonHistory]:
    """The track that held each person in each frame, or that a lost track was predicted there."""
    holder = np.full(len(truth), UNMATCHED)
    rows = np.flatnonzero(np.isin(truth.frame, predicted.frame))
    near = clear_scores(build_sequence(truth.where(rows), predicted, similarity)).matches[:, 0]
    holder[rows[near]] = PREDICTED
    holder[matches[:, 0]] = tracks.track_id[matches[:, 1]]
    return [PersonHistory(person, truth.frame[rows], holder[rows]) for person, rows in rows_by_id(truth.track_id)]


def _track_histories(tracks: Trajectories, is_excused: Bool, matched: I64) -> list[TrackHistory]:
    """The rows of each track that are on nobody: neither excused nor, of the other rows, those that are matched."""
    stray = ~is_excused
    stray[np.flatnonzero(stray)[matched]] = False
    return [TrackHistory(track, tracks.frame[rows], stray[rows]) for track, rows in rows_by_id(tracks.track_id)]


def _score_some_frames(tracks: Trajectories, truth: Trajectories, params: EvaluationParams) -> Evaluation:
    """Scores in the frames that have truth rows, as if they followed one another."""
    annotated = np.unique(truth.frame)
    step = frame_step(annotated)
    is_annotated = np.isin(tracks.frame, annotated)
    kept = tracks.where(is_annotated)
    kept = replace(kept, frame=np.searchsorted(annotated, kept.frame))
    people = replace(truth, frame=np.searchsorted(annotated, truth.frame))
    fps = 1.0 / (frame_period_s(tracks, 1.0 / params.fps) * step)
    result = _score(kept, people, params.model_copy(update={"fps": fps}), len(annotated))
    unjudged = int(np.count_nonzero((tracks.state == "confirmed") & ~is_annotated))
    return replace(
        result,
        significant=[replace(error, frame=int(annotated[error.frame])) for error in result.significant],
        unjudged_rows=result.unjudged_rows + unjudged,
        limits=(f"it has rows in about every {ordinal(step)} frame only", *result.limits),
    )


def _prediction_histories(
    predicted: Trajectories, people: Trajectories, tracks: Trajectories, truth: Trajectories, gate_m: float
) -> list[PredictionHistory]:
    """Histories of all tracks that matched one of the people before they were lost; ``tracks`` and ``truth``: rows of
    the matches, side by side."""
    place_of = {key: row for row, key in enumerate(zip(people.frame.tolist(), people.track_id.tolist(), strict=True))}
    matched = dict(rows_by_id(tracks.track_id))
    histories = []
    for track, rows in rows_by_id(predicted.track_id):
        if track not in matched:
            continue
        last_match = np.searchsorted(tracks.frame[matched[track]], predicted.frame[rows]) - 1
        rows = rows[last_match >= 0]
        person = truth.track_id[matched[track]][last_match[last_match >= 0]]
        keys = zip(predicted.frame[rows].tolist(), person.tolist(), strict=True)
        at = np.array([place_of.get(key, -1) for key in keys], dtype=np.int64)
        away_m = np.hypot(predicted.x_m[rows] - people.x_m[at], predicted.y_m[rows] - people.y_m[at])
        histories.append(PredictionHistory(track, predicted.frame[rows], person, (at >= 0) & (away_m > gate_m)))
    return histories


def _facing_errors(tracks: Trajectories, truth: Trajectories, velocity_mps: F64) -> FacingErrors:
    """The errors of matched rows of tracks and truth, side by side, and (N, 2) velocities of the latter."""
    is_known = np.isfinite(tracks.facing_deg)
    facing_deg = tracks.facing_deg[is_known]
    vx, vy = velocity_mps[is_known].T
    is_sure = ~(tracks.facing_confidence[is_known] < SURE_FACING)
    to_truth = _angle_between(facing_deg, truth.facing_deg[is_known])
    to_walk = _angle_between(facing_deg, np.degrees(np.arctan2(vy, vx)))
    return FacingErrors(to_truth, to_walk, np.hypot(vx, vy), is_sure)


def _angle_between(a_deg: F64, b_deg: F64) -> F64:
    """(N,) differences of directions, 0 to 180 [deg]."""
    return np.abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)
