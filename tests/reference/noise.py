"""Plain numpy twin of planview/synthetic/texture.py: defines the texture noise."""

import numpy as np


def lattice(x, y, z, seed):
    """Random numbers in -1..1 at integer points, by hashing (uint32 arithmetic)."""
    with np.errstate(over="ignore"):
        x, y, z = (np.asarray(v, np.int64).astype(np.uint32) for v in (x, y, z))
        h = x * np.uint32(374761393)
        h = h + y * np.uint32(668265263)
        h = h + z * np.uint32(2147483647)
        h = h + np.uint32(seed) * np.uint32(3266489917)
        h = (h ^ (h >> np.uint32(13))) * np.uint32(1274126177)
        h = (h ^ (h >> np.uint32(16))) * np.uint32(2246822519)
        h = h ^ (h >> np.uint32(15))
    return h.astype(np.float64) / 2147483648.0 - 1.0


def value_noise(p, seed):
    """Smoothly interpolated lattice numbers at points (N, 3)."""
    cell = np.floor(p).astype(np.int64)
    f = p - cell
    s = f * f * (3 - 2 * f)
    total = np.zeros(len(p))
    for dz in (0, 1):
        for dy in (0, 1):
            for dx in (0, 1):
                w = np.prod([s[:, k] if d else 1 - s[:, k] for k, d in enumerate((dx, dy, dz))], axis=0)
                total += w * lattice(cell[:, 0] + dx, cell[:, 1] + dy, cell[:, 2] + dz, seed)
    return total


def fractal_noise(points, footprint, wavelength, octaves, seed):
    """Octaves of halved wavelength and 0.6 of the weight, faded out before they are finer than two pixels."""
    out = np.zeros(len(points))
    length, weight = wavelength.astype(np.float64), 0.6
    for octave in range(octaves):
        fade = np.clip(length / (2 * footprint.astype(np.float64) + 1e-9) - 0.5, 0, 1)
        shift = np.array([17.3, -9.1, 3.7]) * octave
        out += weight * fade * value_noise(points.astype(np.float64) / length[:, None] + shift, seed + octave)
        length, weight = length * 0.5, weight * 0.6
    return out.astype(np.float32)
