"""People from the boxes of another program's detector: on the floor with a calibrated camera, or in the image."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from pydantic import Field

from calib.carried import Carried
from calib.ground_camera import GroundCamera
from calib.params import Params
from calib.types import F64, I64, U8
from planview.tracking import body, odds
from planview.tracking.base import Decision, Existence, LifeCycle, Needs, Observation, TrackerDebug
from planview.tracking.kalman import FloorKalman
from planview.tracking.matching import best_pairs, common_areas, overlaps
from planview.trajectories.detections import Detections
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
"""(8, 2) directions in which the rim of a body's cylinder is projected."""
BOX_FIT_STEPS = 6
HEIGHT_PRIOR = np.array([0.0, 0.0, 1 / body.HEIGHT_STD_M**2])
"""Information on x, y and height before a box is seen [1/m^2]."""
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
class DetectedPerson:
    """A person tracked on the floor.

    Attributes:
        existence: id and state.
        log_odds: of existence.
        kalman: place [m].
        height_m, height_var: of the person [m, m^2].
        box: (left, top, width, height) [px], where the person is now.
        foot: pixel of the place that the box belongs to.
    """

    existence: Existence
    log_odds: float
    kalman: FloorKalman
    height_m: float
    height_var: float
    box: F64
    foot: F64

    @property
    def bottom_px(self) -> float:
        """Row of the bottom of the box."""
        return float(self.box[1] + self.box[3])

    @property
    def probability(self) -> float:
        """Probability of existence."""
        return odds.probability(self.log_odds)

    def state(self, camera: GroundCamera) -> TrackState:
        """The person as reported, whose place is known as well as the camera."""
        left, top, width, height = self.box.tolist()
        motion = *self.kalman.at_m, *self.kalman.velocity_mps
        box_px = left, top, width, height
        std_m = camera.std_m(*self.kalman.at_m)
        return TrackState(self.existence.track_id, self.existence.state, *motion, self.height_m, box_px, std_m=std_m)


class PlacedBoxes(NamedTuple):
    """Boxes of people who stand on the floor.

    Attributes:
        boxes: (N, 5) left, top, width, height [px], score.
        poses: (N, 3) x, y, height [m].
        covariances: (N, 3, 3) of these.
        evidence: (N,) log-odds that the scores give.
    """

    boxes: F64
    poses: F64
    covariances: F64
    evidence: F64


P = TypeVar("P")


class _DetectionsTracker(Carried, Generic[P]):
    """Common part of the trackers of another program's boxes: the boxes, and no feedback about pixels."""

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
        """Source of the boxes, in a sentence."""
        return (self.detections.summary,)

    def study(self, observations: Iterable[Observation]) -> None:
        """Nothing to learn from images."""

    def feedback(self) -> U8 | None:
        """None: boxes do not label pixels."""
        return None

    def debug(self) -> TrackerDebug:
        """Nothing but the boxes."""
        return TrackerDebug()


class DetectionTracker(_DetectionsTracker[DetectedPerson]):
    """Boxes to people: the global nearest neighbour by likelihood, and existence by the Bernoulli filter.

    A box is explained by the cylinder of a standing body (least squares over its edges, with the heights of adults as
    prior), which gives place and height with their covariance. Existence follows Vo, Vo and Pham 2010 with one target
    each: a box is evidence by its likelihood over that of a false one, none is evidence against as far as the person
    is in view and not behind another.
    """

    RECORDS = DetectedPerson, Existence, FloorKalman

    def __init__(self, detections: Detections, params: DetectionParams, camera: GroundCamera) -> None:
        super().__init__(detections)
        self.params = params
        self.camera = camera

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track the boxes of one frame."""
        first = math.isnan(self._life.now_s)
        dt_s = self._life.begin(observation.timestamp_s)
        fresh = 1.0 if first else min(1.0, dt_s / ERRORS_S)
        placed = self._place_boxes(self.detections.at(observation.frame))
        for person in self._people:
            self._predict(person, dt_s)
        gains = self._gains(placed)
        matched = self._match(gains)
        if self.detections.is_searched(observation.frame):
            for i, person in enumerate(self._people):
                k = matched.get(i)
                if k is None:
                    self._miss(person, dt_s, fresh)
                else:
                    self._correct(person, placed, k, fresh, gains[i, k])
        self._add_newcomers(placed, set(matched.values()))
        self._forget_gone()
        return tuple(person.state(self.camera) for person in self._people)

    def _predict(self, person: DetectedPerson, dt_s: float) -> None:
        """Move a person on, and the box with it."""
        if not person.existence.observed:
            person.kalman = person.kalman.slow_down(dt_s, body.SLOW_DOWN_S)
        person.kalman = person.kalman.predict(dt_s, body.ACCELERATION_MPS2)
        foot = self._foot(person.kalman)
        if np.isfinite(foot).all():
            person.box[:2] += foot - person.foot
            person.foot = foot

    def _place_boxes(self, boxes: F64) -> PlacedBoxes:
        """Place boxes on the floor; those above the horizon are left out."""
        poses, covariances = self._fit_bodies(boxes)
        on_floor = np.flatnonzero(np.isfinite(poses).all(axis=1))
        boxes = boxes[on_floor]
        scores = np.clip(boxes[:, 4], 1e-6, 1 - 1e-6)
        evidence = np.clip(np.log(scores / (1 - scores)), -BOX_EVIDENCE_MAX, BOX_EVIDENCE_MAX)
        return PlacedBoxes(boxes, poses[on_floor], covariances[on_floor], evidence * self.detections.scored)

    def _fit_bodies(self, boxes: F64) -> tuple[F64, F64]:
        """(N, 3) x, y, height [m] of the standing bodies that fit boxes best, NaN where the feet are on no floor, and
        (N, 3, 3) covariances."""
        edges = np.column_stack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:4]])
        weight = self._edge_weights(boxes, edges)
        foot = np.column_stack([(edges[:, 0] + edges[:, 2]) / 2, edges[:, 3]])
        height_m = np.full(len(boxes), body.HEIGHT_MEAN_M)
        poses = np.column_stack([self.camera.back_project(foot), height_m])
        information = np.full((len(boxes), 3, 3), np.nan)
        good = np.asarray(np.isfinite(poses).all(axis=1), dtype=np.bool_)
        for _ in range(BOX_FIT_STEPS):
            expected, jacobian = self._edges_and_slopes(poses)
            good &= np.isfinite(expected).all(axis=1)
            good &= np.isfinite(jacobian).all(axis=(1, 2))
            weighted = np.where(good[:, None, None], jacobian * weight[:, :, None], 0.0)
            off = np.where(good[:, None], (edges - expected) * weight, 0.0)
            information, gradient = _normal_equations(weighted, off, poses[:, 2])
            step = np.linalg.solve(information, gradient)[..., 0]
            poses = poses + np.clip(step, -2.0, 2.0)
            poses[:, 2] = np.clip(poses[:, 2], body.HEIGHT_MIN_M, body.HEIGHT_MAX_M)
        covariances = np.linalg.inv(information) if len(boxes) else information
        return np.where(good[:, None], poses, np.nan), covariances

    def _edge_weights(self, boxes: F64, edges: F64) -> F64:
        """(N, 4) 1 / deviation of the edges of boxes [1/px]: arms and strides widen a box; an edge on the border of the
        image is not the person's."""
        std_px = self.params.edge * boxes[:, 3]
        limits = np.array([0, 0, self.camera.width - 1, self.camera.height - 1])
        inside = np.abs(edges - limits) > 2
        return np.asarray(inside / (std_px[:, None] * np.array([3.0, 1.0, 3.0, 1.0])))

    def _edges_and_slopes(self, poses: F64) -> tuple[F64, F64]:
        """(N, 4) edges of standing bodies [px], and (N, 4, 3) their derivatives by x, y and height."""
        edges = self._edges(poses)
        slopes = []
        for axis in np.eye(3):
            slopes.append((self._edges(poses + 0.01 * axis) - edges) / 0.01)
        return edges, np.stack(slopes, axis=-1)

    def _edges(self, poses: F64) -> F64:
        """(N, 4) left, top, right, bottom [px] of standing bodies."""
        rim = np.tile(body.TORSO.torso_radius_m * RING, (2, 1))
        heights = np.repeat([0.0, 1.0], len(RING))
        xy = rim + poses[:, None, :2]
        z = heights * poses[:, 2:3]
        pixels = self.camera.project(np.concatenate([xy, z[..., None]], axis=2))
        return np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)

    def _foot(self, kalman: FloorKalman) -> F64:
        return self.camera.project(np.array([*kalman.mean[:2], 0.0]))

    def _gains(self, placed: PlacedBoxes) -> F64:
        """(people, boxes) log-likelihood of each box of each person over that of a false one."""
        gains = np.empty((len(self._people), len(placed.boxes)))
        for i, person in enumerate(self._people):
            for k, pose in enumerate(placed.poses):
                gains[i, k] = self._gain(person, pose, placed.covariances[k])
        return gains + placed.evidence

    def _gain(self, person: DetectedPerson, pose: F64, covariance: F64) -> float:
        """Log-likelihood of a place and height of this person over that of a false box; -inf beyond the gate."""
        spread = person.kalman.covariance[:2, :2] + covariance[:2, :2]
        off = pose[:2] - person.kalman.mean[:2]
        far = float(off @ np.linalg.solve(spread, off))
        if far > GATE_CHI2:
            return -math.inf
        height_var = person.height_var + covariance[2, 2]
        taller = (pose[2] - person.height_m) ** 2 / height_var
        area_m2 = 2 * math.pi * math.sqrt(float(np.linalg.det(spread)))
        density = math.exp(-0.5 * (far + taller)) / area_m2
        ratio = self.params.found * density / self.params.false_per_m2
        return math.log(max(ratio, 1e-9))

    def _match(self, gains: F64) -> dict[int, int]:
        """Boxes of people, by the largest sum of gains and log-odds over having no box."""
        unseen = 1 - self.params.found
        without = [math.log(person.probability) - math.log(unseen) for person in self._people]
        gated = np.where(np.isfinite(gains), gains + np.array(without)[:, None], 0.0)
        return best_pairs(np.maximum(gated, 0.0))

    def _correct(self, person: DetectedPerson, placed: PlacedBoxes, k: int, fresh: float, gain: float) -> None:
        """Take in box k."""
        pose = placed.poses[k]
        covariance = placed.covariances[k]
        weight = max(fresh, 1e-3)
        person.kalman = person.kalman.correct(pose[:2], covariance[:2, :2] / weight)
        share = person.height_var / (person.height_var + float(covariance[2, 2]) / weight)
        person.height_m += share * (float(pose[2]) - person.height_m)
        person.height_var *= 1 - share
        person.box = placed.boxes[k, :4].copy()
        person.foot = self._foot(person.kalman)
        person.log_odds = min(person.log_odds + fresh * gain, body.LOG_ODDS_MAX)
        existence = f"existence {person.probability:.3f}"
        self._life.observe(person.existence, f"log-likelihood {gain:.1f} over a false box, {existence}", gain)
        if person.probability > self.params.report:
            self._life.confirm(person.existence, existence, person.probability)

    def _miss(self, person: DetectedPerson, dt_s: float, fresh: float) -> None:
        """Lower the existence of a person without a box by its chance to have left, and by how much of it should be
        seen."""
        nearer = []
        for other in self._people:
            if other is not person and other.bottom_px >= person.bottom_px:  # lower in the image is nearer
                nearer.append(other.box)
        image = np.array([[0.0, 0.0, *self.camera.size]])
        hidden = _largest_common_share(person.box, np.array(nearer).reshape(-1, 4))
        inside = _largest_common_share(person.box, image)
        away_s = body.LEAVE_S if inside < SAME_PERSON_IOU else self.params.stay_s
        person.log_odds = odds.survive(person.log_odds, dt_s, away_s)
        person.log_odds += fresh * math.log(1 - self.params.found * (1 - hidden) * inside)
        reason = f"no box, hidden {hidden:.2f}, existence {person.probability:.3f}"
        self._life.miss(person.existence, reason, person.probability)

    def _add_newcomers(self, placed: PlacedBoxes, taken: set[int]) -> None:
        """Follow the boxes of nobody, but one of those that show the same person."""
        boxes = placed.boxes[:, :4]
        same = overlaps(boxes, boxes) > SAME_PERSON_IOU
        for k, pose in enumerate(placed.poses):
            if k in taken or same[k, list(taken)].any():
                continue
            taken.add(k)
            covariance = placed.covariances[k]
            kalman = FloorKalman.from_measurement(pose[:2], covariance[:2, :2], body.SPEED_MAX_MPS / 2)
            log_odds = odds.log_odds(NEWCOMER_SHARE) + float(placed.evidence[k])
            existence = self._life.spawn(f"a box that shows nobody known, {pose[2]:.2f} m tall", log_odds)
            height_m = float(pose[2])
            height_var = float(covariance[2, 2])
            foot = self._foot(kalman)
            person = DetectedPerson(existence, log_odds, kalman, height_m, height_var, boxes[k].copy(), foot)
            self._people.append(person)

    def _forget_gone(self) -> None:
        """Stop following people who are hardly likely to be there."""
        kept = []
        for person in self._people:
            if person.probability < FORGOTTEN:
                self._life.prune(person.existence, f"existence {person.probability:.2f}", person.probability)
            else:
                kept.append(person)
        self._people = kept


def _normal_equations(weighted: F64, off: F64, heights_m: F64) -> tuple[F64, F64]:
    """(N, 3, 3) information and (N, 3, 1) gradient of least squares, with the heights of adults as prior.

    Args:
        weighted: (N, 4, 3) derivatives of the edges over their deviations.
        off: (N, 4) differences of the edges over their deviations.
    """
    transposed = weighted.transpose(0, 2, 1)
    information = transposed @ weighted + np.diag(HEIGHT_PRIOR) + 1e-6 * np.eye(3)
    pull = (body.HEIGHT_MEAN_M - heights_m)[:, None] * HEIGHT_PRIOR
    return information, (transposed @ off[..., None]) + pull[..., None]


def _largest_common_share(box: F64, others: F64) -> float:
    """Largest share of a box that one of (N, 4) others has in common with it."""
    return float(common_areas(box[None], others).max(initial=0.0) / (box[2] * box[3]))


SURE_SCORE = 0.6
NEW_SCORE = 0.7
LEAST_SCORE = 0.1
"""Scores from which a box is matched first, starts a track, and counts at all (Zhang et al. 2022, section 4.1)."""
SURE_IOU = 0.1
UNSURE_IOU = 0.2
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
        """The track as reported."""
        u, v, width, height = self.box.tolist()
        box_px = (u - width / 2, v - height / 2, width, height)
        return TrackState(self.existence.track_id, self.existence.state, box_px=box_px)

    def predict(self, dt_s: float) -> None:
        """Move on by dt_s with a random acceleration that is constant over it."""
        self.box = self.box + dt_s * self.velocity
        self.box[2:] = np.maximum(self.box[2:], 1.0)
        step = np.array([[1.0, dt_s], [0.0, 1.0]])
        push = ACCELERATION * np.array([0.5 * dt_s**2, dt_s])
        self.covariance = step @ self.covariance @ step.T + np.outer(push, push)

    def correct(self, box: F64, edge: float) -> None:
        """Take in a measured box; ``edge`` is its deviation in heights."""
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + edge**2)
        off = box - self.box
        self.box = self.box + gain[0] * off
        self.velocity = self.velocity + gain[1] * off
        self.covariance = self.covariance - np.outer(gain, self.covariance[0])


class BoxTracker(_DetectionsTracker[BoxTrack]):
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
        dt_s = self._life.begin(observation.timestamp_s)
        for track in self._people:
            track.predict(dt_s)
        if self.detections.is_searched(observation.frame):
            boxes = self.detections.at(observation.frame)
            scores = boxes[:, 4] if self.detections.scored else np.ones(len(boxes))
            taken = self._follow(boxes, scores)
            self._begin_tracks(boxes, scores, taken, first)
            self._end_tracks()
        return tuple(track.state for track in self._people if track.existence.observed)

    def _follow(self, boxes: F64, scores: F64) -> list[int]:
        """Match the boxes of a frame to the tracks in two stages; return the boxes of tracks."""
        sure = np.flatnonzero(scores >= SURE_SCORE)
        unsure = np.flatnonzero((scores >= LEAST_SCORE) & (scores < SURE_SCORE))
        matched = self._match(range(len(self._people)), boxes, sure, SURE_IOU)
        left = []
        for i, track in enumerate(self._people):
            if i not in matched and track.existence.observed and track.existence.confirmed:
                left.append(i)
        matched |= self._match(left, boxes, unsure, UNSURE_IOU)
        for i, track in enumerate(self._people):
            k = matched.get(i)
            if k is None:
                self._life.miss(track.existence, "no box")
                continue
            self._life.observe(track.existence, f"score {scores[k]:.2f}", float(scores[k]))
            self._life.confirm(track.existence, "a second box")
            track.correct(centre_and_size(boxes[k]), self._edge)
        return list(matched.values())

    def _match(self, tracks: Sequence[int], boxes: F64, candidates: I64, least_iou: float) -> dict[int, int]:
        """The box of each track that gets one, by the largest sum of overlaps."""
        predicted = np.array([self._people[i].state.box_px for i in tracks]).reshape(-1, 4)
        shared = overlaps(predicted, boxes[candidates, :4])
        pairs = best_pairs(np.where(shared < least_iou, 0.0, shared))
        return {tracks[i]: int(candidates[k]) for i, k in pairs.items()}

    def _begin_tracks(self, boxes: F64, scores: F64, taken: list[int], first: bool) -> None:
        """Begin tracks with the boxes of a high score that are left; in the ``first`` frame they are people."""
        for k in np.setdiff1d(np.flatnonzero(scores >= NEW_SCORE), taken):
            existence = self._life.spawn(f"a box of nobody known, score {scores[k]:.2f}", float(scores[k]))
            if first:
                self._life.confirm(existence, "in the first frame")
            covariance = np.diag([self._edge**2, SPEED**2])
            self._people.append(BoxTrack(existence, centre_and_size(boxes[k]), np.zeros(4), covariance))

    def _end_tracks(self) -> None:
        """End tentative tracks without a box, and others that have been without for long."""
        kept = []
        for track in self._people:
            existence = track.existence
            gone_s = self._life.unobserved_s(existence)
            if not existence.observed and (not existence.confirmed or gone_s > LOST_S):
                self._life.prune(existence, f"no box for {gone_s:.1f} s")
            else:
                kept.append(track)
        self._people = kept


def centre_and_size(box: F64) -> F64:
    """Centre, width and height of a box left, top, width, height."""
    return np.concatenate([box[:2] + box[2:4] / 2, box[2:4]])
