"""Surface patterns: functions of coordinates fixed to the surface, so both cameras see the same. The numpy twin in
tests/reference defines the compiled noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.kernels import kernel
from calib.types import F32, I32, AnyArray
from planview.synthetic.scene import Surface


@kernel
def _lattice(x: int, y: int, z: int, seed: int) -> float:
    h = np.uint32(x) * np.uint32(374761393)
    h = np.uint32(h + np.uint32(y) * np.uint32(668265263))
    h = np.uint32(h + np.uint32(z) * np.uint32(2147483647))
    h = np.uint32(h + np.uint32(seed) * np.uint32(3266489917))
    h = np.uint32((h ^ (h >> np.uint32(13))) * np.uint32(1274126177))
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(2246822519))
    h = np.uint32(h ^ (h >> np.uint32(15)))
    return np.float64(h) / 2147483648.0 - 1.0


@kernel
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


@kernel
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
            x, y, z = points[i, 0] / length, points[i, 1] / length, points[i, 2] / length
            noise = _value_noise(x + 17.3 * octave, y - 9.1 * octave, z + 3.7 * octave, seed + octave)
            total += weight * fade * noise
            length *= 0.5
            weight *= 0.6
        out[i] = total
    return out


def linear_colour(colour: str) -> F32:
    """(3,) float32 linear BGR of an sRGB "#rrggbb"."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return linear[::-1].astype(np.float32)


@dataclass(frozen=True, eq=False)
class Material:
    """A surface ready to be evaluated: its colours, (3,) float32 linear BGR, light of its own added after shading
    (windows), and a seed that decorrelates equal surfaces."""

    surface: Surface
    first: F32
    second: F32
    emission: float = 0.0
    seed: int = 0


class Palette:
    """Materials of a scene by index."""

    def __init__(self) -> None:
        self.materials: list[Material] = []

    def add(self, surface: Surface, emission: float = 0.0) -> int:
        """Index of a new material."""
        first = linear_colour(surface.colour)
        second = linear_colour(surface.colour2) if surface.colour2 else first * np.float32(0.45)
        self.materials.append(Material(surface, first, second, emission, len(self.materials) * 7919))
        return len(self.materials) - 1

    @property
    def emission(self) -> F32:
        """(M,) of all materials."""
        return np.array([m.emission for m in self.materials], np.float32)

    @property
    def gloss(self) -> F32:
        """(M,) of all materials."""
        return np.array([m.surface.gloss for m in self.materials], np.float32)

    def albedo(self, material: I32, local: F32, footprint: F32) -> F32:
        """(N, 3) float32 linear BGR reflectance of surface points (N, 3) [m], by the index of their material (N,) int32
        and the size of a pixel on the surface (N,) [m]."""
        out = np.zeros((len(material), 3), np.float32)
        for index in np.unique(material):
            chosen = np.flatnonzero(material == index)
            out[chosen] = _evaluate(self.materials[index], local[chosen], footprint[chosen])
        return out


def _evaluate(m: Material, p: F32, footprint: F32) -> F32:
    s = m.surface
    if s.texture == "poster":
        # Blotches in a few colours with lines like writing below.
        a = np.clip(0.5 + 2.5 * _noise(p, footprint, s.scale_m * 2, 3, m.seed), 0, 1)[:, None]
        b = np.clip(0.5 + 3.0 * _noise(p, footprint, s.scale_m, 3, m.seed + 50), 0, 1)[:, None]
        out, third = m.first * (1 - a) + m.second * a, m.first[::-1] * 0.7
        return np.asarray(np.clip(out * (1 - 0.5 * b) + 0.5 * b * third, 0.01, 0.9), np.float32)
    mix, shade = _pattern(m, p, footprint)
    grain = _noise(p, footprint, s.scale_m, 4, m.seed)
    albedo = m.first + mix[:, None] * (m.second - m.first)
    shaded = albedo * (shade * (1.0 + 1.6 * s.contrast * grain))[:, None]
    return np.asarray(np.clip(shaded, 0.004, 0.95), np.float32)


def _pattern(m: Material, p: F32, footprint: F32) -> tuple[F32, F32]:
    """Share of the second colour and a brightness factor, (N,) each."""
    s, one, none = m.surface, np.ones(len(p), np.float32), np.zeros(len(p), np.float32)
    x, y, z = (np.asarray(p[:, c], np.float32) for c in range(3))
    if s.texture == "tiles":
        grout = np.maximum(_line(x, s.scale_m, 0.006, footprint), _line(y, s.scale_m, 0.006, footprint))
        return grout, _tone(m, np.floor(x / s.scale_m), np.floor(y / s.scale_m), 0.10)
    if s.texture == "wood":
        plank = np.floor(y / s.scale_m)
        board = np.floor(x / (8 * s.scale_m) + 0.37 * plank)
        gap = np.maximum(
            _line(y, s.scale_m, 0.003, footprint),
            _line(x + 0.37 * plank * 8 * s.scale_m, 8 * s.scale_m, 0.003, footprint),
        )
        grain = _noise(p * np.array([0.12, 1.5, 1.5], np.float32), footprint, 0.08, 4, m.seed + 5)
        return gap, _tone(m, board, plank, 0.16) * (1.0 + 0.25 * grain)
    if s.texture == "carpet":
        return none, (1.0 + 0.5 * s.contrast * _noise(p, footprint, 0.03, 2, m.seed + 9))
    if s.texture == "concrete":
        return none, (1.0 + 0.6 * s.contrast * _noise(p, footprint, 4 * s.scale_m, 2, m.seed + 3))
    if s.texture == "stripes":
        return _wave(z, s.scale_m, footprint), one
    if s.texture == "checks":
        a, b = _wave(z, s.scale_m, footprint), _wave(x + y, s.scale_m, footprint)
        return np.asarray((a + b) / 2, np.float32), one
    if s.texture == "print":
        n = _noise(p, footprint, 2 * s.scale_m, 3, m.seed + 21)
        return np.clip(0.5 + 3.0 * n, 0, 1).astype(np.float32), one
    if s.texture == "books":
        row, col = np.floor(y / 0.33), np.floor(x / s.scale_m)
        gap = np.maximum(_line(x, s.scale_m, 0.004, footprint), _line(y, 0.33, 0.03, footprint))
        tone = _tone(m, col, row, 0.6)
        return np.clip(gap + (tone - 0.7) * 0.7, 0, 1).astype(np.float32), tone
    return none, one


def _noise(p: F32, footprint: F32, scale_m: float, octaves: int, seed: int) -> F32:
    wavelength = np.full(len(p), scale_m, np.float32)
    points, pixel = np.ascontiguousarray(p, np.float32), np.ascontiguousarray(footprint, np.float32)
    return np.asarray(fractal_noise(points, pixel, wavelength, octaves, seed), np.float32)


def _tone(m: Material, i: AnyArray, j: AnyArray, amount: float) -> F32:
    """A random brightness per cell of a pattern."""
    cells = np.column_stack([i, j, np.full(len(i), 0.5)]).astype(np.float32)
    tiny = np.zeros(len(i), np.float32)
    n = fractal_noise(cells, tiny, np.ones(len(i), np.float32), 1, m.seed + 77)
    return np.asarray(1.0 + amount * n / 0.6, np.float32)


def _line(v: F32, period: float, width: float, footprint: F32) -> F32:
    """Coverage of thin lines at multiples of the period, averaged over a pixel."""
    distance = np.abs(v - period * np.round(v / period))
    half_pixel = 0.5 * footprint + 1e-6
    inside = np.minimum(distance + half_pixel, width / 2) - np.maximum(distance - half_pixel, -width / 2)
    return np.asarray(np.clip(inside / (2 * half_pixel), 0, 1), np.float32)


def _wave(v: F32, period: float, footprint: F32) -> F32:
    """Alternating bands 0 and 1, blurred by the pixel; their mean where they are finer than two pixels."""
    triangle = np.abs((v / period) % 1.0 - 0.5) * 2 - 0.5
    sharp = np.clip(0.5 + triangle * period / (footprint + 1e-6), 0, 1)
    fade = np.clip(period / (2 * footprint + 1e-9) - 0.5, 0, 1)
    return np.asarray(0.5 + fade * (sharp - 0.5), np.float32)
