"""People as boxes in the image alone: the two stages of ByteTrack (Zhang et al. 2022) with a Kalman filter of boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.types import F64, I64, U8
from planview.tracking import body
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.lifecycle import Existence, LifeCycle
from planview.trajectories.boxes import Detections
from planview.trajectories.state import TrackState

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


class BoxTracker:
    """Follows the boxes of a detector without a camera.

    Boxes with a high score are matched to the predicted boxes of all tracks, then those with a low score to the
    confirmed tracks that are left and were seen in the frame before: a person who is being hidden gets a lower score
    before the box goes. What is left of the high scores starts tracks, which a second box confirms. A track without a
    box is not reported, since nothing can check where it is.

    Args:
        detections: boxes of every frame; every box counts as sure where they are not scored.
        edge: deviation of a box's centre and sides, as a share of its height.
    """

    foreground_columns: int | None = 80

    def __init__(self, detections: Detections, edge: float) -> None:
        self.detections, self._edge = detections, edge
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._cycle = LifeCycle()
        self._tracks: list[BoxTrack] = []

    @property
    def notes(self) -> tuple[str, ...]:
        """Whose boxes these are, in a sentence."""
        return (self.detections.summary,)

    def feedback(self) -> U8 | None:
        """No feedback: the boxes say nothing about pixels."""
        return None

    def debug(self) -> TrackerDebug:
        """Nothing but the boxes."""
        return TrackerDebug()

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._cycle.decisions

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track the boxes of one frame."""
        first = math.isnan(self._cycle.now_s)
        dt_s, boxes = self._cycle.begin(observation.timestamp_s), self.detections.at(observation.frame)
        score = boxes[:, 4] if self.detections.scored else np.ones(len(boxes))
        boxes = np.column_stack([boxes[:, :2] + boxes[:, 2:4] / 2, boxes[:, 2:4]])
        sure, unsure = (
            np.flatnonzero(score >= SURE_SCORE),
            np.flatnonzero((score >= LEAST_SCORE) & (score < SURE_SCORE)),
        )
        seen = [track.existence.observed for track in self._tracks]
        for track in self._tracks:
            track.predict(dt_s)
        if not self.detections.looked(observation.frame):
            return tuple(_state(track) for track in self._tracks if track.existence.observed)
        every = np.arange(len(self._tracks))
        found = self._match(every, boxes, sure, SURE_IOU)
        left = [i for i in every if i not in found and seen[i] and self._tracks[i].existence.confirmed]
        found |= self._match(np.array(left, dtype=np.int64), boxes, unsure, UNSURE_IOU)
        for i, track in enumerate(self._tracks):
            if i in found:
                self._cycle.observe(track.existence, f"score {score[found[i]]:.2f}", float(score[found[i]]))
                self._cycle.confirm(track.existence, "a second box")
                track.correct(boxes[found[i]], self._edge)
            else:
                self._cycle.miss(track.existence, "no box")
        for k in np.setdiff1d(sure[score[sure] >= NEW_SCORE], list(found.values())):
            self._start(boxes[k], float(score[k]), first)
        self._forget()
        return tuple(_state(track) for track in self._tracks if track.existence.observed)

    def _match(self, tracks: I64, boxes: F64, candidates: I64, least_iou: float) -> dict[int, int]:
        """The box of each track that gets one, by the largest sum of overlaps."""
        from scipy.optimize import linear_sum_assignment  # half a second

        predicted = np.array([self._tracks[i].box for i in tracks]).reshape(-1, 4)
        shared = overlaps(predicted, boxes[candidates])
        rows, cols = linear_sum_assignment(np.where(shared < least_iou, 0.0, shared), maximize=True)
        pairs = zip(rows, cols, strict=True)
        return {int(tracks[i]): int(candidates[k]) for i, k in pairs if shared[i, k] >= least_iou}

    def _start(self, box: F64, score: float, first: bool) -> None:
        existence = self._cycle.spawn(f"a box of nobody known, score {score:.2f}", score)
        if first:
            self._cycle.confirm(existence, "in the first frame")
        self._tracks.append(BoxTrack(existence, box, np.zeros(4), np.diag([self._edge**2, SPEED**2])))

    def _forget(self) -> None:
        kept = []
        for track in self._tracks:
            who = track.existence
            if who.observed or (who.confirmed and self._cycle.unobserved_s(who) <= LOST_S):
                kept.append(track)
            else:
                self._cycle.prune(who, f"no box for {self._cycle.unobserved_s(who):.1f} s")
        self._tracks = kept


def _state(track: BoxTrack) -> TrackState:
    u, v, width, height = track.box.tolist()
    box_px = (u - width / 2, v - height / 2, width, height)
    return TrackState(track.existence.track_id, track.existence.state, box_px=box_px)


def overlaps(boxes: F64, others: F64) -> F64:
    """(N, M) intersection over union of (N, 4) and (M, 4) boxes of centre and size [px]."""
    (a, size), (b, other) = (np.split(given[..., None, :], 2, axis=-1) for given in (boxes, others))
    b, other = b.swapaxes(0, 1), other.swapaxes(0, 1)
    common = np.minimum(a + size / 2, b + other / 2) - np.maximum(a - size / 2, b - other / 2)
    area = np.prod(np.maximum(common, 0.0), axis=-1)
    return np.asarray(area / (np.prod(size, axis=-1) + np.prod(other, axis=-1) - area), dtype=np.float64)
