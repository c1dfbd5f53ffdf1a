"""The particle filter: joint state, constant velocity, overlap likelihood, resampling, MAP (sections III and IV)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.types import F64, I64, U8
from planview.tracking.ellipse_particle import _kernels as kernels
from planview.tracking.ellipse_particle._kernels import (
    ANGLE,
    COVERED,
    LN_A,
    LN_B,
    OUTSIDE,
    VX,
    VY,
    Transition,
    X,
    Y,
)
from planview.tracking.ellipse_particle.fit import _area as ellipse_kernels
from planview.tracking.ellipse_particle.fit.ellipses import paint_union
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.params import ParticleFilterParams

STATE = 7
"""Length of an object's state, columns ``X`` to ``ANGLE``."""
JITTER_M = 0.03
"""Deviation of the position per frame beside the acceleration's [m]: an outline is not a rigid body. Our choice."""
SHAPE_TIME_S = 1.0
"""Time in which size and angle forget [s]: a step."""
YIELDING = 0.25
"""Deviation of the distance between two bodies from the least, as a share of it: bodies give and ellipses slip. Our
choice."""


class ParticleFilter:
    """Samples of the joint state of all objects (equation 9), equally weighted between frames.

    Weights are resampled away within each group in every frame (SIR), so particles of independent groups may be
    paired freely: the array always stands for the product of the groups' posteriors.

    Attributes:
        particles: (P, N, 7) float64, the N objects' states in each particle.
        plane: what is known of directions now.
    """

    def __init__(self, params: ParticleFilterParams, plane: PlaneModel, rng: np.random.Generator) -> None:
        self._params = params
        self.plane = plane
        self._rng = rng
        self._surprise = np.zeros((params.particles, 0))
        self.particles: F64 = np.zeros((params.particles, 0, STATE))

    def __len__(self) -> int:
        return int(self.particles.shape[1])

    def add(self, ellipse: F64, prior: SizePrior, cells_per_m: float, velocity: F64 | None = None) -> None:
        """Append an object around a measured ellipse; an unknown velocity is drawn from walking speeds."""
        self.particles = np.concatenate([self.particles, np.empty((self._params.particles, 1, STATE))], axis=1)
        self._surprise = np.concatenate([self._surprise, np.zeros((self._params.particles, 1))], axis=1)
        self.place(len(self) - 1, ellipse, prior, cells_per_m, velocity)

    def place(self, n: int, ellipse: F64, prior: SizePrior, cells_per_m: float, velocity: F64 | None = None) -> None:
        """Redraw object n around a measured ellipse (x, y, a, b, angle)."""
        p = self._params
        half = prior.half_length(float(ellipse[1]))
        mean = np.zeros(STATE)
        mean[[X, Y]] = ellipse[:2]
        mean[[VX, VY]] = 0.0 if velocity is None else velocity
        mean[LN_A] = math.log(ellipse[2] / half)
        mean[LN_B] = math.log(ellipse[3] / (half * prior.aspect))
        mean[ANGLE] = ellipse[4]
        speed = p.spawn_speed_mps * cells_per_m * (1.0 if velocity is None else 0.5)
        place = 0.1 * ellipse[3]
        angle = self.plane.angle_walk / 2
        deviation = np.array([place, place, speed, speed, p.shape_spread / 2, p.shape_spread / 2, angle])
        self.particles[:, n] = mean + deviation * self._rng.standard_normal((p.particles, STATE))

    def remove(self, keep: Sequence[int]) -> None:
        """Keep only the objects of these columns."""
        self.particles = np.ascontiguousarray(self.particles[:, list(keep)])
        self._surprise = np.ascontiguousarray(self._surprise[:, list(keep)])

    def rescale(self, ratio: float, origin: tuple[float, float]) -> None:
        """Go over to another grid (see ``rescaled``)."""
        self.particles = rescaled(self.particles, ratio, origin)

    def predict(self, dt_s: float, cells_per_m: F64) -> None:
        """Draw from the transition of equation (6), the proposal of equation (11).

        Args:
            dt_s: time since the last frame [s].
            cells_per_m: (N,) cells per metre where each object is.
        """
        p = self._params
        noise = self._rng.standard_normal((p.particles, len(self), STATE), dtype=np.float32)
        push = p.acceleration_mps2 * cells_per_m * dt_s
        pull = np.hypot(0.5 * push * dt_s, JITTER_M * cells_per_m)
        keep = math.exp(-dt_s / SHAPE_TIME_S)
        spread = np.array([p.shape_spread, p.shape_spread, self.plane.angle_walk])
        fresh = math.sqrt(1.0 - keep * keep) * spread
        common = math.sqrt(self.plane.looseness**2 - 1.0)
        if common > 0:
            # The density of ``estimate`` takes this for deviations of each: it leans to the expected size.
            noise[..., [LN_A, LN_B]] += common * self._rng.standard_normal((p.particles, len(self), 1), np.float32)
        kernels.propagate(self.particles, noise, Transition(dt_s, pull, push, keep, fresh), self._surprise)
        # Leaning further than anything measured, one object would cover two people behind one another.
        if self.plane.upright:
            angle = self.particles[..., ANGLE]
            np.clip(angle, -self.plane.angle_limit, self.plane.angle_limit, out=angle)

    def weigh(self, members: I64, measured: F64, prior: SizePrior, area: float) -> F64:
        """Logarithm of the likelihood of equation (8) for a group, plus the term for area outside measurements.

        Equation (8) is a Gaussian of |D| - |O n D|, D the union of the measurements, O that of the objects; the added
        term is a Gaussian of |O| - |O n D| with the same deviation.

        Args:
            members: (K,) objects of the group.
            measured: (R, C + 1) row sums of the measured union (``row_prefix``).
            prior: size expected per row.
            area: area of one object [cells], the unit of the deviation.
        Returns:
            (P,) float64.
        """
        out = np.empty((self._params.particles, 2))
        kernels.union_overlap(self.particles, members, measured, measured, prior.law, out)
        missed = float(measured[:, -1].sum()) - out[:, COVERED]
        sigma = self._params.overlap_deviation * area * math.sqrt(len(members))
        return np.asarray(-0.5 * (missed**2 + self.plane.outside_weight * out[:, OUTSIDE] ** 2) / sigma**2)

    def apart(self, members: I64, distance: float) -> F64:
        """Logarithm of the likelihood that bodies stand where a group's centres are: no body stands inside another.

        Ours (the paper works in images, where people hide one another): what two centres lack of the smallest distance
        is Gaussian, with the share ``YIELDING`` of it as the deviation.

        Args:
            distance: smallest distance of two centres [cells].
        Returns:
            (P,) float64.
        """
        out = np.zeros(self._params.particles)
        for k, n in enumerate(members):
            offset = self.particles[:, members[:k], :2] - self.particles[:, n, None, :2]
            lacking = np.maximum(0.0, 1.0 - np.hypot(offset[..., 0], offset[..., 1]) / distance)
            out -= 0.5 * np.sum((lacking / YIELDING) ** 2, axis=1)
        return out

    def partition(
        self, members: I64, measured: F64, states: F64, shape: tuple[int, int], prior: SizePrior, area: float
    ) -> F64:
        """Resample each object of a group by itself, before the group is judged jointly.

        A joint sample is good only when all its objects are; of several objects hardly any is. So each object is first
        drawn to what the others leave of the measured union: inside the others' predicted ellipses there is nothing
        to gain or to lose (independent partitions, Orton and Fitzgerald 2002; ours, the paper has the joint step only).

        Args:
            members: (K,) objects of the group.
            measured: (M, 5) measurements of the group.
            states: (K, 7) predicted states of the members.
            shape: (R, C) of the grid.
            prior, area: as in ``weigh``.
        Returns:
            (P,) logarithm of the density by which the particles are now favoured, to be taken off ``weigh``.
        """
        favour = np.zeros(self._params.particles)
        ellipses = ellipses_of(states, prior)
        sigma = self._params.overlap_deviation * area
        out = np.empty((self._params.particles, 2))
        target = paint_union(measured, shape)
        for k, n in enumerate(members):
            others = paint_union(np.delete(ellipses, k, axis=0), shape)
            alone = np.array([n])
            left, allowed = _prefix(target & (1 - others)), _prefix(target | others)
            kernels.union_overlap(self.particles, alone, left, allowed, prior.law, out)
            missed = out[:, COVERED].max() - out[:, COVERED]
            log_likelihood = -0.5 * (missed**2 + self.plane.outside_weight * out[:, OUTSIDE] ** 2) / sigma**2
            favour += log_likelihood[self.resample(alone, normalised(log_likelihood))]
        return favour

    def estimate(self, members: I64, log_likelihood: F64, radius: F64, weights: F64) -> F64:
        """MAP estimate of a group: the most probable particle, moved to the mean of its mode.

        The most probable particle has the largest likelihood times transition density. Alone it is as noisy as the
        sampling; so each object takes the weighted mean of the particles within ``radius`` (K,) [cells] of it
        (one mean-shift step with a Gaussian kernel).

        Args:
            log_likelihood: (P,) ``weigh``.
            weights: (P,) of the particles, which differ from the likelihood after ``partition``.
        Returns:
            (K, 7) states.
        """
        best = int(np.argmax(log_likelihood - self._surprise[:, members].sum(axis=1)))
        states = np.empty((len(members), STATE))
        kernels.mean_near(self.particles, members, best, weights, radius, states)
        return states

    def resample(self, members: I64, weights: F64) -> I64:
        """Draw particles of a group in proportion to (P,) weights, systematically: plain SIR with less variance.

        Returns:
            (P,) the particle from which each was copied.
        """
        index = np.empty(self._params.particles, np.int64)
        kernels.draw_systematically(weights, self._rng.random(), index)
        kernels.copy_particles(self.particles, self._surprise, members, index)
        return index

    def means(self) -> F64:
        """(N, 7) mean state of each object."""
        return np.asarray(self.particles.mean(axis=0))

    def deviations(self) -> F64:
        """(N, 2) standard deviation of each object's x and y [cells]."""
        return np.asarray(self.particles[..., :2].std(axis=0))


def normalised(log_weights: F64) -> F64:
    """Weights that sum to one from their logarithms."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())


def rescaled(states: F64, ratio: float, origin: tuple[float, float]) -> F64:
    """(..., 7) states on a grid of ``ratio`` times as many cells, whose coordinates of cell (0, 0) are ``origin``."""
    out = states.copy()
    out[..., X : VY + 1] *= ratio
    out[..., [X, Y]] += origin
    return out


def ellipses_of(states: F64, prior: SizePrior) -> F64:
    """(N, 5) ellipses (x, y, a, b, angle) of (N, 7) states."""
    half = prior.half_lengths(states[:, Y])
    return np.column_stack([
        states[:, X], states[:, Y], half * np.exp(states[:, LN_A]),
        half * prior.aspect * np.exp(states[:, LN_B]), states[:, ANGLE],
    ])  # fmt: skip


def union_prefix(ellipses: F64, shape: tuple[int, int]) -> F64:
    """Row sums of the union of (M, 5) measured ellipses."""
    return _prefix(paint_union(ellipses, shape))


def _prefix(mask: U8) -> F64:
    return np.asarray(ellipse_kernels.row_prefix(mask))
