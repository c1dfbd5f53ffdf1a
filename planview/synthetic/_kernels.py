"""Compiled noise; the numpy twin in tests/reference defines it."""

import numpy as np
from numba import njit

from calib.types import F32


@njit(cache=True, nogil=True, error_model="numpy")
def _lattice(x: int, y: int, z: int, seed: int) -> float:
    h = np.uint32(x) * np.uint32(374761393)
    h = np.uint32(h + np.uint32(y) * np.uint32(668265263))
    h = np.uint32(h + np.uint32(z) * np.uint32(2147483647))
    h = np.uint32(h + np.uint32(seed) * np.uint32(3266489917))
    h = np.uint32((h ^ (h >> np.uint32(13))) * np.uint32(1274126177))
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(2246822519))
    h = np.uint32(h ^ (h >> np.uint32(15)))
    return np.float64(h) / 2147483648.0 - 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _value_noise(x: float, y: float, z: float, seed: int) -> float:
    xi, yi, zi = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    fx, fy, fz = x - xi, y - yi, z - zi
    sx = fx * fx * (3.0 - 2.0 * fx)
    sy = fy * fy * (3.0 - 2.0 * fy)
    sz = fz * fz * (3.0 - 2.0 * fz)
    total = 0.0
    for dz in range(2):
        wz = sz if dz else 1.0 - sz
        for dy in range(2):
            wy = sy if dy else 1.0 - sy
            low = _lattice(xi, yi + dy, zi + dz, seed)
            high = _lattice(xi + 1, yi + dy, zi + dz, seed)
            total += wz * wy * (low + sx * (high - low))
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def fractal_noise(points: F32, footprint: F32, wavelength: F32, octaves: int, seed: int) -> F32:
    """Sum of octaves of value noise, each faded out before it is finer than two pixels.

    points (N, 3) [m], footprint (N,) size of a pixel on the surface [m], wavelength (N,) of the first octave [m].
    """
    n = points.shape[0]
    out = np.zeros(n, np.float32)
    for i in range(n):
        length = wavelength[i]
        weight = 0.6
        total = 0.0
        for octave in range(octaves):
            fade = min(max(length / (2.0 * footprint[i] + 1e-9) - 0.5, 0.0), 1.0)
            if fade <= 0.0:
                break
            total += (
                weight
                * fade
                * _value_noise(
                    points[i, 0] / length + 17.3 * octave,
                    points[i, 1] / length - 9.1 * octave,
                    points[i, 2] / length + 3.7 * octave,
                    seed + octave,
                )
            )
            length *= 0.5
            weight *= 0.6
        out[i] = total
    return out
