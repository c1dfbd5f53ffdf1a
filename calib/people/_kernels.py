"""Compiled error of many candidate cameras against samples of standing people (no checks, no defaults).

The plain numpy twin is tests/reference/human_error.py.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from calib.types import F64

INFEASIBLE = 1e3
"""Error of a camera that cannot show a person where a sample is."""


@njit(cache=True, nogil=True)
def sample_error(
    focal: float, height: float, tilt: float, k: float, flat: F64, marked: F64, circles: F64, person: float
) -> float:
    """Weighted error of one sample: ``flat`` (4,) head and foot without lens distortion, ``marked`` (8,) its row, both
    from the image centre [px]; ``circles`` (n, 3) points of the model of height ``person`` at the origin [m]."""
    s, c = math.sin(tilt), math.cos(tilt)
    x, y = _stand(focal, height, s, c, flat, person)
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for i in range(circles.shape[0]):
        u, v = _project(focal, height, s, c, k, x + circles[i, 0], y + circles[i, 1], circles[i, 2])
        if math.isnan(u):
            return INFEASIBLE
        left, right = min(left, u), max(right, u)
        top, bottom = min(top, v), max(bottom, v)
    head_u, head_v = _project(focal, height, s, c, k, x, y, person)
    foot_u, foot_v = _project(focal, height, s, c, k, x, y, 0.0)
    m_left, m_top, m_right, m_bottom = marked[0], marked[1], marked[2], marked[3]
    m_head_u, m_head_v, m_foot_u, m_foot_v = marked[4], marked[5], marked[6], marked[7]
    width, tall = m_right - m_left, m_bottom - m_top
    radius = 0.5 * (math.sqrt(width * tall / math.pi) + math.sqrt((right - left) * (bottom - top) / math.pi))
    apart = 0.5 * (math.hypot(head_u - m_head_u, head_v - m_head_v) + math.hypot(foot_u - m_foot_u, foot_v - m_foot_v))
    common = max(0.0, min(right, m_right) - max(left, m_left)) * max(0.0, min(bottom, m_bottom) - max(top, m_top))
    union = width * tall + (right - left) * (bottom - top) - common
    weight = min(1.0, math.hypot(m_head_u - m_foot_u, m_head_v - m_foot_v) / math.hypot(width, tall))
    error: float = weight * apart / radius + (1.0 - weight) * (1.0 - common / union)
    return error


@njit(cache=True, nogil=True)
def candidate_errors(
    cameras: F64, k: float, flat: F64, marked: F64, circles: F64, person: float, limit: float, out: F64
) -> None:
    """Mean error over the samples, written to ``out`` (m,), of (m, 3) cameras: focal [px], height [m], tilt [rad].

    A camera is given up once its mean must exceed ``limit``.
    """
    n = flat.shape[0]
    for j in range(cameras.shape[0]):
        total = 0.0
        for i in range(n):
            total += sample_error(cameras[j, 0], cameras[j, 1], cameras[j, 2], k, flat[i], marked[i], circles, person)
            if total > limit * n:
                break
        out[j] = total / n


@njit(cache=True, nogil=True)
def _stand(focal: float, height: float, s: float, c: float, flat: F64, person: float) -> tuple[float, float]:
    """Floor position whose head and foot are imaged nearest to the sample's.

    Both points give two equations linear in the position, x (Y s + d c) = f X and y (Y s + d c) = f (d s - Y c) with
    d the drop from the camera; divided by their depths they are distances in the image.
    """
    near = s * flat[3] + focal * c
    a11, a12, a22, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0
    y0 = height * (focal * s - c * flat[3]) / near if near > 1e-9 else 0.0
    for j in range(2):
        drop = height - person if j == 0 else height
        depth = max(y0 * s + drop * c, 0.05)
        u, v = flat[2 * j] / depth, flat[2 * j + 1] / depth
        f = focal / depth
        # rows: f X - u s Y = u d c   and   -(f c + v s) Y = v d c - f d s
        q = -(f * c + v * s)
        a11 += f * f
        a12 -= f * u * s
        a22 += u * s * u * s + q * q
        b1 += f * u * drop * c
        b2 += -u * s * u * drop * c + q * (v * drop * c - f * drop * s)
    det = a11 * a22 - a12 * a12
    if det < 1e-12:
        return np.nan, np.nan
    return (a22 * b1 - a12 * b2) / det, (a11 * b2 - a12 * b1) / det


@njit(cache=True, nogil=True)
def _project(
    focal: float, height: float, s: float, c: float, k: float, x: float, y: float, z: float
) -> tuple[float, float]:
    drop = height - z
    depth = y * s + drop * c
    if not depth > 1e-6:
        return np.nan, np.nan
    u = focal * x / depth
    v = focal * (drop * s - y * c) / depth
    if k == 0.0:
        return u, v
    r = math.sqrt(u * u + v * v)
    if 1.0 + 2.0 * k * r <= 0.0:
        return np.nan, np.nan
    return u * (1.0 + k * r), v * (1.0 + k * r)
