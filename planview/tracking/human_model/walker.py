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

from calib.ground_camera import GroundCamera
from calib.types import F32, F64, I32, I64, U8
from planview.maps.view import BACKGROUND_SEEN
from planview.tracking import body
from planview.tracking.explain.explanation import Owners, People, loose_prior, upright_pose
from planview.tracking.explain.person import Glimpse, Person
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
"""Standard deviation of a newcomer's place from where its residual is strongest [m]."""
BIRTH_PX = 30.0
BIRTH_SHARE = 0.625
"""Least height of newcomers [px], and as a share of that of people in the middle of the image, where this is less: a
head of 3 px does not distinguish a person from a bag, but a camera is pointed at people."""


class ModelMatch(NamedTuple):
    """Match of a hull with the blobs that it touches (equation 1)."""

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
        motion, stability: the two automata.
        posture: as the height implies it.
        match: of the last frame.
        observed: enough of the person was visible in the last frame.
        trail: time [s], place [m] and visible share of the body in the recent past, oldest first.
    """

    motion: Motion = "moving"
    stability: Stability = "appearing"
    posture: Posture = "standing"
    match: ModelMatch = NO_MATCH
    observed: bool = True
    trail: deque[tuple[float, float, float, float]] = field(default_factory=lambda: deque(maxlen=256))

    def judge(self, now_s: float, moving_share: float, params: HumanModelParams) -> None:
        """Advance the automata; ``moving_share`` of the body is in motion between two frames."""
        x_m, y_m = self.at_m
        visible = self.glimpse.visible_share * self.glimpse.inside_share
        self.trail.append((now_s, x_m, y_m, visible))
        while len(self.trail) > 2 and self.trail[1][0] <= now_s - params.window_s:
            self.trail.popleft()
        since_s, from_x_m, from_y_m, visible_then = self.trail[0]
        way_m = math.hypot(x_m - from_x_m, y_m - from_y_m)
        if way_m > params.moving_mps * max(now_s - since_s, 0.5 * params.window_s):
            self.motion = "moving"
        else:
            self.motion = "stopped" if moving_share >= params.internal_motion else "stationary"
        change = visible - visible_then
        if self.match.overlap >= OVERLAP:
            self.stability = "occlusion"
        elif abs(change) >= params.trend:
            self.stability = "appearing" if change > 0 else "disappearing"
        else:
            self.stability = "stable"
        between_m = 0.5 * (1.0 + params.sitting) * self.identity.stature.mean_m
        self.posture = "sitting" if self.height_m < between_m else "standing"

    @property
    def states(self) -> str:
        """The automata and the posture in words."""
        return f"{self.posture}, {self.motion}, {self.stability}"


def match_hulls(hulls: Sequence[F64 | None], surface: U8) -> list[ModelMatch]:
    """Match hulls (K, 2) [px] with a (H, W) mask of foreground; None where a hull has no outline."""
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
    matches = []
    for mask in masks:
        covered = np.bincount(labels[mask > 0], minlength=n)
        foreground = covered[1:].sum()
        touched = np.flatnonzero(covered[1:] > 0.1 * foreground) + 1
        blob = max(1, areas[touched].sum())
        recall = float(covered[touched].sum() / blob)
        precision = float(foreground / max(1, covered.sum()))
        matches.append(ModelMatch(recall, precision, float(shared[touched].sum() / blob)))
    return matches


class FloorPlaces:
    """Places where newcomers are looked for: entries of the model map with enough of a person in view.

    Attributes:
        floor_m: (N, 2) float32 places.
        floor_m2: area of the floor that they cover.
        boxes: (N, 4) int32 left, top, right, bottom of a person there [px].
        bands: (N, BANDS, 4) int32 the same of the cores of hulls, from the head down.
        scale: (N,) float32 patches of one pixel there.
    """

    def __init__(self, model_map: HumanModelMap, visible: float, patch_m: float) -> None:
        camera = model_map.camera
        boxes = model_map.boxes()
        length_px = boxes[:, 2:].max(axis=1)
        middle = model_map.entry_at(np.array([0.5 * camera.width, 0.5 * camera.height]))
        usual_px = length_px[middle] if middle >= 0 else np.inf
        least_px = min(BIRTH_PX, BIRTH_SHARE * usual_px)
        keep = (model_map.visibility >= visible) & (length_px >= least_px)
        self.floor_m: F32 = model_map.floor_m[keep]
        self.floor_m2 = float(len(np.unique(np.rint(self.floor_m), axis=0)))
        corners = np.concatenate([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]], axis=1)
        self.boxes: I32 = _inside_image(corners[keep], camera)
        self.bands: I32 = _inside_image(_bands(model_map.hull_px[keep]), camera)
        left_top = self.bands[..., :2].min(axis=1)
        right_bottom = self.bands[..., 2:].max(axis=1)
        self._around: I32 = np.concatenate([left_top, right_bottom], axis=1)
        # Depth along the optical axis of the middle of the body [m].
        drop_m = camera.height_m - 0.5 * model_map.model.height_m
        depth_m = self.floor_m[:, 1] * math.sin(camera.tilt_rad) + drop_m * math.cos(camera.tilt_rad)
        patch_px = np.maximum(camera.focal_px * patch_m / depth_m, PATCH_PX)
        self.scale: F32 = (1.0 / patch_px**2).astype(np.float32)

    def scores(self, frame: MaskExplanation, people: People, owners: Owners, least: float) -> tuple[I64, F64]:
        """Places where one more person would gain at least ``least``, and roughly how much [log-odds of pixels].

        Args:
            owners: of the foreground, among ``people``.
        """
        residual = frame.residual(owners)
        # Background only takes away from what foreground gains.
        places = np.flatnonzero(self.scale * _box_sums(residual, self._around) >= least)
        if len(places):
            left, top = self._around[places, :2].min(axis=0)
            right, bottom = self._around[places, 2:].max(axis=0)
            near = np.zeros(frame.kind.shape, np.bool_)
            near[top:bottom, left:right] = True
            background = np.flatnonzero(near & (frame.kind == BACKGROUND_SEEN))
            residual = residual + frame.residual(frame.owners(0, people, background))
        scores = _box_sums(residual, self.bands[places]).sum(axis=1)
        good = scores * self.scale[places] >= least
        return places[good], scores[good]


def _inside_image(boxes: F32 | F64, camera: GroundCamera) -> I32:
    """(..., 4) boxes left, top, right, bottom in whole pixels of the image."""
    limits = np.array([camera.width, camera.height] * 2)
    return np.clip(np.rint(boxes), 0, limits).astype(np.int32)


def _box_sums(image: F32, boxes: I32) -> F64:
    """(...) sums of an image (H, W) in boxes (..., 4) left, top, right, bottom."""
    left, top, right, bottom = np.moveaxis(boxes, -1, 0)
    total = np.asarray(cv2.integral(image, sdepth=cv2.CV_64F), dtype=np.float64)
    sums = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    return np.where((right > left) & (bottom > top), sums, 0.0)


def _bands(hull_px: F32) -> F64:
    """(N, BANDS, 4) left, top, right, bottom [px] of the cores of (N, K, 2) convex hulls, from the head down."""
    rows = hull_px[..., 1]
    ends = np.linspace(rows.min(axis=1), rows.max(axis=1), BANDS + 1, axis=1)
    top = ends[:, :-1]
    bottom = ends[:, 1:]
    middle = 0.5 * (top + bottom)[..., None]
    # Every side of the hull, from (x, y) to the next corner, that crosses the middle of a band.
    x, y = np.moveaxis(hull_px[:, None], -1, 0)
    to_x, to_y = np.moveaxis(np.roll(hull_px, -1, axis=1)[:, None], -1, 0)
    crosses = (y <= middle) != (to_y <= middle)
    rise = np.where(crosses, to_y - y, 1.0)
    at = x + (middle - y) / rise * (to_x - x)
    left = np.where(crosses, at, np.inf).min(axis=-1)
    right = np.where(crosses, at, -np.inf).max(axis=-1)
    centre = 0.5 * (left + right)
    half = 0.5 * CORE_WIDTH * (right - left)
    return np.stack([centre - half, top, centre + half, bottom], axis=-1)


def find_newcomers(
    places: FloorPlaces, frame: MaskExplanation, followed: People, owners: Owners, now_s: float, p: HumanModelParams
) -> tuple[list[Walker], F64]:
    """Find newcomers, without ids, and (N, 5) poses of the people followed, who may be better elsewhere.

    Tries one more person wherever the residual is strongest.
    """
    entries, scores = places.scores(frame, followed, owners, 0.5 * p.birth_evidence)
    boxes = places.boxes[entries]
    middle = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    people = followed
    born: list[Walker] = []
    for _ in range(PLACES_MAX):
        if scores.max(initial=0.0) <= 0.0:
            break
        best = int(np.argmax(scores))
        size = boxes[best, 2:] - boxes[best, :2]
        scores[(np.abs(middle - middle[best]) < 0.5 * size).all(axis=1)] = 0.0
        newcomer = _try_walker(places.floor_m[entries[best]].astype(np.float64), frame, people, now_s, p)
        if newcomer is not None:
            born.append(newcomer)
            people = people.with_one(newcomer.pose)
    return born, people.poses[: len(followed.poses)]


def sit_down(pose: F64, camera_m: float, share: float) -> F64:
    """(5,) pose of somebody who sits, with the head on the same ray as that of somebody who stands at a pose."""
    height_m = share * pose[2]
    nearer = max(camera_m - height_m, 0.1) / max(camera_m - pose[2], 0.1)
    return np.array([*(nearer * pose[:2]), height_m, *pose[3:]])


def _try_walker(
    place: F64, frame: MaskExplanation, followed: People, now_s: float, p: HumanModelParams
) -> Walker | None:
    """A newcomer at a place, if the evidence for one is strong enough; a rival who accounts for it is moved there."""
    start = upright_pose((*place, body.HEIGHT_MEAN_M))
    people = followed.with_one(start)
    n = len(followed.poses)
    _, stature, ratios = people.person(n)
    prior = loose_prior(PLACE_STD_M, body.HEIGHT_STD_M)
    fits = []
    # A head alone may be a sitter's, or that of somebody who stands farther away.
    for posture in (start, sit_down(start, float(frame.views[0].rays.centre_m[2]), p.sitting)):
        people.poses[n] = posture
        others = np.flatnonzero(frame.share_rays(people.poses)[n, :n])
        samples = frame.samples_around(posture, PLACE_STD_M)
        samples.lay_others(people, others)
        evidence, curvature = samples.ascend(people.poses[n], posture, prior, stature, ratios)
        fits.append((evidence, people.poses[n].copy(), curvature, samples, others))
    evidence, pose, curvature, samples, others = max(fits, key=lambda fit: fit[0])
    people.poses[n] = pose
    rival = int(frame.rivals(people, np.append(np.ones(n), 0.0))[n]) if evidence > 0.0 else -1
    if rival >= 0:
        strong = evidence >= p.birth_evidence
        pair = frame.weigh_pair(n, rival, people, refit=True)
        evidence = pair.evidence
        if evidence >= p.birth_evidence:
            followed.poses[rival] = people.poses[rival]
            pose = people.poses[n]
            samples.lay_others(people, others)
        elif strong and pair.gain > p.birth_evidence:
            followed.poses[rival] = pair.alone
    own, shown, _ = samples.visible_patches(pose, stature, ratios).tolist()
    if evidence < p.birth_evidence or own < 0.25 * shown:
        return None
    glimpse = Glimpse(evidence, own / max(shown, 1e-6), head_in_view=True)
    return Walker.newcomer(pose, *samples.precision(pose, curvature), glimpse, now_s)
