"""Compiled kernels of the particle filter; ``tests/reference/particles.py`` and ``ellipses.py`` define them."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I64
from planview.tracking.ellipse_particle.fit._area import between, conic, half_length
from planview.tracking.ellipse_particle.fit.prior import SizeLaw

X, Y, VX, VY, LN_A, LN_B, ANGLE = range(7)
"""Columns of an object's state: position and velocity in cells (per second), logarithms of half length and half width
over the size prior's, angle of the length axis [rad]."""
COVERED, OUTSIDE = range(2)
"""Columns of what ``union_overlap`` gives per particle."""


class Transition(NamedTuple):
    """One step of the motion model.

    Attributes:
        dt: time [s].
        pull, push: (N,) deviations of position and velocity [cells, cells/s].
        keep: share of the old ellipse parameters.
        fresh: (3,) deviations of what is new in ``LN_A``, ``LN_B``, ``ANGLE``.
    """

    dt: float
    pull: F64
    push: F64
    keep: float
    fresh: F64


@njit(cache=True, nogil=True)
def union_overlap(particles: F64, members: I64, measured: F64, allowed: F64, law: SizeLaw, out: F64) -> None:
    """Area of the union of the members' ellipses in each particle, inside the measured and outside the allowed cells.

    particles: (P, N, 7), columns ``X`` to ``ANGLE``; members: (K,) columns of N;
    measured, allowed: (R, C + 1) row sums (``row_prefix``) of the cells to be covered, and of those that may be;
    law: size expected per row.
    out: (P, 2), columns ``COVERED`` (measured area covered), ``OUTSIDE`` (object area in the grid that is not allowed).
    """
    k_all = members.shape[0]
    forms = np.empty((k_all, 5))
    limits = np.empty((k_all, 2), dtype=np.int64)
    spans = np.empty((k_all, 2))
    # Every row of a small ellipse, every second or third of a tall one: a dozen rows give its area to 3 %, a quarter
    # of the likelihood's deviation.
    smallest = float(measured.shape[0])
    for k in range(k_all):
        smallest = min(smallest, half_length(law, particles[0, members[k], Y]))
    step = max(1, int(smallest / 6.0))
    same = measured is allowed
    rows = np.empty((2, measured.shape[0]))
    for p in range(particles.shape[0]):
        first = measured.shape[0]
        last = -1
        for k in range(k_all):
            shape_of(particles[p, members[k]], law, measured.shape[0], forms[k], limits[k])
            first = min(first, limits[k, 0])
            last = max(last, limits[k, 1])
        first += (-first) % step
        if k_all == 1:
            covered, outside = overlap_of_one(measured, allowed, forms[0], first, last + 1, step, same, rows)
        else:
            covered, outside = 0.0, 0.0
            for r in range(first, last + 1, step):
                count = spans_in_row(forms, limits, r, measured.shape[1] - 1, spans)
                inside, beyond = row_union(measured[r], allowed[r], spans, count, same)
                covered += inside
                outside += beyond
        out[p, COVERED] = covered * step
        out[p, OUTSIDE] = outside * step


@njit(cache=True, nogil=True)
def overlap_of_one(
    measured: F64, allowed: F64, form: F64, first: int, end: int, step: int, same: bool, rows: F64
) -> tuple[float, float]:
    """What one ellipse covers of the measured cells, and of those that are not allowed, in every step-th row."""
    x, y, lean, wide, thin = form
    edge = np.float64(measured.shape[1]) - 1.5
    n = np.uintp(max(0, (end - first + step - 1) // step))
    lows, highs = rows[0], rows[1]
    for i in range(n):
        dy = np.float64(np.int64(i) * step + first) - y
        half = np.sqrt(max(0.0, wide - thin * dy * dy))
        middle = x + lean * dy
        lows[i] = max(middle - half, -0.5)
        highs[i] = min(middle + half, edge)
    covered = 0.0
    outside = 0.0
    for i in range(n):
        lo, hi = lows[i], highs[i]
        if hi > lo:
            r = np.uintp(np.int64(i) * step + first)
            part = between(measured[r], lo, hi)
            covered += part
            outside += hi - lo - (part if same else between(allowed[r], lo, hi))
    return covered, outside


@njit(cache=True, nogil=True, inline="always")
def shape_of(state, law, n_rows, form, limit):  # type: ignore[no-untyped-def]
    """The ellipse of an object in a particle.

    form: x, y, lean, wide, thin; in the row dy below y it covers x + lean dy +- sqrt(wide - thin dy^2).
    limit: its first and last row in the grid.
    """
    y = state[Y]
    base = half_length(law, y)
    a = base * math.exp(state[LN_A])
    b = base * law.aspect * math.exp(state[LN_B])
    qxx, qxy, _ = conic(a, b, state[ANGLE])
    wide = 1.0 / qxx
    thin = wide * wide / (a * a * b * b)
    form[0] = state[X]
    form[1] = y
    form[2] = -qxy * wide
    form[3] = wide
    form[4] = thin
    reach = math.sqrt(wide / thin)
    limit[0] = max(0, math.ceil(y - reach))
    limit[1] = min(n_rows - 1, math.floor(y + reach))


@njit(cache=True, nogil=True, inline="always")
def spans_in_row(forms, limits, r, n_cols, spans):  # type: ignore[no-untyped-def]
    """Columns between which each ellipse covers row r in the grid, sorted by their lower end; returns how many."""
    count = 0
    for k in range(forms.shape[0]):
        if r < limits[k, 0] or r > limits[k, 1]:
            continue
        dy = r - forms[k, 1]
        half = math.sqrt(max(0.0, forms[k, 3] - forms[k, 4] * dy * dy))
        middle = forms[k, 0] + forms[k, 2] * dy
        lo = max(middle - half, -0.5)
        hi = min(middle + half, n_cols - 0.5)
        if hi <= lo:
            continue
        i = count
        while i > 0 and spans[i - 1, 0] > lo:
            spans[i, 0], spans[i, 1] = spans[i - 1, 0], spans[i - 1, 1]
            i -= 1
        spans[i, 0], spans[i, 1] = lo, hi
        count += 1
    return count


@njit(cache=True, nogil=True, inline="always")
def row_union(measured, allowed, spans, count, same):  # type: ignore[no-untyped-def]
    """Of the union of sorted spans in a row: the measured part, and what lies outside the allowed cells."""
    inside = 0.0
    beyond = 0.0
    i = 0
    while i < count:
        lo = spans[i, 0]
        hi = spans[i, 1]
        i += 1
        while i < count and spans[i, 0] <= hi:
            hi = max(hi, spans[i, 1])
            i += 1
        part = between(measured, lo, hi)
        inside += part
        beyond += hi - lo - (part if same else between(allowed, lo, hi))
    return inside, beyond


@njit(cache=True, nogil=True)
def propagate(particles: F64, noise: F32, transition: Transition, surprise: F64) -> None:
    """Constant velocity with Gaussian noise for all particles, in place (equation 6).

    particles: (P, N, 7); noise: (P, N, 7) standard normal;
    surprise: (P, N) receives half the squared noise, minus the logarithm of the transition density.
    """
    dt, pull, push, keep, fresh = transition
    for p in range(particles.shape[0]):
        for n in range(particles.shape[1]):
            state = particles[p, n]
            draw = noise[p, n]
            state[X] += state[VX] * dt + pull[n] * draw[X]
            state[Y] += state[VY] * dt + pull[n] * draw[Y]
            state[VX] += push[n] * draw[VX]
            state[VY] += push[n] * draw[VY]
            total = 0.0
            for i in range(LN_A):
                total += draw[i] * draw[i]
            for i in range(LN_A, ANGLE + 1):
                state[i] = keep * state[i] + fresh[i - LN_A] * draw[i]
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
            for i in range(ANGLE + 1):
                particles[p, n, i] = states[index[p], k, i]


@njit(cache=True, nogil=True)
def draw_systematically(weights: F64, shift: float, index: I64) -> None:
    """Index (P,) of the particles that systematic resampling draws by (P,) weights; shift of its comb, 0 to 1."""
    n = len(weights)
    j, total = 0, weights[0]
    for i in range(n):
        while j < n - 1 and total < (i + shift) / n:
            j += 1
            total += weights[j]
        index[i] = j


@njit(cache=True, nogil=True, error_model="numpy")
def mean_near(particles: F64, members: I64, best: int, weights: F64, radius: F64, states: F64) -> None:
    """Mean state of each member, over particles weighted by a Gaussian of their distance from particle ``best`` too.

    weights: (P,). radius: (K,) deviations of the Gaussians [cells]. states: (K, 7) is filled.
    """
    for k in range(members.shape[0]):
        n = members[k]
        x, y = particles[best, n, X], particles[best, n, Y]
        total = 0.0
        states[k] = 0.0
        for p in range(particles.shape[0]):
            dx, dy = (particles[p, n, X] - x) / radius[k], (particles[p, n, Y] - y) / radius[k]
            near = weights[p] * math.exp(-0.5 * (dx * dx + dy * dy))
            total += near
            for i in range(ANGLE + 1):
                states[k, i] += near * particles[p, n, i]
        states[k] /= total
