"""People from the boxes of another program's detector: placed on the floor by a calibrated camera, or in the image."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from pydantic import Field

from calib.carried import Carried
from calib.ground_camera import GroundCamera
from calib.params import Params
from calib.types import F64, I64, U8
from planview.tracking import body
from planview.tracking.base import Decision, Existence, LifeCycle, Needs, Observation, TrackerDebug
from planview.tracking.kalman import FloorKalman
from planview.trajectories.boxes import Detections
from planview.trajectories.state import TrackState

FORGOTTEN = 0.05
"""Probability of existence below which a person is forgotten."""
GATE_CHI2 = 13.8
"""Squared distance in deviations beyond which a box shows somebody else: one in a thousand (chi-square, 2 axes)."""
SAME_PERSON_IOU = 0.5
"""Overlap (IoU) from which two boxes of a frame show one person, as of every evaluation of boxes."""
BOX_EVIDENCE_MAX = 3.0
"""Largest log-odds that a score gives: detectors are surer than they are right."""
RING = np.array([(math.cos(a), math.sin(a)) for a in np.linspace(0, 2 * np.pi, 8, endpoint=False)])
BOX_FIT_STEPS = 6
NEWCOMER_SHARE = 0.3
"""Share of people among boxes that show nobody known."""
ERRORS_S = 0.25
"""Time for which a detector's errors stay the same [s]."""


class DetectionParams(Params):
    """Tracking of another program's boxes; our choices where there is no reference."""

    found: float = Field(0.8, gt=0, lt=1)
    """Probability that a person in full view has a box."""
    false_per_m2: float = Field(0.01, gt=0, le=10)
    """False boxes per square metre of floor and frame: one in 100 square metres."""
    edge: float = Field(0.05, gt=0.001, le=1)
    """Deviation of a box's edges, as a share of its height."""
    stay_s: float = Field(10.0, gt=0.1, le=3600)
    """Mean time that a hidden person stays [s]."""
    report: float = Field(0.98, gt=0.5, lt=1)
    """Probability of existence from which a person is confirmed."""


@dataclass(slots=True, eq=False)
class Detected:
    """Somebody tracked.

    Attributes:
        who: id and state.
        log_odds: of existence.
        kalman: place [m].
        height_m, height_var: of the person [m, m^2].
        box: (left, top, width, height) [px], where the person is now.
        foot: pixel of the place that the box belongs to.
    """

    who: Existence
    log_odds: float
    kalman: FloorKalman
    height_m: float
    height_var: float
    box: F64
    foot: F64

    @property
    def existence(self) -> float:
        """Probability of existence."""
        return 1.0 / (1.0 + math.exp(-self.log_odds))


P = TypeVar("P")


class _OfDetections(Carried, Generic[P]):
    """What the trackers of another program's boxes have in common: the boxes, and nothing to say about pixels."""

    CARRIED = "_life", "_people"
    needs: Needs = "image"
    foreground_columns: int | None = 80

    def __init__(self, detections: Detections) -> None:
        self.detections = detections
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._life = LifeCycle()
        self._people: list[P] = []

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._life.decisions

    @property
    def notes(self) -> tuple[str, ...]:
        """Whose boxes these are, in a sentence."""
        return (self.detections.summary,)

    def study(self, observations: Iterable[Observation]) -> None:
        """Nothing to learn from images."""

    def feedback(self) -> U8 | None:
        """No feedback: the boxes say nothing about pixels."""
        return None

    def debug(self) -> TrackerDebug:
        """Nothing but the boxes."""
        return TrackerDebug()


class DetectionTracker(_OfDetections[Detected]):
    """Boxes to people: the global nearest neighbour by likelihood, and existence by the Bernoulli filter.

    A box is explained by the cylinder of a standing body (least squares over its edges, with the heights of adults as
    prior), which gives place and height with their covariance. Existence follows Vo, Vo and Pham 2010 with one target
    each: a box is evidence by its likelihood over that of a false one, none is evidence against as far as the person
    is in view and not behind another.
    """

    RECORDS = Detected, Existence, FloorKalman

    def __init__(self, detections: Detections, params: DetectionParams, camera: GroundCamera) -> None:
        super().__init__(detections)
        self.params, self.camera = params, camera

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track the boxes of one frame."""
        first = math.isnan(self._life.now_s)
        dt_s = self._life.begin(observation.timestamp_s)
        fresh = 1.0 if first else min(1.0, dt_s / ERRORS_S)
        boxes = self.detections.at(observation.frame)
        poses, covariances = self._placed(boxes)
        placed = np.flatnonzero(np.isfinite(poses).all(axis=1))
        boxes, poses, covariances = boxes[placed], poses[placed], covariances[placed]
        scores = np.clip(boxes[:, 4], 1e-6, 1 - 1e-6)
        evidence = np.clip(np.log(scores / (1 - scores)), -BOX_EVIDENCE_MAX, BOX_EVIDENCE_MAX) * self.detections.scored
        for q in self._people:
            if not q.who.observed:
                q.kalman = q.kalman.slowed(dt_s, body.SLOW_DOWN_S)
            q.kalman = q.kalman.predicted(dt_s, body.ACCELERATION_MPS2)
            foot = self._foot(q.kalman)
            if np.isfinite(foot).all():
                q.box[:2] += foot - q.foot
                q.foot = foot
        gains = np.array([[self._gain(q, z, c) for z, c in zip(poses, covariances, strict=True)] for q in self._people])
        gains = gains.reshape(len(self._people), len(boxes)) + evidence
        # By the largest sum of gains and beliefs over having no box.
        known = np.array([math.log(q.existence) - math.log(1 - self.params.found) for q in self._people])
        matched = best_pairs(np.maximum(np.where(np.isfinite(gains), gains + known[:, None], 0.0), 0.0))
        for i, q in enumerate(self._people if self.detections.looked(observation.frame) else ()):
            if i in matched:
                k = matched[i]
                self._found(q, boxes[k], poses[k], covariances[k], fresh, gains[i, k])
            else:
                self._missed(q, dt_s, fresh)
        taken, same = set(matched.values()), overlaps(boxes[:, :4], boxes[:, :4]) > SAME_PERSON_IOU
        for k in range(len(boxes)):
            if k not in taken and not same[k, list(taken)].any():
                self._meet(boxes[k], poses[k], covariances[k], float(evidence[k]))
                taken.add(k)
        for q in [q for q in self._people if q.existence < FORGOTTEN]:
            self._life.prune(q.who, f"existence {q.existence:.2f}", q.existence)
            self._people.remove(q)
        return tuple(self._state(q) for q in self._people)

    def _placed(self, boxes: F64) -> tuple[F64, F64]:
        """(N, 3) x, y, height [m] of boxes, NaN of those on no floor, and (N, 3, 3) covariances."""
        std_px = self.params.edge * boxes[:, 3]
        edges = np.column_stack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:4]])
        foot = np.column_stack([(edges[:, 0] + edges[:, 2]) / 2, edges[:, 3]])
        poses = np.column_stack([self.camera.back_project(foot), np.full(len(boxes), body.HEIGHT_MEAN_M)])
        # An edge on the border of the image is not the person's; arms and strides widen a box.
        limits = np.array([0, 0, self.camera.width - 1, self.camera.height - 1])
        own = np.abs(edges - limits) > 2
        weight = own / (std_px[:, None] * np.array([3.0, 1.0, 3.0, 1.0]))
        prior = np.diag([0.0, 0.0, 1 / body.HEIGHT_STD_M**2])
        information = np.full((len(boxes), 3, 3), np.nan)
        good = np.asarray(np.isfinite(poses).all(axis=1), dtype=np.bool_)
        for _ in range(BOX_FIT_STEPS):
            expected = self._edges(poses)
            jacobian = np.stack([(self._edges(poses + 0.01 * axis) - expected) / 0.01 for axis in np.eye(3)], axis=-1)
            good = good & np.asarray(np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(expected).all(axis=1))
            weighted = np.where(good[:, None, None], jacobian * weight[:, :, None], 0.0)
            information = weighted.transpose(0, 2, 1) @ weighted + prior + 1e-6 * np.eye(3)
            off = np.where(good[:, None], (edges - expected) * weight, 0.0)
            pull = (body.HEIGHT_MEAN_M - poses[:, 2])[:, None] * np.diagonal(prior)
            step = np.linalg.solve(information, (weighted.transpose(0, 2, 1) @ off[..., None]) + pull[..., None])
            poses = poses + np.clip(step[..., 0], -2.0, 2.0)
            poses[:, 2] = np.clip(poses[:, 2], body.HEIGHT_MIN_M, body.HEIGHT_MAX_M)
        return np.where(good[:, None], poses, np.nan), np.linalg.inv(information) if len(boxes) else information

    def _edges(self, poses: F64) -> F64:
        """(N, 4) left, top, right, bottom [px] of standing bodies."""
        radius = body.TORSO.torso_radius_m
        around = np.concatenate([np.tile(radius * RING, (2, 1)), np.repeat([[0.0], [1.0]], len(RING), axis=0)], axis=1)
        points = around + np.concatenate([poses[:, None, :2], np.zeros((len(poses), 1, 1))], axis=2)
        points[..., 2] = around[:, 2] * poses[:, 2:3]
        pixels = self.camera.project(points)
        return np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)

    def _foot(self, kalman: FloorKalman) -> F64:
        return self.camera.project(np.array([*kalman.mean[:2], 0.0]))

    def _gain(self, q: Detected, pose: F64, covariance: F64) -> float:
        """Log-likelihood of a box of this person over that of a false one; -inf beyond the gate."""
        spread = q.kalman.covariance[:2, :2] + covariance[:2, :2]
        off = pose[:2] - q.kalman.mean[:2]
        far = float(off @ np.linalg.solve(spread, off))
        taller = (pose[2] - q.height_m) ** 2 / (q.height_var + covariance[2, 2])
        if far > GATE_CHI2:
            return -math.inf
        density = math.exp(-0.5 * (far + taller)) / (2 * math.pi * math.sqrt(float(np.linalg.det(spread))))
        return math.log(max(self.params.found * density / self.params.false_per_m2, 1e-9))

    def _found(self, q: Detected, box: F64, pose: F64, covariance: F64, fresh: float, gain: float) -> None:
        p = self.params
        weight = max(fresh, 1e-3)
        q.kalman = q.kalman.corrected(pose[:2], covariance[:2, :2] / weight)
        share = q.height_var / (q.height_var + float(covariance[2, 2]) / weight)
        q.height_m, q.height_var = q.height_m + share * (float(pose[2]) - q.height_m), (1 - share) * q.height_var
        q.box, q.foot = box[:4].copy(), self._foot(q.kalman)
        q.log_odds = min(q.log_odds + fresh * gain, body.LOG_ODDS_MAX)
        self._life.observe(q.who, f"log-likelihood {gain:.1f} over a false box, existence {q.existence:.3f}", gain)
        if q.existence > p.report:
            self._life.confirm(q.who, f"existence {q.existence:.3f}", q.existence)

    def _missed(self, q: Detected, dt_s: float, fresh: float) -> None:
        """No box: survival, and evidence against as far as the person should be seen."""
        p = self.params
        foot = q.box[1] + q.box[3]  # lower in the image is nearer
        nearer = np.array([o.box for o in self._people if o is not q and o.box[1] + o.box[3] >= foot]).reshape(-1, 4)
        hidden, inside = (
            float(common(q.box[None], boxes).max(initial=0.0) / (q.box[2] * q.box[3]))
            for boxes in (nearer, np.array([[0.0, 0.0, *self.camera.size]]))
        )
        away_s = body.LEAVE_S if inside < SAME_PERSON_IOU else p.stay_s
        stays = q.existence * math.exp(-dt_s / away_s)
        q.log_odds = math.log(max(stays, 1e-6) / max(1 - stays, 1e-6))
        q.log_odds += fresh * math.log(1 - p.found * (1 - hidden) * inside)
        self._life.miss(q.who, f"no box, hidden {hidden:.2f}, existence {q.existence:.3f}", q.existence)

    def _meet(self, box: F64, pose: F64, covariance: F64, evidence: float) -> None:
        kalman = FloorKalman.measured(pose[:2], covariance[:2, :2], body.SPEED_MAX_MPS / 2)
        odds = math.log(NEWCOMER_SHARE / (1 - NEWCOMER_SHARE)) + evidence
        who = self._life.spawn(f"a box that shows nobody known, {pose[2]:.2f} m tall", odds)
        height_m, height_var = float(pose[2]), float(covariance[2, 2])
        self._people.append(Detected(who, odds, kalman, height_m, height_var, box[:4].copy(), self._foot(kalman)))

    def _state(self, q: Detected) -> TrackState:
        (x, y, vx, vy), (left, top, width, height) = q.kalman.mean.tolist(), q.box.tolist()
        return TrackState(q.who.track_id, q.who.state, x, y, vx, vy, q.height_m, (left, top, width, height))


def best_pairs(worth: F64) -> dict[int, int]:
    """Columns of rows, each at most once, by the largest sum of (N, M) worth from 0 on; none where there is none."""
    from scipy.optimize import linear_sum_assignment  # half a second

    pairs = zip(*linear_sum_assignment(worth, maximize=True), strict=True)
    return {int(i): int(k) for i, k in pairs if worth[i, k] > 0.0}


def common(boxes: F64, others: F64) -> F64:
    """(N, M) area [px^2] that (N, 4) and (M, 4) boxes left, top, width, height share."""
    first, second = np.maximum(boxes[:, None, :2], others[None, :, :2]), boxes[:, None, :2] + boxes[:, None, 2:]
    return np.asarray(np.prod(np.maximum(np.minimum(second, others[:, :2] + others[:, 2:]) - first, 0.0), axis=-1))


def overlaps(boxes: F64, others: F64) -> F64:
    """(N, M) intersection over union of (N, 4) and (M, 4) boxes left, top, width, height [px]."""
    shared = common(boxes, others)
    return np.asarray(shared / (np.prod(boxes[:, 2:], axis=1)[:, None] + np.prod(others[:, 2:], axis=1) - shared))


SURE_SCORE, NEW_SCORE, LEAST_SCORE = 0.6, 0.7, 0.1
"""Scores from which a box is matched first, starts a track, and counts at all (Zhang et al. 2022, section 4.1)."""
SURE_IOU, UNSURE_IOU = 0.1, 0.2
"""Least overlap with a track's predicted box in the first and in the second stage: walkers at 7 frames per second move
by their own breadth, and the whole assignment decides, not a pair alone."""
LOST_S = 1.0
"""A track without a box is kept for this long [s] (30 frames at 30 per second)."""
ACCELERATION = body.ACCELERATION_MPS2 / body.HEIGHT_MEAN_M
"""Deviation of the acceleration of a box's centre and sides [heights/s^2]."""
SPEED = 0.5 * body.SPEED_MAX_MPS / body.HEIGHT_MEAN_M
"""Deviation of a new box's speed [heights/s]."""


@dataclass(slots=True, eq=False)
class BoxTrack:
    """A box that moves with constant velocity.

    Attributes:
        existence: id and state.
        box, velocity: (4,) float64 centre and size u, v, width, height [px], and their change [px/s].
        covariance: (2, 2) float64 of position and velocity of each of the four, in heights and seconds.
    """

    existence: Existence
    box: F64
    velocity: F64
    covariance: F64

    @property
    def state(self) -> TrackState:
        u, v, width, height = self.box.tolist()
        box_px = (u - width / 2, v - height / 2, width, height)
        return TrackState(self.existence.track_id, self.existence.state, box_px=box_px)

    def predict(self, dt_s: float) -> None:
        """Move on by dt with a random acceleration that is constant over dt."""
        self.box = self.box + dt_s * self.velocity
        self.box[2:] = np.maximum(self.box[2:], 1.0)
        step, push = np.array([[1.0, dt_s], [0.0, 1.0]]), ACCELERATION * np.array([0.5 * dt_s**2, dt_s])
        self.covariance = step @ self.covariance @ step.T + np.outer(push, push)

    def correct(self, box: F64, edge: float) -> None:
        """Take in a measured box; ``edge`` is its deviation in heights."""
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + edge**2)
        off = box - self.box
        self.box, self.velocity = self.box + gain[0] * off, self.velocity + gain[1] * off
        self.covariance = self.covariance - np.outer(gain, self.covariance[0])


class BoxTracker(_OfDetections[BoxTrack]):
    """Follows the boxes of a detector without a camera: the two stages of ByteTrack (Zhang et al. 2022) with a Kalman
    filter of boxes.

    Boxes with a high score are matched to the predicted boxes of all tracks, then those with a low score to the
    confirmed tracks that are left and were seen in the frame before: a person who is being hidden gets a lower score
    before the box goes. What is left of the high scores starts tracks, which a second box confirms. A track without a
    box is not reported, since nothing can check where it is.

    Args:
        detections: boxes of every frame; every box counts as sure where they are not scored.
        edge: deviation of a box's centre and sides, as a share of its height.
    """

    RECORDS = BoxTrack, Existence

    def __init__(self, detections: Detections, edge: float) -> None:
        super().__init__(detections)
        self._edge = edge

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track the boxes of one frame."""
        first = math.isnan(self._life.now_s)
        dt_s, boxes = self._life.begin(observation.timestamp_s), self.detections.at(observation.frame)
        score = boxes[:, 4] if self.detections.scored else np.ones(len(boxes))
        sure = np.flatnonzero(score >= SURE_SCORE)
        unsure = np.flatnonzero((score >= LEAST_SCORE) & (score < SURE_SCORE))
        seen = [track.existence.observed for track in self._people]
        for track in self._people:
            track.predict(dt_s)
        if not self.detections.looked(observation.frame):
            return tuple(track.state for track in self._people if track.existence.observed)
        every = range(len(self._people))
        found = self._match(every, boxes, sure, SURE_IOU)
        left = [i for i in every if i not in found and seen[i] and self._people[i].existence.confirmed]
        found |= self._match(left, boxes, unsure, UNSURE_IOU)
        for i, track in enumerate(self._people):
            if i in found:
                self._life.observe(track.existence, f"score {score[found[i]]:.2f}", float(score[found[i]]))
                self._life.confirm(track.existence, "a second box")
                track.correct(centred(boxes[found[i]]), self._edge)
            else:
                self._life.miss(track.existence, "no box")
        for k in np.setdiff1d(sure[score[sure] >= NEW_SCORE], list(found.values())):
            who = self._life.spawn(f"a box of nobody known, score {score[k]:.2f}", float(score[k]))
            if first:
                self._life.confirm(who, "in the first frame")
            motion = np.zeros(4), np.diag([self._edge**2, SPEED**2])
            self._people.append(BoxTrack(who, centred(boxes[k]), *motion))
        for track in list(self._people):
            who = track.existence
            gone_s = self._life.unobserved_s(who)
            if not who.observed and (not who.confirmed or gone_s > LOST_S):
                self._life.prune(who, f"no box for {gone_s:.1f} s")
                self._people.remove(track)
        return tuple(track.state for track in self._people if track.existence.observed)

    def _match(self, tracks: Sequence[int], boxes: F64, candidates: I64, least_iou: float) -> dict[int, int]:
        """The box of each track that gets one, by the largest sum of overlaps."""
        predicted = np.array([self._people[i].state.box_px for i in tracks]).reshape(-1, 4)
        shared = overlaps(predicted, boxes[candidates, :4])
        pairs = best_pairs(np.where(shared < least_iou, 0.0, shared))
        return {tracks[i]: int(candidates[k]) for i, k in pairs.items()}


def centred(box: F64) -> F64:
    """Centre, width and height of a box left, top, width, height."""
    return np.concatenate([box[:2] + box[2:4] / 2, box[2:4]])
