"""People in the view of one camera: the automata of Zhang et al. 2008, section 4, the match of equation 1, and
newcomers: where the foreground that nobody explains would be explained by one more person."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import cv2
import numpy as np

from calib.types import F32, F64, I32, I64, U8
from planview.maps.view import BACKGROUND_SEEN
from planview.tracking import body
from planview.tracking.explain.births import EVIDENCE_MAX
from planview.tracking.explain.explanation import Owned, People, about, upright
from planview.tracking.explain.person import BORN_LOG_ODDS, Person
from planview.tracking.human_model.explanation import PATCH_PX, HumanModelParams, MaskExplanation
from planview.tracking.human_model.model_map import HumanModelMap

Motion = Literal["moving", "stopped", "stationary"]
Stability = Literal["appearing", "disappearing", "occlusion", "stable"]
Posture = Literal["standing", "sitting"]
OVERLAP = 0.15
"""R_overlap from which a person is in occlusion."""
PLACES_MAX = 4
"""Places that are tried in a frame."""
CORE_WIDTH = 0.7
"""Part of a hull's width in which the residual is summed: the rest is between arms and next to the head."""
BANDS = 6
"""A hull is summed in this many boxes above each other: bodies lean in the images of wide lenses."""
PLACE_STD_M = 0.5
"""How far the place of a newcomer may be from where its residual is strongest [m]."""
BIRTH_PX, BIRTH_SHARE = 30.0, 0.625
"""Least height of newcomers [px], and as a share of that of people in the middle of the image, where this is less: a
head of 3 px does not distinguish a person from a bag, but a camera is pointed at people."""


class ModelMatch(NamedTuple):
    """How a hull matches the blobs that it touches (equation 1)."""

    recall: float = 0.0
    precision: float = 0.0
    overlap: float = 0.0

    @property
    def score(self) -> float:
        """M = R_recall + R_precision - R_overlap."""
        return self.recall + self.precision - self.overlap


NO_MATCH = ModelMatch()


@dataclass(eq=False)
class Walker(Person):
    """A person followed by one camera.

    Attributes:
        head_in_view: always True: people seen in part are not searched for (``birth_visible``).
        motion, stability: the two automata.
        posture: as the height implies it.
        match: of the last frame.
        observed: whether enough of the person was visible in the last frame.
        trail: time [s], place [m] and visible share of the body in the recent past, oldest first.
    """

    head_in_view: bool = True
    motion: Motion = "moving"
    stability: Stability = "appearing"
    posture: Posture = "standing"
    match: ModelMatch = NO_MATCH
    observed: bool = True
    trail: deque[tuple[float, float, float, float]] = field(default_factory=lambda: deque(maxlen=256))

    def judge(self, now_s: float, moving: float, params: HumanModelParams) -> None:
        """Advance the automata; ``moving`` is the share of the body in motion between two frames."""
        p, trail, (x_m, y_m), visible = params, self.trail, self.at_m, self.share * self.inside
        trail.append((now_s, x_m, y_m, visible))
        while len(trail) > 2 and trail[1][0] <= now_s - p.window_s:
            trail.popleft()
        since_s, from_x_m, from_y_m, visible_then = trail[0]
        way = math.hypot(x_m - from_x_m, y_m - from_y_m)
        walks = way > p.moving_mps * max(now_s - since_s, 0.5 * p.window_s)
        self.motion = "moving" if walks else ("stopped" if moving >= p.internal_motion else "stationary")
        change = visible - visible_then
        if self.match.overlap >= OVERLAP:
            self.stability = "occlusion"
        elif abs(change) >= p.trend:
            self.stability = "appearing" if change > 0 else "disappearing"
        else:
            self.stability = "stable"
        self.posture = "sitting" if self.height_m < 0.5 * (1.0 + p.sitting) * self.tall_m else "standing"


def matches(hulls: Sequence[F64 | None], surface: U8) -> list[ModelMatch]:
    """Matches of hulls (K, 2) [px] with a (H, W) mask of foreground; None where a hull has no outline."""
    if not hulls:
        return []
    # Statistics of all regions take eight times as long as the regions.
    n, labels = cv2.connectedComponents((surface > 0).view(np.uint8), connectivity=8)
    masks = np.zeros((len(hulls), *surface.shape), np.uint8)
    for mask, hull in zip(masks, hulls, strict=True):
        if hull is not None and np.isfinite(hull).all():
            cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
    areas = np.bincount(labels.reshape(-1), minlength=n)
    shared = np.bincount(labels[masks.sum(axis=0, dtype=np.uint8) > 1], minlength=n)
    scores = []
    for mask in masks:
        own = np.bincount(labels[mask > 0], minlength=n)
        inner = own[1:].sum()
        touched = np.flatnonzero(own[1:] > 0.1 * inner) + 1
        blob = max(1, areas[touched].sum())
        parts = own[touched].sum() / blob, inner / max(1, own.sum()), shared[touched].sum() / blob
        scores.append(ModelMatch(*map(float, parts)))
    return scores


class FloorPlaces:
    """Where newcomers are looked for: entries of the model map with enough of a person in view."""

    def __init__(self, model_map: HumanModelMap, visible: float, patch_m: float) -> None:
        camera = model_map.camera
        boxes = model_map.boxes()
        middle = model_map.entry_at(np.array([0.5 * camera.width, 0.5 * camera.height]))
        usual = boxes[middle, 2:].max() if middle >= 0 else np.inf
        keep = model_map.visibility >= visible
        keep &= boxes[:, 2:].max(axis=1) >= min(BIRTH_PX, BIRTH_SHARE * usual)
        boxes = boxes[keep]
        self.floor_m: F32 = model_map.floor_m[keep]
        self.floor_m2 = float(len(np.unique(np.rint(self.floor_m), axis=0)))
        limits = np.array([camera.width, camera.height] * 2)
        corners = np.concatenate([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]], axis=1)
        self.boxes: I32 = np.clip(np.rint(corners), 0, limits).astype(np.int32)
        self.bands: I32 = np.clip(np.rint(_bands(model_map.hull_px[keep])), 0, limits).astype(np.int32)
        self._around: I32 = np.concatenate([self.bands[..., :2].min(axis=1), self.bands[..., 2:].max(axis=1)], axis=1)
        # Depth along the optical axis of the middle of the body [m].
        drop = camera.height_m - 0.5 * model_map.model.height_m
        depth = self.floor_m[:, 1] * math.sin(camera.tilt_rad) + drop * math.cos(camera.tilt_rad)
        patch_px = np.maximum(camera.focal_px * patch_m / depth, PATCH_PX)
        self.scale: F32 = (1.0 / patch_px**2).astype(np.float32)

    def scores(self, frame: MaskExplanation, people: People, owned: Owned, least: float) -> tuple[I64, F64]:
        """Places where one more person would gain at least ``least``, and roughly how much [log-odds of pixels].

        Args:
            owned: the foreground, as ``people`` own it.
        """
        residual = frame.residual(owned)
        # Background only takes away from what foreground gains.
        found = np.flatnonzero(self.scale * _sums(residual, self._around) >= least)
        if len(found):
            low, high = self._around[found, :2].min(axis=0), self._around[found, 2:].max(axis=0)
            near = np.zeros(frame.kind.shape, np.bool_)
            near[low[1] : high[1], low[0] : high[0]] = True
            seen = np.flatnonzero(near & (frame.kind == BACKGROUND_SEEN))
            residual = residual + frame.residual(frame.owned(0, people, seen))
        scores = _sums(residual, self.bands[found]).sum(axis=1)
        good = scores * self.scale[found] >= least
        return found[good], scores[good]


def _sums(image: F32, boxes: I32) -> F64:
    """(...) sums of an image (H, W) in boxes (..., 4) left, top, right, bottom."""
    left, top, right, bottom = np.moveaxis(boxes, -1, 0)
    total = np.asarray(cv2.integral(image, sdepth=cv2.CV_64F), dtype=np.float64)
    sums = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    return np.where((right > left) & (bottom > top), sums, 0.0)


def _bands(hull_px: F32) -> F64:
    """(N, BANDS, 4) left, top, right, bottom [px] of the cores of (N, K, 2) convex hulls, from the head down."""
    ends = np.linspace(hull_px[..., 1].min(1), hull_px[..., 1].max(1), BANDS + 1, axis=1)
    middle = 0.5 * (ends[:, :-1] + ends[:, 1:])[..., None]
    (x, y), (to_x, to_y) = np.moveaxis(hull_px[:, None], -1, 0), np.moveaxis(np.roll(hull_px, -1, 1)[:, None], -1, 0)
    crosses = (y <= middle) != (to_y <= middle)
    at = x + (middle - y) / np.where(crosses, to_y - y, 1.0) * (to_x - x)
    left, right = np.where(crosses, at, np.inf).min(-1), np.where(crosses, at, -np.inf).max(-1)
    centre, half = 0.5 * (left + right), 0.5 * CORE_WIDTH * (right - left)
    return np.stack([centre - half, ends[:, :-1], centre + half, ends[:, 1:]], axis=-1)


def births(
    places: FloorPlaces, frame: MaskExplanation, known: People, owned: Owned, now_s: float, params: HumanModelParams
) -> tuple[list[Walker], F64]:
    """People who are born in this frame, without ids, and (N, 5) poses of those known, who may be better elsewhere.

    Tries one more person wherever the residual is strongest.
    """
    found, scores = places.scores(frame, known, owned, 0.5 * params.birth_evidence)
    born, boxes, n_known = [], places.boxes[found], len(known.poses)
    middle = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    for _ in range(PLACES_MAX if len(found) else 0):
        best = int(np.argmax(scores))
        if scores[best] <= 0.0:
            break
        size = boxes[best, 2:] - boxes[best, :2]
        scores[(np.abs(middle - middle[best]) < 0.5 * size).all(axis=1)] = 0.0
        newcomer = _try(places.floor_m[found[best]].astype(np.float64), frame, known, now_s, params)
        if newcomer is not None:
            born.append(newcomer)
            known = known.with_one(newcomer.pose)
    return born, known.poses[:n_known]


def sitting(pose: F64, camera_m: float, share: float) -> F64:
    """(5,) somebody who sits, with the head on the same ray as that of somebody who stands at a pose."""
    height_m = share * pose[2]
    nearer = max(camera_m - height_m, 0.1) / max(camera_m - pose[2], 0.1)
    return np.array([*(nearer * pose[:2]), height_m, *pose[3:]])


def _try(place: F64, frame: MaskExplanation, known: People, now_s: float, p: HumanModelParams) -> Walker | None:
    """A newcomer at a place, if the evidence for one is strong enough; a rival who accounts for it is moved there."""
    start = upright((*place, body.HEIGHT_MEAN_M))
    people, n = known.with_one(start), len(known.poses)
    tall, ratios = people.tall[n], people.ratios[n]
    fits = []
    # A head alone may be a sitter's, or that of somebody who stands farther away.
    for posture in (start, sitting(start, float(frame.views[0].rays.centre_m[2]), p.sitting)):
        people.poses[n] = posture
        others, s = np.flatnonzero(frame.touching(people.poses)[n, :n]), frame.around(posture, PLACE_STD_M)
        s.layer(people, others)
        value, curvature = s.ascend(people.poses[n], posture, about(PLACE_STD_M, body.HEIGHT_STD_M), tall, ratios)
        fits.append((value, people.poses[n].copy(), curvature, s, others))
    evidence, pose, curvature, samples, others = max(fits, key=lambda fit: fit[0])
    people.poses[n] = pose
    rival = int(frame.rivals(people, np.append(np.ones(n), 0.0))[n]) if evidence > 0.0 else -1
    if rival >= 0:
        strong = evidence >= p.birth_evidence
        evidence, alone, gain = frame.pair(n, rival, people, refit=True)
        if evidence >= p.birth_evidence:
            known.poses[rival], pose = people.poses[rival], people.poses[n]
            samples.layer(people, others)
        elif strong and gain > p.birth_evidence:
            known.poses[rival] = alone
    mine, seen, _ = samples.visible(pose, tall, ratios).tolist()
    if evidence < p.birth_evidence or mine < 0.25 * seen:
        return None
    log_odds = BORN_LOG_ODDS + 0.25 * min(evidence, EVIDENCE_MAX)
    person = Walker.born(pose, *samples.noise(pose, curvature), log_odds, now_s)
    person.evidence, person.share = evidence, mine / max(seen, 1e-6)
    return person
