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
    h = np.uint32(h ^ (h >> np.uint32(13)))
    h = np.uint32(h * np.uint32(1274126177))
    h = np.uint32(h ^ (h >> np.uint32(16)))
    h = np.uint32(h * np.uint32(2246822519))
    h = np.uint32(h ^ (h >> np.uint32(15)))
    return np.float64(h) / 2147483648.0 - 1.0


@kernel
def _value_noise(x: float, y: float, z: float, seed: int) -> float:
    xi = int(np.floor(x))
    yi = int(np.floor(y))
    zi = int(np.floor(z))
    fx = x - xi
    fy = y - yi
    fz = z - zi
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
            x = points[i, 0] / length + 17.3 * octave
            y = points[i, 1] / length - 9.1 * octave
            z = points[i, 2] / length + 3.7 * octave
            noise = _value_noise(x, y, z, seed + octave)
            total += weight * fade * noise
            length *= 0.5
            weight *= 0.6
        out[i] = total
    return out


def linear_colour(colour: str) -> F32:
    """(3,) float32 linear BGR of an sRGB "#rrggbb"."""
    rgb = np.array(list(bytes.fromhex(colour[1:]))) / 255.0
    bright = ((rgb + 0.055) / 1.055) ** 2.4
    linear = np.where(rgb <= 0.04045, rgb / 12.92, bright)
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
        second = first * np.float32(0.45)
        if surface.colour2:
            second = linear_colour(surface.colour2)
        index = len(self.materials)
        self.materials.append(Material(surface, first, second, emission, seed=index * 7919))
        return index

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


def _evaluate(material: Material, points: F32, footprint: F32) -> F32:
    surface = material.surface
    if surface.texture == "poster":
        return _poster(material, points, footprint)
    mix, shade = _pattern(material, points, footprint)
    grain = _noise(points, footprint, surface.scale_m, 4, material.seed)
    albedo = material.first + mix[:, None] * (material.second - material.first)
    brightness = shade * (1.0 + 1.6 * surface.contrast * grain)
    shaded = albedo * brightness[:, None]
    return np.asarray(np.clip(shaded, 0.004, 0.95), np.float32)


def _poster(material: Material, points: F32, footprint: F32) -> F32:
    """Blotches in a few colours with lines like writing below."""
    scale_m = material.surface.scale_m
    coarse = _noise(points, footprint, scale_m * 2, 3, material.seed)
    fine = _noise(points, footprint, scale_m, 3, material.seed + 50)
    blotches = np.clip(0.5 + 2.5 * coarse, 0, 1)[:, None]
    lines = np.clip(0.5 + 3.0 * fine, 0, 1)[:, None]
    paper = material.first * (1 - blotches) + material.second * blotches
    ink = material.first[::-1] * 0.7
    colour = paper * (1 - 0.5 * lines) + 0.5 * lines * ink
    return np.asarray(np.clip(colour, 0.01, 0.9), np.float32)


def _pattern(m: Material, p: F32, footprint: F32) -> tuple[F32, F32]:
    """Share of the second colour and a brightness factor, (N,) each."""
    s = m.surface
    scale_m = s.scale_m
    one = np.ones(len(p), np.float32)
    none = np.zeros(len(p), np.float32)
    x, y, z = np.asarray(p, np.float32).T
    match s.texture:
        case "tiles":
            along = _line(x, scale_m, 0.006, footprint)
            across = _line(y, scale_m, 0.006, footprint)
            tone = _tone(m, np.floor(x / scale_m), np.floor(y / scale_m), 0.10)
            return np.maximum(along, across), tone
        case "wood":
            plank = np.floor(y / scale_m)
            board = np.floor(x / (8 * scale_m) + 0.37 * plank)
            along = _line(y, scale_m, 0.003, footprint)
            across = _line(x + 0.37 * plank * 8 * scale_m, 8 * scale_m, 0.003, footprint)
            stretched = p * np.array([0.12, 1.5, 1.5], np.float32)
            grain = _noise(stretched, footprint, 0.08, 4, m.seed + 5)
            tone = _tone(m, board, plank, 0.16) * (1.0 + 0.25 * grain)
            return np.maximum(along, across), tone
        case "carpet":
            pile = _noise(p, footprint, 0.03, 2, m.seed + 9)
            return none, 1.0 + 0.5 * s.contrast * pile
        case "concrete":
            stains = _noise(p, footprint, 4 * scale_m, 2, m.seed + 3)
            return none, 1.0 + 0.6 * s.contrast * stains
        case "stripes":
            return _wave(z, scale_m, footprint), one
        case "checks":
            upright = _wave(z, scale_m, footprint)
            level = _wave(x + y, scale_m, footprint)
            return np.asarray((upright + level) / 2, np.float32), one
        case "print":
            blotches = _noise(p, footprint, 2 * scale_m, 3, m.seed + 21)
            return np.clip(0.5 + 3.0 * blotches, 0, 1).astype(np.float32), one
        case "books":
            along = _line(x, scale_m, 0.004, footprint)
            across = _line(y, 0.33, 0.03, footprint)
            tone = _tone(m, np.floor(x / scale_m), np.floor(y / 0.33), 0.6)
            second = np.maximum(along, across) + (tone - 0.7) * 0.7
            return np.clip(second, 0, 1).astype(np.float32), tone
        case _:
            return none, one


def _noise(p: F32, footprint: F32, scale_m: float, octaves: int, seed: int) -> F32:
    wavelength = np.full(len(p), scale_m, np.float32)
    points = np.ascontiguousarray(p, np.float32)
    pixel = np.ascontiguousarray(footprint, np.float32)
    return np.asarray(fractal_noise(points, pixel, wavelength, octaves, seed), np.float32)


def _tone(m: Material, i: AnyArray, j: AnyArray, amount: float) -> F32:
    """A random brightness per cell of a pattern."""
    cells = np.column_stack([i, j, np.full(len(i), 0.5)])
    a_point = np.zeros(len(i), np.float32)
    noise = _noise(cells, a_point, 1.0, 1, m.seed + 77)
    return np.asarray(1.0 + amount * noise / 0.6, np.float32)


def _line(v: F32, period: float, width: float, footprint: F32) -> F32:
    """Coverage of thin lines at multiples of the period, averaged over a pixel."""
    distance = np.abs(v - period * np.round(v / period))
    half_pixel = 0.5 * footprint + 1e-6
    begin = np.maximum(distance - half_pixel, -width / 2)
    end = np.minimum(distance + half_pixel, width / 2)
    coverage = (end - begin) / (2 * half_pixel)
    return np.asarray(np.clip(coverage, 0, 1), np.float32)


def _wave(v: F32, period: float, footprint: F32) -> F32:
    """Alternating bands 0 and 1, blurred by the pixel; their mean where they are finer than two pixels."""
    triangle = np.abs((v / period) % 1.0 - 0.5) * 2 - 0.5
    sharp = np.clip(0.5 + triangle * period / (footprint + 1e-6), 0, 1)
    fade = np.clip(period / (2 * footprint + 1e-9) - 0.5, 0, 1)
    return np.asarray(0.5 + fade * (sharp - 0.5), np.float32)
