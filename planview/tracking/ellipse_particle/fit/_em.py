"""Compiled step of expectation-maximisation; ``tests/reference/ellipses.py`` defines it in plain numpy."""

import math

import numpy as np
from numba import njit

from calib.types import F64
from planview.tracking.ellipse_particle.fit._area import conic, half_length
from planview.tracking.ellipse_particle.fit.prior import SizeLaw


@njit(cache=True, nogil=True)
def em_step(points: F64, ellipses: F64, law: SizeLaw, strength: float, outlier: float, upright: bool) -> None:
    """One step of expectation-maximisation of a mixture of ellipses, updated in place.

    points: (P, 3) x, y, weight of the foreground cells. Each ellipse is the two-sigma contour of a Gaussian
    (the Gaussian with the second moments of a uniform ellipse), next to a uniform density of outliers.
    strength: mass of the prior in units of the ellipse's area (the inverse-Wishart prior of a covariance, so the
    step maximises the posterior);
    upright: the length axis stays nearer the rows' direction than the columns'.
    """
    sums = moments(points, ellipses, outlier)
    for k in range(ellipses.shape[0]):
        mass, sx, sy, sxx, sxy, syy = sums[k]
        if mass <= 1e-9:
            continue
        mx = sx / mass
        my = sy / mass
        ellipses[k, 0] += mx
        ellipses[k, 1] += my
        a0 = half_length(law, ellipses[k, 1])
        b0 = a0 * law.aspect
        weight = strength * math.pi * a0 * b0
        vxx = (4.0 * (sxx - mass * mx * mx) + weight * b0 * b0) / (mass + weight)
        vyy = (4.0 * (syy - mass * my * my) + weight * a0 * a0) / (mass + weight)
        vxy = 4.0 * (sxy - mass * mx * my) / (mass + weight)
        set_axes(ellipses, k, vxx, vxy, vyy, upright)


@njit(cache=True, nogil=True)
def moments(points: F64, ellipses: F64, outlier: float) -> F64:
    """(N, 6) mass, and first and second moments dx, dy, dx^2, dx dy, dy^2 about its centre, of each ellipse's share."""
    n = ellipses.shape[0]
    sums = np.zeros((n, 6))
    density = np.empty(n)
    forms = np.empty((n, 4))
    for k in range(n):
        forms[k, 0], forms[k, 1], forms[k, 2] = conic(ellipses[k, 2], ellipses[k, 3], ellipses[k, 4])
        forms[k, 3] = 2.0 / (math.pi * ellipses[k, 2] * ellipses[k, 3])
    for i in range(points.shape[0]):
        total = outlier
        for k in range(n):
            dx = points[i, 0] - ellipses[k, 0]
            dy = points[i, 1] - ellipses[k, 1]
            m = forms[k, 0] * dx * dx + 2.0 * forms[k, 1] * dx * dy + forms[k, 2] * dy * dy
            density[k] = 0.0 if m > 6.0 else forms[k, 3] * math.exp(-2.0 * m)
            total += density[k]
        for k in range(n):
            if density[k] > 0.0:
                w = points[i, 2] * density[k] / total
                dx = points[i, 0] - ellipses[k, 0]
                dy = points[i, 1] - ellipses[k, 1]
                sums[k, 0] += w
                sums[k, 1] += w * dx
                sums[k, 2] += w * dy
                sums[k, 3] += w * dx * dx
                sums[k, 4] += w * dx * dy
                sums[k, 5] += w * dy * dy
    return sums


@njit(cache=True, nogil=True)
def set_axes(ellipses: F64, k: int, vxx: float, vxy: float, vyy: float, upright: bool) -> None:
    """Axes and angle of ellipse k from four times its covariance."""
    mean = 0.5 * (vxx + vyy)
    diff = math.sqrt(0.25 * (vyy - vxx) ** 2 + vxy * vxy)
    if vyy >= vxx or not upright:
        ellipses[k, 2] = math.sqrt(max(mean + diff, 0.25))
        ellipses[k, 3] = math.sqrt(max(mean - diff, 0.25))
        ellipses[k, 4] = 0.5 * math.atan2(2.0 * vxy, vyy - vxx)
    else:
        ellipses[k, 2] = math.sqrt(max(vyy, 0.25))
        ellipses[k, 3] = math.sqrt(max(vxx, 0.25))
        ellipses[k, 4] = 0.0
