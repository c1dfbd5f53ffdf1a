"""The tracker: measure, predict, weigh by overlap, judge existence."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calib.types import F32, F64, U8, Bool
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.ellipse_particle._kernels import VX, VY, X, Y
from planview.tracking.ellipse_particle.coverage import measured_shares, reachable, uncovered
from planview.tracking.ellipse_particle.drawing import draw, outline
from planview.tracking.ellipse_particle.fit import _area as kernels
from planview.tracking.ellipse_particle.fit.ellipses import SIZE_LIMIT, fit_ellipses
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.image_grid import regridded
from planview.tracking.ellipse_particle.known_size import is_flooded
from planview.tracking.ellipse_particle.objects import Objects
from planview.tracking.ellipse_particle.params import EllipseParticleParams
from planview.tracking.ellipse_particle.planes import Estimates, PlaneView, TrackingPlane
from planview.tracking.ellipse_particle.size_learning import SETTING_OUT_S
from planview.trajectories.state import TrackState

NO_ELLIPSES: F64 = np.zeros((0, 5))
STEP_MAX_S = 1.0
"""A gap in the recording longer than this is predicted over as if it were this long [s]."""
REPLAYED = 10
"""Frames before the size was known that are tracked once it is; a bound on the time of that one frame. Our choice."""
PROTECTED = 1.3
"""Outlines of people are kept out of the background so much larger: limbs reach out of an ellipse. Our choice."""


class EllipseParticleTracker:
    """Ellipses fitted to foreground, tracked by a particle filter without explicit association.

    Args:
        plane: the image, where no calibration is needed, or the floor.
        params: all parameters.
        seed: of the only random generator; one seed gives one result.
    """

    def __init__(self, plane: TrackingPlane, params: EllipseParticleParams | None = None, seed: int = 0) -> None:
        self._plane = plane
        self._params = params or EllipseParticleParams()
        self._seed = seed
        self.reset()

    def reset(self) -> None:
        """Forget people, sizes learned in tracking and the random state; ids start at 1 again."""
        rng = np.random.default_rng(self._seed)
        self._objects = Objects(self._params.filter, self._params.existence, self._plane.model, rng)
        self._plane.reset()
        self._time_s: float | None = None
        self._first_s = 0.0
        self._view: PlaneView | None = None
        self._prior: SizePrior | None = None
        self._judged: tuple[SizePrior, PlaneView] | None = None
        self._measured = NO_ELLIPSES
        self._unsized: list[tuple[float, Observation]] = []

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._objects.cycle.decisions

    @property
    def prior(self) -> SizePrior | None:
        """Size expected of objects [cells], None while it is being learned."""
        return self._prior

    @property
    def notes(self) -> tuple[str, ...]:
        """What was found out about the recording, a sentence each: the size of people."""
        return self._plane.notes

    @property
    def foreground_columns(self) -> int | None:
        """Columns of foreground that are enough; None for all."""
        return self._plane.foreground_columns

    def study(self, observations: Iterable[Observation]) -> None:
        """Learn the size of people from a recording's beginning, before its first frame is tracked; kept by ``reset``.

        On the floor it is known.
        """
        self._plane.study(observations)

    def feedback(self) -> U8 | None:
        """(H, W) uint8 for ``Foreground``: PERSON where there are people who have moved; None at first."""
        return self._plane.feedback()

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame.

        Returns:
            one state per object, tentative ones included; x, y, velocity and height are NaN in the image plane
            without a camera, the box is NaN on the floor.
        Raises:
            ValueError: the observation's arrays are not what they should be.
        """
        self._objects.cycle.begin(observation.timestamp_s)
        dt = self._step(observation.timestamp_s)
        view = self._plane(observation)
        if view is None:
            return ()
        before = self._carried_over(view)
        self._view = view
        self._prior = self._plane.prior(view)
        if self._prior is None:
            self._unsized = [*self._unsized, (dt, observation)][-REPLAYED:]
            return ()
        self._objects.aim(self._plane.model)
        if before is None:
            self._replay(self._prior)
        self._resize(view, self._prior)
        self._track(dt, view, self._prior)
        self._plane.protect(self._moved_people(view, self._prior))
        return tuple(self._plane.states(view, self._estimates(view, self._prior)))

    def debug(self) -> TrackerDebug:
        """Measured ellipses, object ellipses, particles, and the foreground grid as a tile."""
        if self._view is None or self._prior is None:
            return TrackerDebug()
        objects = self._objects
        ids = [e.who.track_id for e in objects.evidence]
        shapes = self._measured, objects.ellipses(self._prior), objects.particles
        return draw(self._plane.name, self._view, *shapes, ids)

    def _step(self, time_s: float) -> float:
        if self._time_s is None:
            self._first_s = self._time_s = time_s
        dt = min(max(time_s - self._time_s, 0.0), STEP_MAX_S)
        self._time_s = time_s
        return dt

    def _carried_over(self, view: PlaneView) -> SizePrior | None:
        """The size expected so far in cells of the view; objects go over to its grid, too."""
        before, prior = self._view, self._prior
        if before is None or prior is None or view.scale == before.scale:
            return prior
        ratio = before.scale / view.scale
        self._objects.rescale(ratio, *(float(v) for v in view.to_cells(before.to_plane(np.zeros(2)))))
        return regridded(prior, before, view)

    def _resize(self, view: PlaneView, prior: SizePrior) -> None:
        """Forget doubles once the size has changed much since it was last done, be it little by little."""
        was, on = self._judged or (prior, view)
        if self._judged is None or self._objects.resize(regridded(was, on, view), prior, SIZE_LIMIT, view.mask.shape):
            self._judged = prior, view

    def _fit(self, view: PlaneView, prior: SizePrior) -> F64:
        """(M, 5) ellipses fitted to the foreground, from nothing and from where known people are expected."""
        if is_flooded(view):
            return NO_ELLIPSES
        objects = self._objects
        known = objects.ellipses(prior)[objects.confirmed & objects.measured]
        return fit_ellipses(view.mask, prior, self._params.fit, self._plane.model, known)

    def _replay(self, prior: SizePrior) -> None:
        """Catch up with the frames that taught the size, so that people in them are confirmed once it is known."""
        cycle = self._objects.cycle
        now_s = cycle.now_s
        for dt, observation in self._unsized:
            view = self._plane.view(observation)
            if view is None:
                continue
            cycle.now_s = observation.timestamp_s
            self._track(dt, view, prior)
        self._unsized, cycle.now_s = [], now_s

    def _track(self, dt: float, view: PlaneView, prior: SizePrior) -> None:
        self._objects.predict(dt, self._plane.cells_per_m(view, prior, self._objects.states[:, Y]))
        self._measured = self._fit(view, prior)
        self._weigh(view, prior)
        self._observe(dt, view, prior)
        self._spawn(view, prior)
        self._objects.prune(view.mask.shape, prior)

    def _weigh(self, view: PlaneView, prior: SizePrior) -> None:
        """Weigh and resample the objects that were measured in the last frame.

        An object that was not keeps to its prediction here and is reacquired in ``_reacquire``: weighed with others it
        would slip onto their measurements, where it costs no area outside.
        """
        objects, apart = self._objects, self._plane.separation(view)
        for turn in self._plane.turns(objects.measured, objects.confirmed):
            objects.measure(turn, self._measured, view.mask.shape, prior, apart)

    def _observe(self, dt: float, view: PlaneView, prior: SizePrior) -> None:
        """Which objects are measured in this frame, and which of the new ones are people."""
        objects, min_overlap = self._objects, self._params.existence.min_overlap
        ellipses = objects.ellipses(prior)
        shares = measured_shares(self._measured, ellipses, view.mask.shape)
        long = self._plane.long_enough(view, ellipses, np.arange(len(ellipses)), objects.confirmed, prior)
        cut = objects.are_cut(view.mask.shape, prior)
        for n, (covered, own) in enumerate(shares):
            objects.watch_move(n, prior)
            alone = bool(own >= min_overlap and long[n])
            confirmable = objects.evidence[n].who.confirmed or self._confirmable(n, view, bool(cut[n]))
            objects.observe(n, bool(covered >= min_overlap), alone, dt, confirmable, float(covered))

    def _confirmable(self, n: int, view: PlaneView, cut: bool) -> bool:
        """Whether nothing but time speaks against confirming an object.

        In an image, two kinds must have moved. People of the first frame leave foreground behind where they stood until
        the background is known there. And what the border cuts may be a limb of a person who comes or goes.
        """
        if view.observation.motion is not None and not self._objects.evidence[n].moved:
            setting_out = view.observation.timestamp_s < self._first_s + SETTING_OUT_S
            if setting_out or cut:
                return False
        cell, known = self._objects.states[n, [X, Y]], self._known()
        if not cut and self._plane.may_be_part(view, cell, known):
            return False
        return self._plane.is_person(view, cell, known) and self._plane.is_separate(view, cell, known)

    def _known(self) -> F64:
        """(N, 2) centres of the confirmed people who are measured [cells]."""
        objects = self._objects
        return objects.states[:, [X, Y]][objects.measured & objects.confirmed]

    def _spawn(self, view: PlaneView, prior: SizePrior) -> None:
        """Measurements that no measured object covers: objects that come back, then new ones."""
        objects, shape = self._objects, view.mask.shape
        known = objects.ellipses(prior)[objects.measured]
        left = uncovered(self._measured, known, shape, self._params.existence.min_overlap)
        for m in np.flatnonzero(left):
            left[m] = self._plane.is_person(view, self._measured[m, :2], self._known())
        left = self._reacquire(left, view, prior)
        # The others come first: what they cover does not count for those that are left.
        order, unknown = np.argsort(left, kind="stable"), np.zeros(len(left), dtype=np.bool_)
        left &= self._plane.long_enough(view, self._measured, order, unknown, prior)
        candidates, people = int(left.sum()), self._known()
        for ellipse in self._measured[left]:
            if self._plane.is_separate(view, ellipse[:2], people):
                self._spawn_at(ellipse, candidates, view, prior)

    def _reacquire(self, left: Bool, view: PlaneView, prior: SizePrior) -> Bool:
        """Give uncovered measurements to objects that were not measured, nearest first; returns what is left."""
        objects, left = self._objects, left.copy()
        if not left.any():
            return left
        per_m = self._plane.cells_per_m(view, prior, self._measured[:, 1])
        reach = self._params.existence.reattach_m
        for away, n, m in reachable(self._measured, objects.states[:, [X, Y]], objects.deviations(), per_m, reach):
            e = objects.evidence[n]
            if left[m] and (not e.measured or e.shares):
                left[m] = False
                objects.reacquire(n, self._measured[m], prior, float(per_m[m]), away)
        return left

    def _spawn_at(self, ellipse: F64, candidates: int, view: PlaneView, prior: SizePrior) -> None:
        per_m = float(self._plane.cells_per_m(view, prior, ellipse[1:2])[0])
        covered, area = kernels.ellipse_sum(kernels.row_prefix(view.mask), *ellipse)
        x, y = view.to_plane(ellipse[:2])
        where = f"({x:.2f}, {y:.2f})"
        self._objects.spawn(ellipse, covered / max(area, 1.0), candidates, prior, per_m, where)

    def _moved_people(self, view: PlaneView, prior: SizePrior) -> list[F32]:
        """Outlines of objects that have proved to move; a ghost of the background never does, and is to be absorbed."""
        sure = [e.who.confirmed and e.measured and e.moved for e in self._objects.evidence]
        grown = self._objects.ellipses(prior)[sure]
        grown[:, 2:4] *= PROTECTED
        return [outline(e, view) for e in grown]

    def _estimates(self, view: PlaneView, prior: SizePrior) -> Estimates:
        objects = self._objects
        velocities = objects.states[:, [VX, VY]] * view.scale
        return Estimates(objects.evidence, objects.ellipses(prior), velocities)
