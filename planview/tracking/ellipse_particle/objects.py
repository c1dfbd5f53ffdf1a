"""The objects that are tracked: particles, states and existence, kept in step."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F64, I64, Bool
from planview.tracking.ellipse_particle._kernels import VX, VY, X, Y
from planview.tracking.ellipse_particle.coverage import measured_shares
from planview.tracking.ellipse_particle.existence import ExistenceEvidence, departure, spawn_log_odds
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.groups import group, overlaps
from planview.tracking.ellipse_particle.params import ExistenceParams, ParticleFilterParams
from planview.tracking.ellipse_particle.particles import ParticleFilter, ellipses_of, normalised, rescaled, union_prefix
from planview.tracking.lifecycle import LifeCycle

OUTSIDE = 0.4
"""An object whose centre is so many half lengths or widths beyond the grid has but a quarter of its area inside."""
REACH_SIGMAS = 1.5
"""Measurements within so many deviations of an object's predicted outline may be its own. Our choice."""


class Objects:
    """Everything known of the objects, and what is done to all of it at once.

    Args:
        filter_params, params: of the particles; of existence.
        plane: what the plane says about ellipses.
        rng: the tracker's only random generator.

    Attributes:
        cycle: ids, states and the log of decisions.
        evidence: one per object, in order of ids.
        states: (N, 7) float64 estimates, as in ``ParticleFilter.particles``.
    """

    def __init__(
        self, filter_params: ParticleFilterParams, params: ExistenceParams, plane: PlaneModel, rng: np.random.Generator
    ) -> None:
        self._filter_params, self._params = filter_params, params
        self._filter = ParticleFilter(filter_params, plane, rng)
        self.cycle = LifeCycle()
        self.evidence: list[ExistenceEvidence] = []
        self.states: F64 = np.zeros((0, 7))

    def aim(self, plane: PlaneModel) -> None:
        """Take over what is known of directions now."""
        self._filter.plane = plane

    def __len__(self) -> int:
        return len(self.evidence)

    @property
    def particles(self) -> F64:
        """(P, N, 7) float64."""
        return self._filter.particles

    @property
    def measured(self) -> Bool:
        """(N,) objects that measurements cover in this frame."""
        return np.array([e.measured for e in self.evidence], dtype=np.bool_)

    @property
    def confirmed(self) -> Bool:
        """(N,) objects that have been confirmed."""
        return np.array([e.who.confirmed for e in self.evidence], dtype=np.bool_)

    def ellipses(self, prior: SizePrior) -> F64:
        """(N, 5)."""
        return ellipses_of(self.states, prior)

    def deviations(self) -> F64:
        """(N, 2) spread of x and y [cells]."""
        return self._filter.deviations()

    def predict(self, dt_s: float, cells_per_m: F64) -> None:
        """Move all particles on; states become their means."""
        self._filter.predict(dt_s, cells_per_m)
        self.states = self._filter.means()

    def measure(self, active: I64, measured: F64, shape: tuple[int, int], prior: SizePrior, apart: float) -> None:
        """Weigh and resample each group of the active objects with the measurements within its reach.

        Args:
            active: (K,) which objects.
            measured: (M, 5) ellipses.
            shape: (R, C) of the grid.
            apart: smallest distance of two objects [cells]; 0 lets them hide one another.
        """
        if not len(active) or not len(measured):
            return
        ellipses = self.ellipses(prior)[active]
        margin = REACH_SIGMAS * self.deviations()[active]
        near, reached = overlaps(ellipses, ellipses, margin), overlaps(ellipses, measured, margin)
        for members, theirs in group(near, reached, self._filter_params.joint):
            if len(theirs):
                self._measure_group(active[members], measured[theirs], ellipses[members], shape, prior, apart)

    def _measure_group(
        self, chosen: I64, measured: F64, ellipses: F64, shape: tuple[int, int], prior: SizePrior, apart: float
    ) -> None:
        area = float(np.mean(np.pi * ellipses[:, 2] * ellipses[:, 3]))
        favour: F64 = np.zeros(self._filter_params.particles)
        if len(chosen) > 1 and not self._filter_params.joint:
            favour = self._filter.partition(chosen, measured, self.states[chosen], shape, prior, area)
        log_likelihood = self._filter.weigh(chosen, union_prefix(measured, shape), prior, area)
        if apart > 0:
            log_likelihood += self._filter.apart(chosen, apart)
        weights = normalised(log_likelihood - favour)
        self.states[chosen] = self._filter.estimate(chosen, log_likelihood, 0.5 * ellipses[:, 3], weights)
        self._filter.resample(chosen, weights)

    def observe(self, n: int, measured: bool, own: bool, dt_s: float, confirmable: bool, covered: float) -> None:
        """Take one frame into account for object n; its state follows.

        Args:
            measured, own: see ``ExistenceEvidence.update``.
            dt_s: time since the last frame [s].
            confirmable: nothing but time speaks against confirming it.
            covered: share of its ellipse that measurements cover.
        """
        e = self.evidence[n]
        e.update(measured, own, dt_s, confirmable, self._params)
        if measured and own and confirmable and e.probability >= self._params.confirm_probability:
            self.cycle.confirm(e.who, f"probability {e.probability:.2f}", e.probability)
        if e.observed:
            again = f"measurements cover {covered:.2f} of it where it was predicted"
            self.cycle.observe(e.who, again if e.who.state == "lost" else "", covered)
        else:
            few = f"measurements cover {covered:.2f} < {self._params.min_overlap:.2f} of it"
            self.cycle.miss(e.who, "too little of it shows outside older objects" if e.shares else few, covered)

    def watch_move(self, n: int, prior: SizePrior) -> None:
        """An object has moved when its centre is half a length from its first place."""
        e, centre = self.evidence[n], self.states[n, [X, Y]]
        e.moved = e.moved or bool(np.hypot(*(centre - e.spawned_at)) > prior.half_length(float(centre[1])))

    def spawn(
        self, ellipse: F64, fill: float, candidates: int, prior: SizePrior, cells_per_m: float, where: str
    ) -> None:
        """A new object at one of the uncovered measurements (see ``spawn_log_odds``).

        Args:
            fill: foreground share of the ellipse.
            candidates: number of uncovered measurements.
            where: its place in words.
        """
        self._filter.add(ellipse, prior, cells_per_m)
        e = ExistenceEvidence(
            self.cycle.spawn(f"a measurement at {where} overlaps no object", fill),
            (float(ellipse[0]), float(ellipse[1])),
            spawn_log_odds(fill, candidates, self._params),
        )
        self.evidence.append(e)
        self.states = np.concatenate([self.states, self.particles[:, -1].mean(axis=0)[None]])

    def reacquire(self, n: int, ellipse: F64, prior: SizePrior, cells_per_m: float, away_m: float) -> None:
        """Object n is at a measured ellipse again, ``away_m`` from its prediction [m]."""
        self._filter.place(n, ellipse, prior, cells_per_m, self.states[n, [VX, VY]])
        self.states[n] = self.particles[:, n].mean(axis=0)
        e = self.evidence[n]
        reason = f"measured {away_m:.2f} m from its prediction after {e.waited_s:.1f} s"
        e.found()
        self.cycle.observe(e.who, reason, away_m)

    def prune(self, shape: tuple[int, int], prior: SizePrior) -> None:
        """Remove objects that have left; at once those of which less than a quarter is inside the grid."""
        outside = self._beyond(OUTSIDE, shape, prior)
        keep = np.ones(len(self), dtype=np.bool_)
        for n, e in enumerate(self.evidence):
            probability = departure(e, self._params)
            if outside[n]:
                keep[n] = False
                self.cycle.prune(e.who, "it has left the view")
            elif probability > self._params.confirm_probability:
                keep[n] = False
                why = f"unmeasured or shared for {e.waited_s:.1f} s, left with probability {probability:.2f}"
                self.cycle.prune(e.who, why, probability)
        self.keep(keep)

    def are_cut(self, shape: tuple[int, int], prior: SizePrior) -> Bool:
        """(N,) objects that the border of the grid cuts."""
        return self._beyond(-1.0, shape, prior)

    def _beyond(self, share: float, shape: tuple[int, int], prior: SizePrior) -> Bool:
        """(N,) objects whose centre is farther outside the grid than a share of their half axes, inside if negative."""
        x, y = self.states[:, X], self.states[:, Y]
        dy = share * prior.half_lengths(y)
        dx, (rows, cols) = dy * prior.aspect, shape
        inside = (x >= -0.5 - dx) & (x <= cols - 0.5 + dx) & (y >= -0.5 - dy) & (y <= rows - 0.5 + dy)
        return np.asarray(~inside)

    def resize(self, before: SizePrior, after: SizePrior, limit: float, shape: tuple[int, int]) -> bool:
        """Forget objects that are doubles now that another size is expected; returns whether it is where objects are.

        Where the expected length or width changes by more than ``limit``, either way, several objects may have been
        found in one person; of those only the oldest stays, and others of which it covers little.
        """
        rows = self.states[:, Y]
        longer = np.log(after.half_lengths(rows) / before.half_lengths(rows))
        wider = longer + math.log(after.aspect / before.aspect)
        changed = np.maximum(np.abs(longer), np.abs(wider)) > math.log(limit)
        if not changed.any():
            return False
        ellipses = self.ellipses(after)
        everywhere = np.array([[shape[1] / 2, shape[0] / 2, 2.0 * max(shape), 2.0 * max(shape), 0.0]])
        own = measured_shares(everywhere, ellipses, shape)[:, 1]
        self.discard(changed & (own < 1.0 - self._params.min_overlap), "another size of people: an older object has it")
        return True

    def rescale(self, ratio: float, x: float, y: float) -> None:
        """Go over to another grid: cells become ``ratio`` times as many, cell (0, 0) is at (x, y) there."""
        self._filter.rescale(ratio, (x, y))
        self.states = rescaled(self.states, ratio, (x, y))
        for e in self.evidence:
            e.spawned_at = e.spawned_at[0] * ratio + x, e.spawned_at[1] * ratio + y

    def discard(self, drop: Bool, reason: str) -> None:
        """Prune objects (N,) for one reason."""
        for n in np.flatnonzero(drop):
            self.cycle.prune(self.evidence[n].who, reason)
        self.keep(~drop)

    def keep(self, keep: Bool) -> None:
        """Forget the other objects."""
        if keep.all():
            return
        index = np.flatnonzero(keep)
        self._filter.remove(index.tolist())
        self.states = self.states[index]
        self.evidence = [self.evidence[i] for i in index]
