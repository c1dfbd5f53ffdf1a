"""Plain numpy twins of the particle filter's kernels; they define what the compiled loops compute."""

import numpy as np

from calib.types import F32, F64, I64


def propagate(particles: F64, noise: F32, dt: float, pull: F64, push: F64, keep: float, fresh: F64) -> tuple[F64, F64]:
    """Constant velocity with Gaussian noise, ellipse parameters that forget; and half the squared noise."""
    out = particles.copy()
    out[..., :2] += particles[..., 2:4] * dt + pull[:, None] * noise[..., :2]
    out[..., 2:4] += push[:, None] * noise[..., 2:4]
    out[..., 4:] = keep * particles[..., 4:] + fresh * noise[..., 4:]
    return out, 0.5 * (noise.astype(np.float64) ** 2).sum(axis=-1)


def copy_particles(particles: F64, surprise: F64, members: I64, index: I64) -> tuple[F64, F64]:
    """The members' states and costs of particle index[p] in particle p; other objects keep theirs."""
    states, costs = particles.copy(), surprise.copy()
    states[:, members] = particles[index][:, members]
    costs[:, members] = surprise[index][:, members]
    return states, costs


def draw_systematically(weights: F64, shift: float) -> I64:
    """Particles at a comb of equal steps through the running sum of the weights."""
    n = len(weights)
    return np.asarray(np.minimum(np.searchsorted(np.cumsum(weights), (np.arange(n) + shift) / n), n - 1), np.int64)


def mean_near(particles: F64, members: I64, best: int, weights: F64, radius: F64) -> F64:
    """(K, 7) weighted means, the weights times a Gaussian of the distance from particle ``best``."""
    states = particles[:, members]
    offset = (states[..., :2] - states[best, :, :2]) / radius[:, None]
    near = weights[:, None] * np.exp(-0.5 * (offset**2).sum(axis=-1))
    return np.asarray((near[..., None] * states).sum(axis=0) / near.sum(axis=0)[:, None])
