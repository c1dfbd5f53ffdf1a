"""The objects that are followed: particles, states and lives, kept in step."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F64, I64, Bool
from planview.tracking.base import Decision, DecisionKind
from planview.tracking.ellipse_particle.explain import measured_shares
from planview.tracking.ellipse_particle.fit.ellipses import SizePrior
from planview.tracking.ellipse_particle.groups import group, overlaps
from planview.tracking.ellipse_particle.life import Life, birth, gone
from planview.tracking.ellipse_particle.params import FilterParams, LifeParams
from planview.tracking.ellipse_particle.particles import VX, VY, ParticleFilter, ellipses_of, normalised, union_prefix


class Objects:
    """Everything known of the objects, and what is done to all of it at once.

    Args:
        filter_params, life_params: of the particles; of births and deaths.
        rng: the tracker's only random generator.

    Attributes:
        lives: one per object, in order of birth.
        states: (N, 7) float64 estimates, as in ``ParticleFilter.particles``.
        decisions: what happened in this frame.
    """

    def __init__(self, filter_params: FilterParams, life_params: LifeParams, rng: np.random.Generator) -> None:
        self._filter_params, self._params = filter_params, life_params
        self._filter = ParticleFilter(filter_params, rng)
        self._next_id = 1
        self.lives: list[Life] = []
        self.states: F64 = np.zeros((0, 7))
        self.decisions: list[Decision] = []

    def __len__(self) -> int:
        return len(self.lives)

    @property
    def particles(self) -> F64:
        """(P, N, 7) float64."""
        return self._filter.particles

    def ellipses(self, prior: SizePrior) -> F64:
        """(N, 5)."""
        return ellipses_of(self.states, prior)

    def deviations(self) -> F64:
        """(N, 2) spread of x and y [cells]."""
        return self._filter.deviations()

    def that(self, *, seen: bool | None = None, confirmed: bool | None = None) -> Bool:
        """(N,) the objects of which this holds; None: either."""
        return np.array(
            [seen in (None, life.seen) and confirmed in (None, life.confirmed) for life in self.lives], dtype=np.bool_
        )

    def say(self, life: Life, kind: DecisionKind, reason: str, value: float = math.nan) -> None:
        """Record a decision about an object."""
        self.decisions.append(Decision(life.track_id, kind, reason, value))

    def tell_state(self, life: Life, covered: float) -> None:
        """Record that an object is believed now, or lost; covered: share of its ellipse that is measured."""
        if life.state == "confirmed" and life.unseen_s == 0.0:
            self.say(life, "confirmed", f"probability {life.probability:.2f}", life.probability)
        elif life.state == "lost":
            unseen = f"measurements cover {covered:.2f} < {self._params.seen_overlap:.2f} of it"
            hidden = "too little of it shows outside older objects"
            self.say(life, "lost", hidden if life.hidden else unseen, covered)

    def watch_move(self, n: int, prior: SizePrior) -> None:
        """An object has moved when its centre is half a length or a width from its birthplace."""
        life, centre = self.lives[n], self.states[n, :2]
        offset = centre - life.birthplace
        a = prior.half_length(float(centre[1]))
        life.moved = life.moved or bool(np.hypot(offset[0] / (2 * a * prior.aspect), offset[1] / a) > 1.0)

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
            apart: least distance of two objects [cells]; 0 lets them hide one another.
        """
        if not len(active) or not len(measured):
            return
        ellipses = self.ellipses(prior)[active]
        margin = 1.5 * self.deviations()[active]
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
        self._filter.resample(chosen, log_likelihood - favour)

    def bear(
        self, ellipse: F64, fill: float, candidates: int, prior: SizePrior, cells_per_m: float, where: str
    ) -> None:
        """A new object at one of the unexplained measurements (see ``birth``).

        Args:
            fill: foreground share of the ellipse.
            candidates: number of unexplained measurements.
            where: its place in words.
        """
        self._filter.add(ellipse, prior, cells_per_m)
        life = birth(self._next_id, (float(ellipse[0]), float(ellipse[1])), fill, candidates, self._params)
        self._next_id += 1
        self.lives.append(life)
        self.states = np.concatenate([self.states, self.particles[:, -1].mean(axis=0)[None]])
        self.say(life, "spawned", f"a measurement at {where} overlaps no object", life.probability)

    def find(self, n: int, ellipse: F64, prior: SizePrior, cells_per_m: float, away_m: float) -> None:
        """Object n is seen again, at a measured ellipse ``away_m`` from its prediction [m]."""
        self._filter.place(n, ellipse, prior, cells_per_m, self.states[n, [VX, VY]])
        self.states[n] = self.particles[:, n].mean(axis=0)
        life = self.lives[n]
        unseen = max(life.unseen_s, life.shared_s)
        life.seen, life.hidden, life.unseen_s, life.shared_s = True, False, 0.0, 0.0
        self.say(life, "reacquired", f"found {away_m:.2f} m from its prediction after {unseen:.1f} s", away_m)

    def bury(self, shape: tuple[int, int], prior: SizePrior) -> None:
        """Remove objects that have left; at once those of which less than a quarter is inside the grid."""
        outside = self._outside(shape, prior)
        keep = np.ones(len(self), dtype=np.bool_)
        for n, life in enumerate(self.lives):
            probability = gone(life, self._params)
            limit = self._params.leave if life.confirmed else self._params.believe
            if outside[n]:
                keep[n] = False
                self.say(life, "pruned", "it has left the view")
            elif probability > limit:
                keep[n] = False
                waited = max(life.unseen_s, life.shared_s)
                why = f"unseen or shared for {waited:.1f} s, left with probability {probability:.2f}"
                self.say(life, "pruned", why, probability)
        self.keep(keep)

    def _outside(self, shape: tuple[int, int], prior: SizePrior) -> Bool:
        """(N,) objects that are out of the grid but for a quarter: by 0.4 of the half length or width."""
        x, y = self.states[:, 0], self.states[:, 1]
        dy = 0.4 * prior.half_lengths(y)
        dx, (rows, cols) = dy * prior.aspect, shape
        inside = (x >= -0.5 - dx) & (x <= cols - 0.5 + dx) & (y >= -0.5 - dy) & (y <= rows - 0.5 + dy)
        return np.asarray(~inside)

    def resize(self, before: SizePrior, after: SizePrior, limit: float, shape: tuple[int, int]) -> None:
        """Forget objects that are doubles now that another size is expected.

        Where the expected size changes by more than ``limit``, either way, several objects may have been found in one
        person; of those only the oldest stays, and others of which it covers little.
        """
        rows = self.states[:, 1]
        changed = np.abs(np.log(after.half_lengths(rows) / before.half_lengths(rows))) > math.log(limit)
        if not changed.any():
            return
        ellipses = self.ellipses(after)
        everywhere = np.array([[shape[1] / 2, shape[0] / 2, 2.0 * max(shape), 2.0 * max(shape), 0.0]])
        own = measured_shares(everywhere, ellipses, shape)[:, 1]
        keep = ~changed | (own >= 1.0 - self._params.seen_overlap)
        for n in np.flatnonzero(~keep):
            self.say(self.lives[n], "pruned", "people here are larger than was believed: an older object has it")
        self.keep(keep)

    def keep(self, keep: Bool) -> None:
        """Forget the other objects."""
        if keep.all():
            return
        index = np.flatnonzero(keep)
        self._filter.remove(index.tolist())
        self.states = self.states[index]
        self.lives = [self.lives[i] for i in index]
