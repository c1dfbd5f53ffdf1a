"""The particle filter: constant velocity, overlap likelihood, resampling, MAP (sections III and IV)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.carried import Carried
from calib.types import F64, I64, U8, Bool
from planview.tracking import body
from planview.tracking.ellipse_particle.fit import nearest_edge
from planview.tracking.ellipse_particle.size import Size

X, Y, VX, VY, LN_A, LN_B, ANGLE = range(7)
"""Columns of an object's state: position and velocity in cells (per second), logarithms of half length and half width
over the expected ones, angle of the length axis [rad]."""
SHAPE_SPREAD = 0.08
"""Stationary deviation of ln length and ln width of an object's ellipse about the expected. Our choice."""
OVERLAP_DEVIATION = 0.12
"""Deviation of the area difference in equation (8), as a share of one object's area. Our choice: a measured
ellipse moved by a fifth of its width."""
JITTER_M = 0.03
"""Deviation of the position per frame besides the acceleration's [m]: an outline is not a rigid body. Our choice."""
SHAPE_TIME_S = 1.0
"""Time in which size and angle forget [s]: a step."""
COVER_ROWS = 16
"""Rows in which what an ellipse covers is summed."""


class ParticleFilter(Carried):
    """Samples of the state of all objects (equation 9), equally weighted between frames.

    Attributes:
        particles: (P, N, 7) float64, columns ``X`` to ``ANGLE``.
    """

    CARRIED = "particles", "_surprise", "_rng"

    def __init__(self, count: int, speed_mps: float, rng: np.random.Generator) -> None:
        """Args: speed_mps: deviation of each velocity component of a new object."""
        self._speed_mps = speed_mps
        self._rng = rng
        self.particles: F64 = np.zeros((count, 0, 7))
        self._surprise: F64 = np.zeros((count, 0))

    def add(self, ellipse: F64, size: Size) -> None:
        """Append an object around a measured ellipse (x, y, a, b, angle), with a random walking velocity."""
        shape = (len(self.particles), 1)
        self.particles = np.concatenate([self.particles, np.zeros((*shape, 7))], axis=1)
        self._surprise = np.concatenate([self._surprise, np.zeros(shape)], axis=1)
        self._scatter(-1, ellipse, size, np.zeros(2), self._speed_mps)

    def find_again(self, n: int, ellipse: F64, size: Size, velocity: F64) -> None:
        """Sample object n again around a measured ellipse; velocity (2,) in cells per second."""
        self._scatter(n, ellipse, size, velocity, self._speed_mps / 2)

    def _scatter(self, n: int, ellipse: F64, size: Size, velocity: F64, speed_mps: float) -> None:
        """Sample object n around an ellipse."""
        x, y, a, b, angle = ellipse
        half = float(size.half_lengths(y))
        speed = speed_mps * float(size.cells_per_m(y))
        shape = SHAPE_SPREAD / 2
        mean = np.array([x, y, *velocity, math.log(a / half), math.log(b / (half * size.aspect)), angle])
        deviation = np.array([0.1 * b, 0.1 * b, speed, speed, shape, shape, size.lean / 2])
        self.particles[:, n] = mean + deviation * self._rng.standard_normal((len(self.particles), 7))

    def keep(self, index: I64) -> None:
        """Keep only the objects of these columns."""
        self.particles = self.particles[:, index].copy()
        self._surprise = self._surprise[:, index].copy()

    def predict(self, dt_s: float, size: Size, cells_per_m: F64) -> None:
        """Draw from the transition of equation (6), the proposal of equation (11), dt_s after the last frame.

        Args:
            cells_per_m: (N,) where each object is.
        """
        noise = self._rng.standard_normal(self.particles.shape, dtype=np.float32)
        position = self.particles[..., :VX]
        velocity = self.particles[..., VX:LN_A]
        shape = self.particles[..., LN_A:]
        push = body.ACCELERATION_MPS2 * cells_per_m[:, None] * dt_s
        pull = np.hypot(0.5 * push * dt_s, JITTER_M * cells_per_m[:, None])
        position += velocity * dt_s + pull * noise[..., :VX]
        velocity += push * noise[..., VX:LN_A]
        stays = math.exp(-dt_s / SHAPE_TIME_S)
        spread = np.array([SHAPE_SPREAD, SHAPE_SPREAD, size.lean])
        shape[:] = stays * shape + math.sqrt(1.0 - stays * stays) * spread * noise[..., LN_A:]
        self._surprise = 0.5 * (noise**2).sum(axis=2)

    def weigh(self, n: int, measured: U8, others: U8, size: Size, area: float) -> F64:
        """Weigh and resample one object, the others being where they are; its MAP estimate.

        Equation (8) is a Gaussian of |D| - |O n D|, D the union of the measurements, O that of the objects: with the
        others' part of both fixed it is one of what this object leaves of the rest of D, at least. As written it does
        not punish object area outside every measurement, so objects could drift off wherever others cover theirs: a
        Gaussian of |O| - |O n D| with the same deviation is added (our choice). One object at a time needs far fewer
        particles than the paper's joint state.

        Args:
            measured, others: (R, C) uint8, 1 inside the measurements and inside the other objects.
            area: of one object [cells], the unit of the deviation.
        Returns: (7,) the most probable particle, moved to the mean of its mode.
        """
        particles = self.particles[:, n].copy()
        free = measured > others
        empty = (measured | others) == 0
        covered, outside = overlap_areas(ellipses_of(particles, size), [free, empty])
        missed = covered.max() - covered
        log_likelihood = -0.5 * (missed**2 + outside**2) / (OVERLAP_DEVIATION * area) ** 2
        weights = np.exp(log_likelihood - log_likelihood.max())
        weights /= weights.sum()
        # The largest likelihood times transition density; alone it is as noisy as the sampling.
        best = particles[int(np.argmax(log_likelihood - self._surprise[:, n]))]
        width = 0.5 * float(size.half_lengths(best[Y])) * size.aspect
        away = ((particles[:, :VX] - best[:VX]) ** 2).sum(axis=1)
        near = weights * np.exp(-0.5 * away / width**2)
        comb = (np.arange(len(particles)) + self._rng.random()) / len(particles)
        index = np.searchsorted(np.cumsum(weights), comb)
        self.particles[:, n] = particles[np.minimum(index, len(particles) - 1)]
        return np.asarray(near @ particles / near.sum())


def ellipses_of(states: F64, size: Size) -> F64:
    """(N, 5) ellipses (x, y, a, b, angle) of (N, 7) states."""
    half = size.half_lengths(states[:, Y])
    long = half * np.exp(states[:, LN_A])
    wide = half * size.aspect * np.exp(states[:, LN_B])
    return np.column_stack([states[:, X], states[:, Y], long, wide, states[:, ANGLE]])


def overlap_areas(ellipses: F64, masks: Sequence[Bool]) -> F64:
    """(K, N) areas of (N, 5) ellipses inside each of K masks (R, C) [cells]."""
    x, y, a, b, angle = ellipses.T[..., None].astype(np.float32)
    n_rows, n_cols = masks[0].shape
    s = np.sin(angle)
    c = np.cos(angle)
    # In the row t * down below its centre an ellipse covers x + t * lean +- half.
    t = ((2.0 * np.arange(COVER_ROWS) + 1.0) / COVER_ROWS - 1.0).astype(np.float32)
    down = np.hypot(a * c, b * s)
    middle = x + t * ((a * a - b * b) * s * c / down)
    half = a * b / down * np.sqrt(1.0 - t * t)
    row = np.clip(np.rint(y + t * down), -1, n_rows).astype(np.int32) + 1
    first = nearest_edge(middle - half + 0.5, n_cols)
    last = nearest_edge(middle + half + 0.5, n_cols)
    # Left of each edge; nothing is covered beyond the border.
    sums = np.zeros((len(masks), n_rows + 2, n_cols + 1), np.int32)
    np.cumsum(masks, axis=2, out=sums[:, 1:-1, 1:])
    flat = sums.reshape(len(masks), -1)
    start = row * (n_cols + 1)
    covered = flat.take(start + last, axis=1) - flat.take(start + first, axis=1)
    return np.asarray(2.0 * down[:, 0] / COVER_ROWS * covered.sum(axis=2))
