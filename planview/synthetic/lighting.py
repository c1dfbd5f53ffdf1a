"""Light on surfaces: ambient, lamps and sun, with cast shadows."""

from __future__ import annotations

import numpy as np

from calib.types import F32, F64
from planview.synthetic.room import wall_frame
from planview.synthetic.scene import Light
from planview.synthetic.setting import Keyframes, Room
from planview.synthetic.texture import linear_colour
from planview.synthetic.tracing import EPSILON_M, Tracer

SUN_M = 60.0
"""Length of shadow rays towards the sun."""

NEAR_M = 1.0
"""Lamps are no brighter nearer than this: they are panels, not points, and shine downwards."""


def level_at(frames: Keyframes, t: float) -> float:
    """Keyframed value at a time."""
    return float(np.interp(t, [k[0] for k in frames], [k[1] for k in frames]))


def ambient(normals: F32) -> F32:
    """(N,) hemisphere light: the ceiling is brighter than the floor."""
    return np.asarray(0.75 + 0.25 * normals[:, 2], np.float32)


def light_vectors(light: Light, points: F32, offset: F64) -> F32:
    """(N, 3) vectors from points to a sample of the light; offset (3,) in its unit ball."""
    if light.kind == "sun":
        towards = np.asarray(light.towards, np.float64)
        direction = -towards / np.linalg.norm(towards) + np.tan(np.deg2rad(light.softness_deg)) * offset
        return np.broadcast_to((direction * SUN_M).astype(np.float32), points.shape)
    centre = np.asarray(light.at_m, np.float64) + light.radius_m * offset
    return np.asarray(centre.astype(np.float32) - points, np.float32)


def irradiance(light: Light, room: Room, points: F32, normals: F32) -> F32:
    """(N,) light on surfaces without shadows, before dimming; grey."""
    to = light_vectors(light, points, np.zeros(3))
    distance = np.linalg.norm(to, axis=1)
    cosine = np.clip(np.einsum("ij,ij->i", to, normals) / np.maximum(distance, 1e-6), 0, 1)
    if light.kind == "point":
        return np.asarray(light.level * cosine * (2.0 / np.maximum(distance, NEAR_M)) ** 2, np.float32)
    result = light.level * cosine
    if light.window is not None:
        result = result * _through_window(light, room, points, to)
    return np.asarray(result, np.float32)


def _through_window(light: Light, room: Room, points: F32, to: F32) -> F32:
    """1 where the ray to the sun leaves through the window, with soft edges."""
    panel = room.panels[light.window or 0]
    corner, along, inward, _ = wall_frame(room, panel.wall)
    approach = to @ -inward
    distance = (points - corner) @ inward
    t = np.where(approach > 1e-6, distance / np.maximum(approach, 1e-6), np.nan)
    at = points + to * t[:, None] - corner
    a, z = at @ along - panel.from_m, at[:, 2] - panel.bottom_m
    edge = np.minimum(np.minimum(a, panel.width_m - a), np.minimum(z, panel.height_m - z))
    return np.asarray(np.clip(np.nan_to_num(edge, nan=-1.0) / 0.03 + 0.5, 0, 1), np.float32)


def visibility(light: Light, tracers: list[Tracer], points: F32, normals: F32, samples: F64) -> F32:
    """(N,) share of the light's samples (S, 3) that nothing hides."""
    origins = points + EPSILON_M * normals
    seen = np.zeros(len(points), np.float32)
    for offset in samples:
        to = light_vectors(light, origins, offset)
        blocked = np.zeros(len(points), np.bool_)
        for tracer in tracers:
            blocked |= tracer.blocked(origins, to)
        seen += ~blocked
    return np.asarray(seen / len(samples), np.float32)


def ball_samples(n: int) -> F64:
    """(n, 3) fixed, evenly spread points of the unit ball's shell; one sample is its centre."""
    if n == 1:
        return np.zeros((1, 3))
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    angle = np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return 0.8 * np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


def colour_of(light: Light) -> F32:
    """(3,) linear BGR."""
    return linear_colour(light.colour)


def hemisphere(n: int, turn: int) -> F32:
    """(n, 3) cosine-weighted directions about z, turned so that several sets fill the gaps."""
    k = np.arange(n) + 0.5
    r = np.sqrt(k / n)
    angle = np.pi * (3 - 5**0.5) * (k * (turn + 1)) + 2.4 * turn
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), np.sqrt(1 - r * r)]).astype(np.float32)


def openness(tracer: Tracer, points: F32, normals: F32, directions: F32, reach_m: float = 0.8) -> F32:
    """(N,) share of directions about the normals in which nothing is within reach: soft contact shadows."""
    seen = np.zeros(len(points), np.float32)
    origins = points + EPSILON_M * normals
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, np.array([0, 0, 1], np.float32), np.array([1, 0, 0], np.float32))
    side = np.cross(helper, normals)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    other = np.cross(normals, side)
    for d in directions:
        to = (reach_m * (d[0] * side + d[1] * other + d[2] * normals)).astype(np.float32)
        seen += ~tracer.blocked(origins, to)
    return np.asarray(seen / len(directions), np.float32)
