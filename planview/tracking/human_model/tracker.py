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
from planview.maps.view import BACKGROUND_SEEN, SHADED, SURFACE, PixelRays, View
from planview.tracking import body, odds
from planview.tracking.base import NO_BOX, Box, DecisionKind, Drawing, Needs, Observation, TrackerDebug
from planview.tracking.explain.explanation import Owners, People
from planview.tracking.explain.identity import Match
from planview.tracking.explain.person import RECORDS, Glimpse, side_by_side
from planview.tracking.explain.tracker import ExplainingTracker
from planview.tracking.human_model.explanation import HumanModelParams, MaskExplanation, likelihood_of_masks
from planview.tracking.human_model.model_map import HumanModelMap, build_model_map
from planview.tracking.human_model.walker import (
    CORE_WIDTH,
    FloorPlaces,
    ModelMatch,
    Walker,
    find_newcomers,
    match_hulls,
)
from planview.trajectories.state import TrackState

WALKER_M = 2.0
"""Distance walked after which a person is not a ghost of the background [m]."""
BOX_WIDTH = 1.35
"""Width of a person's box over the hull's: arms and stride."""
RETURNS = 0.2
"""Share of people who vanish inside the view and come back; the others left through a door, and anybody may come out
of it."""
HIDDEN_LOG_ODDS = -3.0
"""Log-odds, before anybody has walked there, that something hides people at a pixel."""
LIVELY = 0.01
"""Share of a region's pixels in motion from which it is a person: a head that turns."""


class HumanModelTracker(ExplainingTracker[Walker, HumanModelParams]):
    """People as projected human models that explain every pixel of the foreground jointly.

    New targets, split, merge and clean (figure 8) follow from the likelihood: a newcomer is born where foreground is
    left over, and a person without evidence ends.
    """

    CARRIED = (*ExplainingTracker.CARRIED, "_labels", "_still_s", "_hides")
    needs: Needs = "image"
    RECORDS = (Walker, ModelMatch, *RECORDS)
    foreground_columns: int | None = None

    def __init__(self, params: HumanModelParams, camera: GroundCamera, model_map: HumanModelMap | None = None) -> None:
        """Args: params: of the tracker. camera: calibrated from people. model_map: computed before for this camera;
        built here if None. Raises InputError: the map is another camera's, or holds no place where people are looked
        for."""
        if model_map is not None and model_map.camera != camera:
            raise InputError(f"expected a human model map of {camera}, found one of {model_map.camera}")
        self.camera = camera
        self.model = HumanModel()
        self.model_map = model_map or build_model_map(camera, self.model, params.map)
        self._rays = PixelRays.of(camera)
        self._likelihood = likelihood_of_masks(params)
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
        self._labels: U8 = np.zeros(shape, np.uint8)
        self._still_s: F32 = np.zeros(shape, np.float32)
        self._hides: F32 = np.full(shape, HIDDEN_LOG_ODDS, np.float32)

    def study(self, observations: Iterable[Observation]) -> None:
        """Nothing to learn: the camera gives the size of people."""

    def feedback(self) -> U8:
        """(H, W) uint8 for ``Foreground``: people who are tracked, and what has been still and unexplained for long."""
        return self._labels

    def debug(self) -> TrackerDebug:
        """Hulls with their states in the image, footprints on the floor."""
        outlines: list[F32] = []
        labels = []
        feet: list[F32] = []
        ids = []
        for person in self._people:
            feet.append(np.array([person.at_m], np.float32))
            ids.append(str(person.track_id))
            hull = self._hull(person)
            if hull is not None:
                outlines.append(np.vstack([hull, hull[:1]]).astype(np.float32))
                states = f"{person.posture} {person.motion} {person.stability}"
                scores = f"M={person.match.score:.2f}, existence {person.existence:.2f}"
                labels.append(f"{person.track_id} {states} {scores}")
        models = Drawing("models", "image", tuple(outlines), tuple(labels))
        return TrackerDebug((models, Drawing("footprints", "floor", tuple(feet), tuple(ids))))

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame. Raises InputError: images of another size than the camera's. Raises ValueError: foreground
        or motion are missing."""
        view = observation.views[0] if observation.views else None
        if view is None or (view.shows and view.motion is None):
            raise ValueError("the human-model tracker needs foreground and motion")
        self._check_size(view)
        dt_s = self._begin(observation.timestamp_s)
        frame = MaskExplanation(self._rays, view, self._likelihood)
        seen = frame.kind == BACKGROUND_SEEN
        frame.kind[seen & (self._hides > 0)] = SHADED
        if self._people:
            self._explain(frame, side_by_side(self._people), dt_s)
        if view.motion is not None:
            people = side_by_side(self._people)
            (owners,) = frame.assign_pixels(people)
            hulls = [self._hull(person) for person in self._people]
            self._judge(frame, owners, view.motion, hulls)
            self._learn_hiding(frame, seen, hulls, dt_s)
            if frame.coloured:
                apart = frame.share_rays(people.poses).sum(axis=1) == 0
                self._learn_colours([owners], apart.tolist(), dt_s)
            self._label_pixels(owners, view.motion, dt_s)
            self._clean(dt_s)
            self._add_newcomers(frame, owners)
            self._recognise(dt_s)
        return tuple(
            self._state(person, self._box(person), std_m=self.camera.std_m(*person.at_m)) for person in self._people
        )

    def _check_size(self, view: View) -> None:
        width, height = self.camera.size
        image = view.kind if view.image is None else view.image
        for rows, cols in (view.kind.shape, image.shape[:2]):
            if (cols, rows) != (width, height):
                raise InputError(
                    f"expected images of {width}x{height} px, for which the camera was calibrated, found {cols}x{rows}"
                )

    def _explain(self, frame: MaskExplanation, people: People, dt_s: float) -> None:
        """Move everybody to where they explain best, and weigh the frame's evidence on each person's existence."""
        samples, fits = self._ascend(frame, people, frame.share_rays(people.poses))
        # The surer person wins; of two equally sure ones the one that came first.
        ranks = sorted(range(len(self._people)), key=lambda k: self._people[k].seniority)
        rivals = frame.rivals(people, np.argsort(ranks).astype(np.float64)).tolist()
        for i, person in enumerate(self._people):
            pose = people.poses[i]
            evidence = float(fits.evidence[i])
            glimpse = Glimpse.of(evidence, fits.patches[i], self._visibility(pose[:2]))
            person.glimpse = glimpse
            visible = self._is_visible(person)
            if visible and rivals[i] >= 0 and not person.confirmed:  # whoever is has been seen apart from others
                pair = frame.weigh_pair(i, rivals[i], people)
                person.glimpse = glimpse._replace(evidence=min(evidence, pair.evidence))
            self._measure(person, samples.person(i), pose, fits.curvature[i], fits.by_facing[i], dt_s)
            self._weigh(person, dt_s, self.params.stay_s)
            if visible:
                walk = person.identity.walk
                walk.evidence += walk.extend(person.at_m, person.kalman.position_std_m)

    def _learn_hiding(self, frame: MaskExplanation, seen: Bool, hulls: list[F64 | None], dt_s: float) -> None:
        """Learn what hides people: pixels that stay background where a person walks."""
        p = self.params
        walkers = np.zeros(seen.shape, np.uint8)
        for person, hull in zip(self._people, hulls, strict=True):
            walks = person.confirmed and person.motion == "moving" and self._is_visible(person)
            if walks and hull is not None:
                middle = hull.mean(axis=0)
                core = middle + CORE_WIDTH * (hull - middle)
                cv2.fillConvexPoly(walkers, np.rint(core).astype(np.int32), 1)
        inside = np.flatnonzero(walkers)
        hidden = math.log((1 - p.seen_on_background) / (1 - p.seen_on_body))
        shown = math.log(p.seen_on_background / p.seen_on_body)
        is_surface = frame.kind.reshape(-1)[inside] == SURFACE
        more = seen.reshape(-1)[inside] * hidden + is_surface * shown
        hides = self._hides.reshape(-1)
        log_odds = hides[inside] + self._fresh(dt_s) * more
        hides[inside] = np.clip(log_odds, 2 * HIDDEN_LOG_ODDS, -HIDDEN_LOG_ODDS)

    def _visibility(self, at_m: Sequence[float] | F64) -> float:
        """The human visibility ratio of the model map."""
        entry = int(self.model_map.entry_at(self.camera.project(np.array([*at_m, 0.0]))))
        return float(self.model_map.visibility[entry]) if entry >= 0 else 0.0

    def _judge(self, frame: MaskExplanation, owners: Owners, motion: U8, hulls: list[F64 | None]) -> None:
        """Match everybody (equation 1) and advance their automata."""
        matches = match_hulls(hulls, frame.kind == SURFACE)
        owner = owners.owner + 1
        n = len(self._people) + 1
        area = np.bincount(owner, minlength=n)[1:]
        moving = np.bincount(owner[motion.reshape(-1)[owners.pixels] > 0], minlength=n)[1:]
        for i, person in enumerate(self._people):
            person.match = matches[i]
            before = person.states
            person.judge(self._life.now_s, moving[i] / max(1, area[i]), self.params)
            if person.states != before:
                self._life.note(person, "state", person.states, person.match.score)
            visible = self._is_visible(person)
            kind: DecisionKind = "matched"
            if visible != person.observed:
                kind = "reacquired" if visible else "lost"
            person.observed = visible
            if visible or kind == "lost":
                glimpse = person.glimpse
                shown = f"evidence {glimpse.evidence:.1f}, visible {glimpse.visible_share:.2f}"
                reason = f"M {person.match.score:.2f}, {shown}, existence {person.existence:.3f}"
                self._life.note(person, kind, reason, person.match.score)

    def _label_pixels(self, owners: Owners, motion: U8, dt_s: float) -> None:
        """Label people for the foreground model, and what has been still and unexplained for long."""
        person_labels = np.zeros(len(self._people) + 1, np.uint8)
        for i, person in enumerate(self._people):
            if person.confirmed:
                has_walked = person.identity.walk.farthest_m > WALKER_M
                person_labels[i] = WALKER if has_walked else PERSON
        owner_labels = person_labels[owners.owner]
        owner_labels[(owners.owner == -1) & owners.near & person_labels.any()] = PERSON
        labels = np.zeros(motion.size, np.uint8)
        labels[owners.pixels] = owner_labels
        rest = owners.pixels[owner_labels == 0]
        unexplained = np.zeros(motion.size, np.uint8)
        unexplained[rest] = 1
        n, numbers = cv2.connectedComponents(unexplained.reshape(motion.shape), connectivity=8)
        regions = numbers.reshape(-1)[rest]
        moving = np.bincount(regions[motion.reshape(-1)[rest] > 0], minlength=n)
        lively = moving > LIVELY * np.bincount(regions, minlength=n)
        still_s = np.zeros(motion.size, np.float32)
        still_s[rest] = dt_s + np.where(lively[regions], 0.0, self._still_s.reshape(-1)[rest])
        labels[rest[still_s[rest] >= self.params.still_s]] = BACKGROUND
        self._labels = labels.reshape(motion.shape)
        self._still_s = still_s.reshape(motion.shape)

    def _clean(self, dt_s: float) -> None:
        """End people without evidence or beyond the border, and things that somebody moved."""
        p = self.params
        for person in self._people:
            beyond = person.glimpse.inside_share < p.birth_visible
            least = 0.0 if person.confirmed else -p.still_s / p.inanimate_s
            thing = person.identity.walk.evidence < least
            if thing:
                self._end(person, "stationary: a thing", may_return=False)
            elif beyond or person.existence < 0.05:
                reason = f"existence {person.existence:.2f}, evidence {person.glimpse.evidence:.1f}"
                self._end(person, reason, may_return=person.confirmed and not beyond)
        for person in self._departed:
            slower = person.kalman.slow_down(dt_s, body.SLOW_DOWN_S)
            person.kalman = slower.predict(dt_s, body.ACCELERATION_MPS2)

    def _add_newcomers(self, frame: MaskExplanation, owners: Owners) -> None:
        """Follow one more person where foreground is left over; move those on who explain more elsewhere."""
        people = side_by_side(self._people)
        born, poses = find_newcomers(self._places, frame, people, owners, self._life.now_s, self.params)
        for person, pose in zip(self._people, poses, strict=True):
            x_m, y_m, height_m, *_ = pose.tolist()
            if (x_m, y_m, height_m) != (*person.at_m, person.height_m):
                person.kalman = person.kalman.move_to(x_m, y_m)
                person.height_m = height_m
                self._life.note(person, "recentred", f"accounts for more at {x_m:.2f}, {y_m:.2f} m")
        matches = match_hulls([self._hull(newcomer) for newcomer in born], frame.kind == SURFACE)
        for newcomer, match in zip(born, matches, strict=True):
            newcomer.match = match
            newcomer.glimpse = newcomer.glimpse._replace(inside_share=self._visibility(newcomer.at_m))
            evidence = newcomer.glimpse.evidence
            reason = f"M {match.score:.2f}, evidence {evidence:.1f}, {newcomer.height_m:.2f} m tall"
            kind: DecisionKind = "split" if match.recall < 0.5 else "spawned"
            self._add(newcomer, kind, reason, match.score)

    def _recognise(self, dt_s: float) -> None:
        """Confirm newcomers, either as a lost or departed person or as a stranger.

        An identity is decided as soon as its odds suffice, and no later than when the person is first reported.
        """
        p = self.params
        newcomers = [person for person in self._people if not person.confirmed]
        matches = {match.person.track_id: match for match in self._match(newcomers, self._places.floor_m2)}
        for person in self._people:
            if person.motion == "stationary" and self._is_visible(person):
                person.identity.walk.evidence -= dt_s / p.inanimate_s
        for newcomer in newcomers:
            walked_m = newcomer.identity.walk.farthest_m
            is_certain = newcomer.existence > p.report and walked_m >= p.walked_m and self._is_visible(newcomer)
            match = matches.get(newcomer.track_id)
            if match is not None:
                before = match.other
                returns = RETURNS if before in self._departed else before.existence
                log_odds = match.log_odds + math.log(returns)
                if log_odds > 0.0 and (is_certain or log_odds > odds.log_odds(p.report)):
                    self._continue(Match(newcomer, before, log_odds))
                    continue
            if is_certain:
                self._confirm(newcomer, f"existence {newcomer.existence:.2f}, walked {walked_m:.2f} m")

    def _hull(self, person: Walker) -> F64 | None:
        """(K, 2) outline [px] of the model map, as large as a person of a height is; None where nobody is expected."""
        x_m, y_m = person.at_m
        foot = self.camera.project(np.array([x_m, y_m, 0.0]))
        entry = int(self.model_map.entry_at(foot))
        if entry < 0:
            return None
        tall = person.height_m / self.model.height_m
        # Heads are nearer to the camera than feet.
        tilt_rad = self.camera.tilt_rad
        depth_m = y_m * math.sin(tilt_rad) + self.camera.height_m * math.cos(tilt_rad)
        near = self.model.height_m * math.cos(tilt_rad) / depth_m
        size = tall * (1.0 - near) / max(1.0 - tall * near, 0.1)
        return np.asarray(foot + size * (self.model_map.hull_px[entry] - self.model_map.foot_px[entry]), np.float64)

    def _box(self, person: Walker) -> Box:
        """Left, top, width, height [px]; NaN where nobody is expected."""
        hull = self._hull(person)
        if hull is None:
            return NO_BOX
        left, top = hull.min(axis=0).tolist()
        right, bottom = hull.max(axis=0).tolist()
        wide = 0.5 * (BOX_WIDTH - 1.0) * (right - left)
        return left - wide, top, right - left + 2 * wide, bottom - top
