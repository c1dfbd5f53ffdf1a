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
from planview.evaluation.align import FloorAlignment, align_tracks, moved
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
from planview.evaluation.misfit import GOOD, fit, misfit, shift_between
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
from planview.trajectories.ends import track_numbers
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

SHIFTED = 0.85
"""Share of the error that a shift must get below: with less gain both may count frames alike."""
HEIGHTS_APART = 1.25
"""Ratio of median heights that no two ways to measure a body have (shoulders are 0.82 of it)."""
STRANGE = 0.1
"""A track with a smaller share of its rows near people of the truth is that of nobody there."""
WALKS_S = 2.0
"""And one that is longer and goes farther than this walks as people do: flickers do not (our choice)."""
WALKS_M = 1.0
STEP_S = 0.25
"""Time before and after, between which the velocity of the truth is measured [s]. Half a stride, so that
the sway of a walker cancels."""


class EvaluationParams(Params):
    """What counts as a match and which rows count."""

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
    whole = truth
    frames = frames or tracks.tracked or _frames_with_rows(tracks, truth)
    tracks, truth = (t.where((t.frame >= frames[0]) & (t.frame <= frames[1])) for t in (tracks, truth))
    step = frame_step(np.unique(truth.frame))
    if step > 1 and usual_step(truth) <= step:  # of everybody
        result = _of_some_frames(tracks, truth, params)
    else:
        result = _scores(tracks, truth, params, frames)
    return replace(result, cause=_cause(tracks, whole, params, result))


def _frames_with_rows(*tables: Trajectories) -> tuple[int, int]:
    """First and last frame with rows in any table."""
    seen = np.concatenate([table.frame for table in tables])
    return (int(seen.min()), int(seen.max())) if len(seen) else (0, -1)


def _scores(tracks: Trajectories, truth: Trajectories, params: EvaluationParams, frames: tuple[int, int]) -> Evaluation:
    """Scores of rows in these frames, without what would explain them."""
    frame_s = frame_period_s(tracks, 1.0 / params.fps)
    on_floor = params.match_on == "floor"
    confirmed, predicted, people, alignment = _comparable(tracks, truth, params)
    covered = coverage(people, confirmed, on_floor, frame_s)
    claimed = confirmed.where(covered.judged)
    similarity = floor_similarity(params.gate_m) if on_floor else box_similarity
    ignored, excused = _ignored(people, claimed, params.min_visible, similarity)
    counted = people.where(~ignored)
    followed = claimed.where(~excused)
    sequence = build_sequence(counted, followed, similarity)
    clear = clear_scores(sequence)
    matches = clear.matches
    t, k = matches.T
    persons = _person_histories(counted, followed, predicted, matches, similarity)
    histories = _track_histories(claimed, excused, k)
    predictions = (
        _prediction_histories(predicted, people, followed, counted, matches, params.gate_m) if on_floor else []
    )
    significant = significant_errors(persons, histories, frame_s, predictions)
    placed = on_floor or alignment is not None  # else the world frames may differ
    facing_deg = followed.facing_deg[k] if placed else np.full(len(k), np.nan)
    heights = np.abs(followed.height_m[k] - counted.height_m[t])
    height_ratios = counted.height_m[t] / followed.height_m[k]
    return Evaluation(
        sequence=sequence,
        clear=clear,
        rows=_truth_rows(counted, followed, matches, placed),
        ignored_rows=int(ignored.sum()),
        height_error_m=heights[np.isfinite(heights)],
        height_ratio=_median(height_ratios),
        facing=facing_errors(
            facing_deg, followed.facing_confidence[k], counted.where(t), velocities(people, frame_s)[~ignored][t]
        ),
        significant=significant,
        events=len(grouped_events(significant, EVENT_S / frame_s)),
        strict_identity_changes=strict_identity_changes(persons, frame_s),
        duration_s=(frames[1] - frames[0] + 1) * frame_s,
        tracked_people=len(people_of(followed, frame_s)),
        track_frames=len(np.unique(claimed.frame)),
        covered_frames=len(np.intersect1d(claimed.frame, people.frame)),
        alignment=alignment,
        shift=_shift(counted, followed, similarity, on_floor),
        unplaced_rows=len(truth) - len(people) + int((tracks.state == "confirmed").sum()) - len(confirmed),
        unjudged_rows=len(confirmed) - len(claimed),
        limits=covered.limits,
        strangers=_strangers(sequence, clear, followed, frame_s) if on_floor else (),
    )


def _cause(tracks: Trajectories, truth: Trajectories, params: EvaluationParams, result: Evaluation) -> Finding | None:
    """What would make a bad score of confirmed rows good; ``truth`` with the rows of frames that were not scored, since
    their numbers may be what is wrong."""
    on_floor = params.match_on == "floor"
    truth = truth.where(truth.visible != IGNORED)
    tracks = tracks.where(tracks.state == "confirmed")
    if result.alignment is not None:
        tracks = moved(tracks, result.alignment)
    is_hidden = truth.visible < params.min_visible
    hidden = truth.where(is_hidden)
    if 2 * len(hidden) > len(truth) and fit(hidden, tracks, on_floor) >= GOOD:
        return Finding(
            Hypothesis("the truth's column visible does not hold the share that is seen", "correct it", _as_it_is),
            f"{len(hidden)} of {len(truth)} rows are too hidden to count, and yet most are near a track",
        )
    if explained := misfit(truth.where(~is_hidden), tracks, on_floor):
        return explained
    if not max(result.height_ratio, 1.0 / result.height_ratio) > HEIGHTS_APART:
        return None
    return Finding(
        Hypothesis("the truth's heights are of another unit or part of the body", "convert them", _as_it_is),
        f"they are {result.height_ratio:.3g} times those of the tracks",
    )


def _as_it_is(table: Trajectories) -> Trajectories:
    return table


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
    """Median of the known values; NaN without any."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def _comparable(
    tracks: Trajectories, truth: Trajectories, params: EvaluationParams
) -> tuple[Trajectories, Trajectories, Trajectories, FloorAlignment | None]:
    """Confirmed and lost rows of tracks and the rows of the truth that have what is matched on, in one world frame."""
    on_floor = params.match_on == "floor"
    usable = _usable(tracks, on_floor)
    claimed, predicted = (tracks.where(usable & (tracks.state == state)) for state in ("confirmed", "lost"))
    people = _checked(truth, on_floor, "truth")
    if not len(claimed) and (tracks.state == "confirmed").any():
        _checked(tracks.where(tracks.state == "confirmed"), on_floor, "tracks")
    if not params.align:
        return claimed, predicted, people, None
    claimed, alignment = align_tracks(claimed, people, params.gate_m)
    return claimed, moved(predicted, alignment), people, alignment


def _ignored(
    people: Trajectories, tracks: Trajectories, min_visible: float, similarity: Similarity
) -> tuple[Bool, Bool]:
    """Which people are too hidden to count, and which tracks are theirs: neither false nor given to another person."""
    ignored = people.visible < min_visible
    theirs = np.zeros(len(tracks), dtype=np.bool_)
    if ignored.any():
        matches = clear_scores(build_sequence(people, tracks, similarity)).matches
        theirs[matches[ignored[matches[:, 0]], 1]] = True
    return ignored, theirs


def _truth_rows(truth: Trajectories, tracks: Trajectories, matches: I64, placed: bool) -> TruthRows:
    """Distance, visibility, company and match of every row of the truth; ``placed`` where positions may be compared."""
    t, k = matches.T
    matched = np.zeros(len(truth), dtype=np.bool_)
    away = np.full(len(truth), np.nan)
    matched[t] = True
    if placed:
        away[t] = np.hypot(tracks.x_m[k] - truth.x_m[t], tracks.y_m[k] - truth.y_m[t])
    _, where, together = np.unique(truth.frame, return_inverse=True, return_counts=True)
    return TruthRows(np.hypot(truth.x_m, truth.y_m), truth.visible, together[where], matched, away)


def _person_histories(
    truth: Trajectories, tracks: Trajectories, predicted: Trajectories, matches: I64, similarity: Similarity
) -> list[PersonHistory]:
    """Which track held each person in each frame, or whether a lost track was predicted there."""
    rows = np.flatnonzero(np.isin(truth.frame, predicted.frame))
    near = clear_scores(build_sequence(truth.where(rows), predicted, similarity)).matches[:, 0]
    holder = np.full(len(truth), UNMATCHED)
    holder[rows[near]] = PREDICTED
    holder[matches[:, 0]] = tracks.track_id[matches[:, 1]]
    return [PersonHistory(i, truth.frame[own], holder[own]) for i, own in rows_by_id(truth.track_id)]


def _track_histories(tracks: Trajectories, excused: Bool, matched: I64) -> list[TrackHistory]:
    """Where each track is on nobody: neither excused nor of the other rows those that are matched."""
    stray = ~excused
    stray[np.flatnonzero(stray)[matched]] = False
    return [TrackHistory(i, tracks.frame[rows], stray[rows]) for i, rows in rows_by_id(tracks.track_id)]


def _of_some_frames(tracks: Trajectories, truth: Trajectories, params: EvaluationParams) -> Evaluation:
    """Scores in the frames that have truth rows, as if they followed one another."""
    annotated = np.unique(truth.frame)
    period_s = frame_period_s(tracks, 1.0 / params.fps) * frame_step(annotated)
    own = tracks.where(np.isin(tracks.frame, annotated))
    scored, known = (replace(t, frame=np.searchsorted(annotated, t.frame)) for t in (own, truth))
    result = _scores(scored, known, params.model_copy(update={"fps": 1.0 / period_s}), (0, len(annotated) - 1))
    claimed = tracks.where(tracks.state == "confirmed").frame
    left_out = claimed[~np.isin(claimed, annotated)]
    return replace(
        result,
        significant=[replace(error, frame=int(annotated[error.frame])) for error in result.significant],
        unjudged_rows=result.unjudged_rows + len(left_out),
        limits=(f"it has rows in about every {ordinal(frame_step(annotated))} frame only", *result.limits),
        shift=0,
    )


def _shift(truth: Trajectories, tracks: Trajectories, similarity: Similarity, on_floor: bool) -> int:
    """The shift of the tracks [frames] that most pairs of near rows vote for; 0 unless with it most rows are near a
    track, and their median error is below SHIFTED of that without it."""

    def error(shift: int) -> float:
        pairs = build_sequence(truth, replace(tracks, frame=tracks.frame + shift), similarity)
        nearest = np.zeros(pairs.truth_rows)
        np.maximum.at(nearest, pairs.pair_truth, pairs.similarity)
        return 1.0 - float(np.median(nearest[nearest > 0])) if nearest.any() else 1.0

    shift = shift_between(truth, tracks, on_floor)
    if not shift or fit(truth, replace(tracks, frame=tracks.frame + shift), on_floor) < GOOD:
        return 0
    return shift if error(shift) < SHIFTED * error(0) else 0


def _prediction_histories(
    predicted: Trajectories,
    people: Trajectories,
    tracks: Trajectories,
    truth: Trajectories,
    matches: I64,
    gate_m: float,
) -> list[PredictionHistory]:
    """Of all tracks that matched one of the (all) people before they were lost; ``matches``: of ``tracks`` and
    ``truth``."""
    ids = np.unique(people.track_id)
    place = people.frame * len(ids) + np.searchsorted(ids, people.track_id)
    order = np.argsort(place)
    t, k = matches.T
    matched = dict(rows_by_id(tracks.track_id[k]))
    histories = []
    for track, rows in rows_by_id(predicted.track_id):
        if track not in matched:
            continue
        then = np.searchsorted(tracks.frame[k[matched[track]]], predicted.frame[rows]) - 1
        rows = rows[then >= 0]
        then = then[then >= 0]
        person = truth.track_id[t[matched[track]]][then]
        keys = predicted.frame[rows] * len(ids) + np.searchsorted(ids, person)
        at = order[np.searchsorted(place, keys, sorter=order).clip(max=len(order) - 1)]
        away = np.hypot(predicted.x_m[rows] - people.x_m[at], predicted.y_m[rows] - people.y_m[at])
        histories.append(PredictionHistory(track, predicted.frame[rows], person, (place[at] == keys) & (away > gate_m)))
    return histories


def facing_errors(facing_deg: F64, confidence: F64, truth: Trajectories, velocity_mps: F64) -> FacingErrors:
    """The errors of matches; (N,) facing of tracks and its confidence, the truth rows that they match, and (N, 2)
    velocities of these."""
    known = np.isfinite(facing_deg)
    facing, (vx, vy) = facing_deg[known], velocity_mps[known].T
    to_truth, to_walk = (
        np.abs((facing - other + 180.0) % 360.0 - 180.0)
        for other in (truth.facing_deg[known], np.degrees(np.arctan2(vy, vx)))
    )
    return FacingErrors(to_truth, to_walk, np.hypot(vx, vy), ~(confidence[known] < SURE_FACING))


def velocities(table: Trajectories, frame_s: float) -> F64:
    """(N, 2) velocities of the rows of a table [m/s], from places STEP_S before and after; NaN for a single row."""
    velocity = np.full((len(table), 2), np.nan)
    for _, rows in rows_by_id(track_numbers(table, table.frame.astype(np.float64) * frame_s)):
        times = table.frame[rows] * frame_s
        before = np.maximum(times - STEP_S, times[0])
        after = np.minimum(times + STEP_S, times[-1])
        span = np.where(after > before, after - before, np.nan)
        for axis, place in enumerate((table.x_m[rows], table.y_m[rows])):
            velocity[rows, axis] = (np.interp(after, times, place) - np.interp(before, times, place)) / span
    return velocity


def _usable(table: Trajectories, on_floor: bool) -> Bool:
    """(N,) whether rows have what is matched on."""
    needed = np.column_stack([table.x_m, table.y_m]) if on_floor else table.box_px
    return np.asarray(np.isfinite(needed).all(axis=1))


def _checked(table: Trajectories, on_floor: bool, what: str) -> Trajectories:
    good = _usable(table, on_floor)
    if len(table) and not good.any():
        need = "floor positions" if on_floor else "image boxes"
        remedy = "boxes=True" if on_floor and _usable(table, False).any() else ""
        raise InputError(f"expected {what} with {need} to match on, found none", remedy=remedy)
    return table.where(good)
