"""Compiled kernel of the likelihood; ``tests/reference/ellipses.py`` defines it in plain numpy."""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I64
from planview._ellipse_kernels import between, conic, rows_of, span


@njit(cache=True, nogil=True)
def union_overlap(
    particles: F64,
    members: I64,
    measured: F64,
    allowed: F64,
    half0: float,
    half1: float,
    least: float,
    aspect: float,
    out: F64,
) -> None:
    """Area of the union of the members' ellipses in each particle, inside the measured and outside the allowed cells.

    particles: (P, N, 7) x, y, vx, vy, ln length ratio, ln width ratio, angle; members: (K,) columns of N;
    measured, allowed: (R, C + 1) row sums (``row_prefix``) of the cells to be covered, and of those that may be;
    max(least, half0 + half1 * y): half length expected in row y; aspect: width / length.
    out: (P, 2) covered measured area, object area in the grid outside the allowed cells.
    """
    n_rows = measured.shape[0]
    n_cols = measured.shape[1] - 1
    k_all = members.shape[0]
    forms = np.empty((k_all, 5))
    limits = np.empty((k_all, 2), dtype=np.int64)
    lows = np.empty(k_all)
    highs = np.empty(k_all)
    # Every row of a small ellipse, every second or third of a tall one: a dozen rows give its area to 3 %, a quarter
    # of the likelihood's deviation.
    smallest = float(n_rows)
    for k in range(k_all):
        y = particles[0, members[k], 1]
        smallest = min(smallest, max(least, half0 + half1 * y))
    step = max(1, int(smallest / 6.0))
    for p in range(particles.shape[0]):
        first = n_rows
        last = -1
        for k in range(k_all):
            n = members[k]
            y = particles[p, n, 1]
            base = max(least, half0 + half1 * y)
            a = base * math.exp(particles[p, n, 4])
            b = base * aspect * math.exp(particles[p, n, 5])
            qxx, qxy, qyy = conic(a, b, particles[p, n, 6])
            forms[k, 0] = qxx
            forms[k, 1] = qxy
            forms[k, 2] = qyy
            forms[k, 3] = particles[p, n, 0]
            forms[k, 4] = y
            r0, r1 = rows_of(y, a, b, particles[p, n, 6], n_rows)
            limits[k, 0] = r0
            limits[k, 1] = r1
            first = min(first, r0)
            last = max(last, r1)
        covered = 0.0
        outside = 0.0
        for r in range(first + (-first) % step, last + 1, step):
            count = 0
            for k in range(k_all):
                if r < limits[k, 0] or r > limits[k, 1]:
                    continue
                lo, hi = span(forms[k, 0], forms[k, 1], forms[k, 2], r - forms[k, 4])
                lo = max(lo + forms[k, 3], -0.5)
                hi = min(hi + forms[k, 3], n_cols - 0.5)
                if hi <= lo:
                    continue
                # Insertion keeps the spans of this row sorted by their lower end.
                i = count
                while i > 0 and lows[i - 1] > lo:
                    lows[i] = lows[i - 1]
                    highs[i] = highs[i - 1]
                    i -= 1
                lows[i] = lo
                highs[i] = hi
                count += 1
            i = 0
            while i < count:
                lo = lows[i]
                hi = highs[i]
                i += 1
                while i < count and lows[i] <= hi:
                    hi = max(hi, highs[i])
                    i += 1
                covered += between(measured, r, lo, hi, n_cols)
                outside += hi - lo - between(allowed, r, lo, hi, n_cols)
        out[p, 0] = covered * step
        out[p, 1] = outside * step


@njit(cache=True, nogil=True)
def propagate(
    particles: F64, noise: F32, dt: float, pull: F64, push: F64, keep: float, fresh: F64, surprise: F64
) -> None:
    """Constant velocity with Gaussian noise for all particles, in place (equation 6).

    particles: (P, N, 7); noise: (P, N, 7) standard normal; pull, push: (N,) deviations of position and velocity;
    keep, fresh: (3,) share of the old ellipse parameters, deviation of the new part;
    surprise: (P, N) receives half the squared noise, minus the logarithm of the transition density.
    """
    for p in range(particles.shape[0]):
        for n in range(particles.shape[1]):
            state = particles[p, n]
            draw = noise[p, n]
            state[0] += state[2] * dt + pull[n] * draw[0]
            state[1] += state[3] * dt + pull[n] * draw[1]
            state[2] += push[n] * draw[2]
            state[3] += push[n] * draw[3]
            total = 0.0
            for i in range(4):
                total += draw[i] * draw[i]
            for i in range(4, 7):
                state[i] = keep * state[i] + fresh[i - 4] * draw[i]
                total += draw[i] * draw[i]
            surprise[p, n] = 0.5 * total


@njit(cache=True, nogil=True)
def copy_particles(particles: F64, surprise: F64, members: I64, index: I64) -> None:
    """particles[:, members] = particles[index][:, members], the same for surprise."""
    states = particles[:, members]
    costs = surprise[:, members]
    for p in range(particles.shape[0]):
        for k in range(members.shape[0]):
            n = members[k]
            surprise[p, n] = costs[index[p], k]
            for i in range(7):
                particles[p, n, i] = states[index[p], k, i]
