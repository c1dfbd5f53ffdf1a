"""The tracker: detection, prediction, overlap likelihood, births and deaths."""

from __future__ import annotations

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F32, F64, U8, Bool
from planview.foreground.masks import PERSON
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.ellipse_particle.drawing import draw, outline
from planview.tracking.ellipse_particle.explain import measured_shares, reachable, unexplained
from planview.tracking.ellipse_particle.fit import _area as kernels
from planview.tracking.ellipse_particle.fit.ellipses import SizePrior, fit_ellipses
from planview.tracking.ellipse_particle.length import length_shown
from planview.tracking.ellipse_particle.life import observe
from planview.tracking.ellipse_particle.newcomers import Newcomers
from planview.tracking.ellipse_particle.objects import Objects
from planview.tracking.ellipse_particle.outputs import floor_state, image_state, measure_axes
from planview.tracking.ellipse_particle.params import EllipseParticleParams
from planview.tracking.ellipse_particle.particles import VX, VY
from planview.tracking.ellipse_particle.planes import FloorPlane, ImagePlane, PlaneView, floor_prior, given_prior
from planview.tracking.ellipse_particle.size_learning import SizeLearner
from planview.trajectories.state import TrackState

NO_ELLIPSES: F64 = np.zeros((0, 5))
LONGEST_STEP_S = 1.0
"""A gap in the recording longer than this is predicted over as if it were this long [s]."""
REPLAYED = 10
"""Frames before the size was known that are tracked once it is; a bound on the time of that one frame. Our choice."""


class EllipseParticleTracker:
    """Ellipses fitted to foreground, tracked by a particle filter without explicit association.

    Works in the image plane, where it needs no calibration, or on the plan-view occupancy map.

    Args:
        params: all parameters; one seed gives one result.
        camera: image plane only: gives floor positions and heights; None leaves them unknown.
    """

    def __init__(self, params: EllipseParticleParams | None = None, camera: GroundCamera | None = None) -> None:
        self._params = params or EllipseParticleParams()
        self._camera = camera
        p = self._params
        self._fit = p.fit
        self._filter_params = p.filter
        if p.plane == "floor":
            apart = p.size.floor_separation_m / p.size.floor_half_length_m
            # Seen from above a body may point anywhere.
            self._fit = p.fit.model_copy(
                update={"angle_spread_deg": 45.0, "angle_limit_deg": 90.0, "separation": apart, "proposed_share": 1.0}
            )
            # Who is hidden leaves no occupancy, and is not to be drawn to those in front: equation (8) as it is.
            self._filter_params = p.filter.model_copy(update={"angle_spread_deg": 30.0, "outside_weight": 0.0})
        self._newcomers = Newcomers(p.newcomers, p.size.floor_separation_m)
        self._plane = FloorPlane(p.detection, p.size) if p.plane == "floor" else ImagePlane(p.detection)
        self.reset()

    def reset(self) -> None:
        """Forget people, background, sizes and the random state; ids start at 1 again."""
        rng = np.random.default_rng(self._params.seed)
        self._objects = Objects(self._filter_params, self._params.life, rng)
        self._learner = SizeLearner(self._params.size)
        self._plane.reset()
        self._time: float | None = None
        self._view: PlaneView | None = None
        self._prior: SizePrior | None = None
        self._measured = NO_ELLIPSES
        self._unsized: list[tuple[float, PlaneView]] = []
        self._outlines: list[F32] = []
        self._shape: tuple[int, int] | None = None

    @property
    def decisions(self) -> tuple[Decision, ...]:
        return tuple(self._objects.decisions)

    @property
    def prior(self) -> SizePrior | None:
        """Size expected of objects [cells], None while it is being learned."""
        return self._prior

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame.

        Returns:
            one state per object, tentative ones included; x, y, velocity and height are NaN in the image plane
            without a camera, the box is NaN on the floor.
        Raises:
            ValueError: the observation's arrays are not what they should be.
        """
        self._objects.decisions = []
        dt = self._step(observation.timestamp_s)
        view = self._plane(observation)
        if observation.image is not None:
            self._shape = (observation.image.shape[0], observation.image.shape[1])
        self._resize(view)
        self._view = view
        if view is None:
            return ()
        before = self._prior
        self._measured = self._measure(view, observation)
        if self._prior is None:
            self._unsized = [*self._unsized, (dt, view)][-REPLAYED:]
            return ()
        if before is None:
            self._replay(self._prior, observation)
        else:
            self._objects.resize(before, self._prior, self._fit.size_limit, view.mask.shape)
        self._follow(dt, view, self._prior, observation)
        self._outlines = self._people(view, self._prior)
        self._plane.protect(self._outlines)
        return tuple(self._output(view, observation))

    @property
    def needs_foreground(self) -> bool:
        """Only when the project's own foreground was asked for; else the tracker subtracts the background itself."""
        return self._params.plane == "image" and self._params.detection.source == "given"

    def feedback(self) -> U8 | None:
        """(H, W) uint8 for ``Foreground``: PERSON where somebody is who has been seen to move; None at first."""
        if self._shape is None:
            return None
        mask = np.zeros(self._shape, dtype=np.uint8)
        for shape in self._outlines:
            cv2.fillPoly(mask, [np.round(shape).astype(np.int32)], PERSON)
        return mask

    def debug(self) -> TrackerDebug:
        """Measured ellipses, object ellipses, particles, and the foreground grid as a tile."""
        if self._view is None or self._prior is None:
            return TrackerDebug()
        objects, plane = self._objects, self._params.plane
        ids = [life.track_id for life in objects.lives]
        return draw(plane, self._view, self._prior, self._measured, objects.states, ids, objects.particles)

    def _follow(self, dt: float, view: PlaneView, prior: SizePrior, observation: Observation) -> None:
        self._objects.predict(dt, self._cells_per_m(view, prior, self._objects.states[:, 1]))
        self._filter(view, prior)
        self._judge(dt, view, prior, observation)

    def _replay(self, prior: SizePrior, observation: Observation) -> None:
        """Catch up with the frames that taught the size, so that who was there is believed as soon as it is known."""
        measured = self._measured
        for dt, view in self._unsized:
            flooded = float(view.mask.mean()) > self._params.detection.flooded
            self._measured = NO_ELLIPSES if flooded else fit_ellipses(view.mask, prior, self._fit)
            self._follow(dt, view, prior, observation)
        self._unsized, self._measured = [], measured

    def _step(self, time_s: float) -> float:
        dt = 0.0 if self._time is None else min(max(time_s - self._time, 0.0), LONGEST_STEP_S)
        self._time = time_s
        return dt

    def _resize(self, view: PlaneView | None) -> None:
        """A picture of another size is another scene: its objects cannot be carried over."""
        if view is None or self._view is None or view.mask.shape == self._view.mask.shape:
            return
        for life in self._objects.lives:
            self._objects.say(life, "pruned", f"the frame size changed to {view.mask.shape} cells")
        self._objects.keep(np.zeros(len(self._objects), dtype=np.bool_))
        self._learner = SizeLearner(self._params.size)
        self._prior = None
        self._unsized = []

    def _measure(self, view: PlaneView | None, observation: Observation) -> F64:
        if view is None or float(view.mask.mean()) > self._params.detection.flooded:
            return NO_ELLIPSES
        if self._params.plane == "floor":
            self._prior = floor_prior(self._params.size, view)
        else:
            given = given_prior(self._params.size, view)
            self._prior = given or self._learner.update(view.mask, observation.timestamp_s)
        if self._prior is None:
            return NO_ELLIPSES
        return fit_ellipses(view.mask, self._prior, self._fit)

    def _cells_per_m(self, view: PlaneView, prior: SizePrior, rows: F64) -> F64:
        if self._params.plane == "floor":
            return np.full(len(rows), 1.0 / view.scale)
        return np.asarray(2.0 * prior.half_lengths(rows) / self._params.size.object_length_m)

    def _filter(self, view: PlaneView, prior: SizePrior) -> None:
        """Weigh and resample the objects that were seen in the last frame.

        An object that was not seen keeps to its prediction here and is found again in ``_found``: weighed with others
        it would slip onto their measurements, where it costs no area outside. On the floor a newcomer, who may be a
        piece of somebody, has no say in where those stand who are believed.
        """
        turns, apart = [self._objects.that(seen=True)], 0.0
        if self._params.plane == "floor":
            turns = [self._objects.that(seen=True, confirmed=known) for known in (True, False)]
            apart = self._params.size.floor_separation_m / view.scale
        for turn in turns:
            self._objects.measure(np.flatnonzero(turn), self._measured, view.mask.shape, prior, apart)

    def _judge(self, dt: float, view: PlaneView, prior: SizePrior, observation: Observation) -> None:
        """Seen or not, births, deaths."""
        objects, p, shape = self._objects, self._params.life, view.mask.shape
        shares = measured_shares(self._measured, objects.ellipses(prior), shape)
        long = self._long(view, prior)
        for n, (life, (covered, own)) in enumerate(zip(objects.lives, shares, strict=True)):
            was = life.state
            objects.watch_move(n, prior)
            life.age_s += dt
            seen, alone = bool(covered >= p.seen_overlap), bool(own >= p.seen_overlap and long[n])
            observe(life, seen, alone, dt, p, believable=life.confirmed or self._plausible(n, view, observation))
            if was != life.state:
                objects.tell_state(life, covered)
        left = unexplained(self._measured, objects.ellipses(prior)[objects.that(seen=True)], shape, p.seen_overlap)
        for m in np.flatnonzero(left):
            left[m] = self._whole(view.to_plane(self._measured[m, :2]), view, observation)
        left = self._found(left, view, prior)
        left &= self._long_enough(view, prior, left)
        for ellipse in self._measured[left]:
            if self._separate(view.to_plane(ellipse[:2]), view, observation):
                self._bear(ellipse, int(left.sum()), view, prior)
        objects.bury(shape, prior)

    def _long(self, view: PlaneView, prior: SizePrior) -> Bool:
        """(N,) whether so much of each object's length shows as a person does, outside older ones, in the image."""
        if self._params.plane == "floor":
            return np.ones(len(self._objects), dtype=np.bool_)
        ellipses, p = self._objects.ellipses(prior), self._params.life
        least = np.where(self._objects.that(confirmed=True), p.least_length, p.newcomer_length)
        return length_shown(view.mask, ellipses, np.arange(len(ellipses)), prior) >= least

    def _long_enough(self, view: PlaneView, prior: SizePrior, left: Bool) -> Bool:
        """(M,) the same of the measurements, of which the unexplained are left what the others do not cover."""
        if self._params.plane == "floor":
            return np.ones(len(self._measured), dtype=np.bool_)
        order = np.argsort(left, kind="stable")
        return length_shown(view.mask, self._measured, order, prior) >= self._params.life.newcomer_length

    def _whole(self, place: F64, view: PlaneView, observation: Observation) -> bool:
        """On the floor, whether a person stands at a place [m], no piece of one who is seen; in the image always."""
        maps = observation.maps if self._params.plane == "floor" else None
        return maps is None or self._newcomers.whole(maps, place, self._seen_at(view))

    def _separate(self, place: F64, view: PlaneView, observation: Observation) -> bool:
        """On the floor, whether a place [m] can be told apart from all who are seen; in the image always."""
        maps = observation.maps if self._params.plane == "floor" else None
        return maps is None or not self._newcomers.split_off(maps, place, self._seen_at(view))

    def _seen_at(self, view: PlaneView) -> F64:
        """(N, 2) where the believed people are who are seen [m]."""
        return view.to_plane(self._objects.states[:, :2])[self._objects.that(seen=True, confirmed=True)]

    def _plausible(self, n: int, view: PlaneView, observation: Observation) -> bool:
        """Whether nothing but time speaks against believing an object."""
        place, life = view.to_plane(self._objects.states[n, :2]), self._objects.lives[n]
        if self._params.plane == "floor" and life.age_s < self._params.newcomers.confirm_s - 1e-9:
            return False
        return self._whole(place, view, observation) and self._separate(place, view, observation)

    def _found(self, left: Bool, view: PlaneView, prior: SizePrior) -> Bool:
        """Give unexplained measurements to objects unseen so far, nearest first; returns what is left."""
        objects, left = self._objects, left.copy()
        per_m = self._cells_per_m(view, prior, self._measured[:, 1])
        reach = self._params.life.reattach_m
        for away, n, m in reachable(self._measured, objects.states[:, :2], objects.deviations(), per_m, reach):
            if left[m] and (not objects.lives[n].seen or objects.lives[n].hidden):
                left[m] = False
                objects.find(n, self._measured[m], prior, float(per_m[m]), away)
        return left

    def _bear(self, ellipse: F64, candidates: int, view: PlaneView, prior: SizePrior) -> None:
        per_m = float(self._cells_per_m(view, prior, ellipse[1:2])[0])
        full, area = kernels.ellipse_sum(kernels.row_prefix(view.mask), *ellipse)
        x, y = view.to_plane(ellipse[:2]).tolist()
        self._objects.bear(ellipse, full / max(area, 1.0), candidates, prior, per_m, f"({x:.1f}, {y:.1f})")

    def _people(self, view: PlaneView, prior: SizePrior) -> list[F32]:
        """Outlines of objects that have proved to move; a ghost of the background never does, and is to be absorbed."""
        sure = [life.confirmed and life.seen and life.moved for life in self._objects.lives]
        grown = self._objects.ellipses(prior)[sure]
        grown[:, 2:4] *= 1.3
        return [outline(e, view) for e in grown]

    def _output(self, view: PlaneView, observation: Observation) -> list[TrackState]:
        assert self._prior is not None
        objects = self._objects
        ellipses = objects.ellipses(self._prior)
        if observation.maps is not None and self._params.plane == "floor":
            measure_axes(objects.lives, view, ellipses, observation.maps, self._params.size.floor_reach_m)
        rows = []
        for life, state, ellipse in zip(objects.lives, objects.states, ellipses, strict=True):
            velocity = state[[VX, VY]] * view.scale
            if self._params.plane == "floor":
                rows.append(floor_state(life, view, ellipse, velocity))
            else:
                rows.append(image_state(life, view, ellipse, velocity, self._camera))
        return rows
