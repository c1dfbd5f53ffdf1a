"""Human-model tracker of one calibrated camera (Zhang et al. 2008, section 4, figure 8)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import cv2
import numpy as np

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.types import F32, F64, U8, Bool
from planview.foreground.params import BACKGROUND, PERSON, WALKER
from planview.maps.view import BACKGROUND_SEEN, SHADED, SURFACE, PixelRays
from planview.tracking import body
from planview.tracking.base import NO_BOX, DecisionKind, Drawing, Needs, Observation, TrackerDebug
from planview.tracking.explain.explanation import Owned, People
from planview.tracking.explain.facing import FacingBelief
from planview.tracking.explain.person import side_by_side
from planview.tracking.explain.tracker import ExplainingTracker
from planview.tracking.human_model.explanation import HumanModelParams, MaskExplanation, likelihood_of_masks
from planview.tracking.human_model.model_map import HumanModelMap, build_model_map
from planview.tracking.human_model.walker import CORE_WIDTH, FloorPlaces, ModelMatch, Walker, births, matches
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState

WALKER_M = 2.0
"""Way after which a person is no ghost of the background [m]."""
BOX_WIDTH = 1.35
"""Width of a person's box over the hull's: arms and stride."""
RETURNS = 0.2
"""Share of people who vanish inside the view and come back; the others left through a door, and anybody may come out
of it."""
HIDDEN_LOG_ODDS = -3.0
"""Log-odds, before anybody has walked there, that something hides people at a pixel."""
LIVELY = 0.01
"""Share of a region's pixels in motion from which it is no thing: a head that turns."""


class HumanModelTracker(ExplainingTracker[Walker, HumanModelParams]):
    """People as projected human models that explain every pixel of the foreground jointly.

    New targets, split, merge and clean (figure 8) follow from the likelihood: a newcomer is born where foreground is
    left over, and a person without evidence ends.
    """

    CARRIED = (*ExplainingTracker.CARRIED, "_known_pixels", "_still_s", "_hides")
    needs: Needs = "image"
    RECORDS = (Walker, FloorKalman, FacingBelief, ModelMatch)
    foreground_columns: int | None = None

    def __init__(self, params: HumanModelParams, camera: GroundCamera, model_map: HumanModelMap | None = None) -> None:
        """Args: params: of the tracker. camera: calibrated from people. model_map: computed before for this camera;
        built here if None. Raises InputError: the map is another camera's, or holds no place where people are looked
        for."""
        if model_map is not None and model_map.camera != camera:
            raise InputError(f"expected a human model map of {camera}, found one of {model_map.camera}")
        self.camera, self.model = camera, HumanModel()
        self.model_map = model_map or build_model_map(camera, self.model, params.map)
        self._rays, self._likelihood = PixelRays.of(camera), likelihood_of_masks(params)
        self._places = FloorPlaces(self.model_map, params.birth_visible, params.patch_m)
        if not self._places.floor_m2:
            raise InputError(
                "human_model.map: expected floor on which people of min_height_px show within max_distance_m, "
                "found none in the view of this camera"
            )
        super().__init__(params)

    def reset(self) -> None:
        """Forget all people; ids start again at 1."""
        super().reset()
        shape = self.camera.size[::-1]
        self._known_pixels: U8 = np.zeros(shape, np.uint8)
        self._still_s: F32 = np.zeros(shape, np.float32)
        self._hides: F32 = np.full(shape, HIDDEN_LOG_ODDS, np.float32)

    def study(self, observations: Iterable[Observation]) -> None:
        """Nothing to learn: the camera gives the size of people."""

    def feedback(self) -> U8:
        """(H, W) uint8 for ``Foreground``: people who are tracked, and what has been still and unexplained for long."""
        return self._known_pixels

    def debug(self) -> TrackerDebug:
        """Hulls with their states in the image, footprints on the floor."""
        hulls = [(q, self._hull(q.at_m, q.height_m)) for q in self._people]
        outlines = [(q, np.vstack([hull, hull[:1]]).astype(np.float32)) for q, hull in hulls if hull is not None]
        labels = tuple(
            f"{q.track_id} {q.posture} {q.motion} {q.stability} M={q.match.score:.2f}, existence {q.existence:.2f}"
            for q, _ in outlines
        )
        feet = tuple(np.array([person.at_m], np.float32) for person in self._people)
        models = Drawing("models", "image", tuple(hull for _, hull in outlines), labels)
        ids = tuple(str(person.track_id) for person in self._people)
        return TrackerDebug((models, Drawing("footprints", "floor", feet, ids)))

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame. Raises InputError: images of another size than the camera's. Raises ValueError: foreground
        or motion are missing."""
        view = observation.views[0] if observation.views else None
        if view is None or (view.shows and view.motion is None):
            raise ValueError("the human-model tracker needs foreground and motion")
        width, height = self.camera.size
        for rows, cols, *_ in (view.kind.shape, (height, width) if view.image is None else view.image.shape):
            if (cols, rows) != (width, height):
                raise InputError(
                    f"expected images of {width}x{height} px, for which the camera was calibrated, found {cols}x{rows}"
                )
        dt = self._begin(observation.timestamp_s)
        frame = MaskExplanation(self._rays, view, self._likelihood)
        seen = frame.kind == BACKGROUND_SEEN
        frame.kind[seen & (self._hides > 0)] = SHADED
        if self._people:
            self._explain(frame, side_by_side(self._people), dt)
        if (motion := view.motion) is None:
            return tuple(self._state(person, self._box(person)) for person in self._people)
        people = side_by_side(self._people)
        (owned,) = frame.assign_pixels(people)
        hulls = [self._hull(person.at_m, person.height_m) for person in self._people]
        self._judge(frame, owned, motion, hulls)
        self._learn_hiding(frame, seen, hulls, dt)
        if frame.coloured:
            self._learn([owned], (frame.touching(people.poses).sum(axis=1) == 0).tolist(), dt)
        self._paint_known(owned, motion, dt)
        self._clean(dt)
        born, poses = births(self._places, frame, side_by_side(self._people), owned, self._life.now_s, self.params)
        for person, pose in zip(self._people, poses, strict=True):
            if tuple(pose[:3]) != (*person.at_m, person.height_m):
                # Go on where the model accounts for more.
                person.kalman = person.kalman.moved_to(float(pose[0]), float(pose[1]))
                person.height_m = float(pose[2])
                self._life.note(person, "recentred", f"accounts for more at {pose[0]:.2f}, {pose[1]:.2f} m", math.nan)
        found = matches([self._hull(newcomer.at_m, newcomer.height_m) for newcomer in born], frame.kind == SURFACE)
        for newcomer, match in zip(born, found, strict=True):
            newcomer.match, newcomer.inside = match, self._visibility(newcomer.at_m)
            reason = f"M {match.score:.2f}, evidence {newcomer.evidence:.1f}, {newcomer.height_m:.2f} m tall"
            self._add(newcomer, "split" if match.recall < 0.5 else "spawned", reason, match.score)
        self._recognise(dt)
        return tuple(self._state(person, self._box(person)) for person in self._people)

    def _explain(self, frame: MaskExplanation, people: People, dt: float) -> None:
        """Places, then the frame's evidence on each person's existence."""
        samples, found = self._ascend(frame, people, frame.touching(people.poses))
        # The surer person wins; of two equally sure ones the one that came first.
        ranks = sorted(range(len(self._people)), key=lambda k: self._people[k].standing)
        rivals = frame.rivals(people, np.argsort(ranks).astype(np.float64))
        for i, person in enumerate(self._people):
            person.evidence, pose = float(found.evidence[i]), people.poses[i]
            person.see(found.seen[i], self._visibility(pose[:2]))
            self._measure(person, samples.person(i), pose, found.curvature[i], found.turned[i], dt)
            seen = person.share >= self.params.visible_min
            if seen and rivals[i] >= 0 and not person.confirmed:  # who is has been seen apart from others
                person.evidence = min(person.evidence, frame.pair(i, int(rivals[i]), people)[0])
            self._weigh(person, dt, self.params.stay_s)
            if seen:
                farther = math.dist(person.origin_m, person.at_m) - person.kalman.position_std_m - person.walked_m
                farther = max(0.0, farther)
                person.walked_m += farther
                person.moved += farther

    def _learn_hiding(self, frame: MaskExplanation, seen: Bool, hulls: list[F64 | None], dt: float) -> None:
        """Learn what hides people: pixels that stay background where a person walks."""
        p, walkers = self.params, np.zeros(seen.shape, np.uint8)
        for person, hull in zip(self._people, hulls, strict=True):
            if person.confirmed and person.motion == "moving" and person.share >= p.visible_min and hull is not None:
                middle = hull.mean(axis=0)
                cv2.fillConvexPoly(walkers, np.rint(middle + CORE_WIDTH * (hull - middle)).astype(np.int32), 1)
        inside, fresh = np.flatnonzero(walkers.view(np.bool_)), min(1.0, dt / p.errors_s)
        hidden = math.log((1 - p.seen_on_background) / (1 - p.seen_on_body))
        shown = math.log(p.seen_on_background / p.seen_on_body)
        more = seen.reshape(-1)[inside] * hidden + (frame.kind.reshape(-1)[inside] == SURFACE) * shown
        hides = self._hides.reshape(-1)
        hides[inside] = np.clip(hides[inside] + fresh * more, 2 * HIDDEN_LOG_ODDS, -HIDDEN_LOG_ODDS)

    def _visibility(self, at_m: Sequence[float] | F64) -> float:
        """The human visibility ratio of the model map."""
        entry = int(self.model_map.entry_at(self.camera.project(np.array([*at_m, 0.0]))))
        return float(self.model_map.visibility[entry]) if entry >= 0 else 0.0

    def _judge(self, frame: MaskExplanation, owned: Owned, motion: U8, hulls: list[F64 | None]) -> None:
        """Match (equation 1) and the automata of everybody."""
        found = matches(hulls, frame.kind == SURFACE)
        owner, n = owned.owner + 1, len(self._people) + 1
        area = np.bincount(owner, minlength=n)[1:]
        moving = np.bincount(owner[motion.reshape(-1)[owned.pixels] > 0], minlength=n)[1:]
        for i, person in enumerate(self._people):
            person.match = found[i]
            before = person.posture, person.motion, person.stability
            person.judge(self._life.now_s, moving[i] / max(1, area[i]), self.params)
            if (person.posture, person.motion, person.stability) != before:
                states = f"{person.posture}, {person.motion}, {person.stability}"
                self._life.note(person, "state", states, person.match.score)
            seen = person.share >= self.params.visible_min
            kind: DecisionKind = "matched" if seen == person.observed else ("reacquired" if seen else "lost")
            person.observed = seen
            if seen or kind == "lost":
                self._life.note(
                    person, kind,
                    f"M {person.match.score:.2f}, evidence {person.evidence:.1f}, visible {person.share:.2f}, "
                    f"existence {person.existence:.3f}", person.match.score,
                )  # fmt: skip

    def _paint_known(self, owned: Owned, motion: U8, dt: float) -> None:
        """Mark people for the foreground model, and what has been still and unexplained for long."""
        labels = np.zeros(len(self._people) + 1, np.uint8)
        for i, person in enumerate(self._people):
            if person.confirmed:
                labels[i] = WALKER if person.walked_m > WALKER_M else PERSON
        label, still_s = labels[owned.owner], np.zeros(motion.size, np.float32)
        known, left = np.zeros((2, motion.size), np.uint8)
        label[(owned.owner == -1) & owned.near & labels.any()] = PERSON
        known[owned.pixels], rest = label, owned.pixels[label == 0]
        left[rest] = 1
        n, found = cv2.connectedComponents(left.reshape(motion.shape), connectivity=8)
        regions = found.reshape(-1)[rest]
        moving = np.bincount(regions[motion.reshape(-1)[rest] > 0], minlength=n)
        lively = moving > LIVELY * np.bincount(regions, minlength=n)
        still_s[rest] = dt + np.where(lively[regions], 0.0, self._still_s.reshape(-1)[rest])
        known[rest[still_s[rest] >= self.params.still_s]] = BACKGROUND
        self._known_pixels, self._still_s = known.reshape(motion.shape), still_s.reshape(motion.shape)

    def _clean(self, dt: float) -> None:
        """End people without evidence or beyond the border, and things that somebody moved."""
        p = self.params
        for person in self._people:
            beyond = person.inside < p.birth_visible
            thing = person.moved < (0.0 if person.confirmed else -p.still_s / p.inanimate_s)
            if person.existence < 0.05 or beyond or thing:
                why = f"existence {person.existence:.2f}, evidence {person.evidence:.1f}"
                may_return = person.confirmed and not thing and not beyond
                self._end(person, "stationary: a thing" if thing else why, may_return)
        for person in self._departed:
            person.kalman = person.kalman.slowed(dt, body.SLOW_DOWN_S).predicted(dt, body.ACCELERATION_MPS2)

    def _recognise(self, dt: float) -> None:
        """Confirm newcomers, either as a lost or departed person or as a stranger.

        An identity is decided as soon as its odds suffice, and no later than when the person is first reported.
        """
        p, new = self.params, [person for person in self._people if not person.confirmed]
        known = {q.track_id: (before, odds) for q, before, odds in self._known(new, self._places.floor_m2)}
        for person in self._people:
            if person.motion == "stationary" and person.share >= p.visible_min:
                person.moved -= dt / p.inanimate_s
        for newcomer in new:
            sure = newcomer.existence > p.report and newcomer.walked_m >= p.walked_m and newcomer.share >= p.visible_min
            before, odds = known.get(newcomer.track_id, (None, 0.0))
            if before is not None:
                odds += math.log(RETURNS if before in self._departed else before.existence)
            if before is not None and odds > 0.0 and (sure or odds > math.log(p.report / (1 - p.report))):
                self._continue(newcomer, before, odds)
            elif sure:
                self._confirm(newcomer, f"existence {newcomer.existence:.2f}, walked {newcomer.walked_m:.2f} m")

    def _hull(self, at_m: tuple[float, float], height_m: float) -> F64 | None:
        """(K, 2) outline [px] of the model map, as large as a person of a height is; None where nobody is expected."""
        foot = self.camera.project(np.array([*at_m, 0.0]))
        entry = int(self.model_map.entry_at(foot))
        if entry < 0:
            return None
        tall = height_m / self.model.height_m
        # Heads are nearer to the camera than feet.
        tilt, drop = self.camera.tilt_rad, self.camera.height_m
        near = self.model.height_m * math.cos(tilt) / (at_m[1] * math.sin(tilt) + drop * math.cos(tilt))
        size = tall * (1.0 - near) / max(1.0 - tall * near, 0.1)
        return np.asarray(foot + size * (self.model_map.hull_px[entry] - self.model_map.foot_px[entry]), np.float64)

    def _box(self, person: Walker) -> tuple[float, float, float, float]:
        """left, top, width, height [px]; NaN where nobody is expected."""
        hull = self._hull(person.at_m, person.height_m)
        if hull is None:
            return NO_BOX
        (left, top), (right, bottom) = hull.min(axis=0), hull.max(axis=0)
        wide = 0.5 * (BOX_WIDTH - 1.0) * (right - left)
        return float(left - wide), float(top), float(right - left + 2 * wide), float(bottom - top)
