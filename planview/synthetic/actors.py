"""Everything that moves: people and the things that roll, turn or are carried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64
from planview.synthetic.body import Body, PosedBody
from planview.synthetic.furniture import furniture_mesh
from planview.synthetic.motion import Handling, scripted_motion
from planview.synthetic.posing import pose_at
from planview.synthetic.scene import Scene
from planview.synthetic.setting import Furniture
from planview.synthetic.shapes import Mesh
from planview.synthetic.texture import Palette
from planview.synthetic.wandering import wander

PUSH_M = 0.72
"""Distance of a pushed thing in front of the person's hips."""


@dataclass(frozen=True, eq=False)
class Actor:
    """A moving surface in one frame; ``person`` is 0 for things, else the id, with its posed body."""

    mesh: Mesh
    person: int = 0
    body: PosedBody | None = None


class Cast:
    """All actors of a scene over time."""

    def __init__(self, scene: Scene, palette: Palette) -> None:
        self._scene = scene
        furniture = {f.name: f for f in scene.furniture if f.name}
        scripted = [scripted_motion(p, furniture, scene.duration_s) for p in scene.people]
        self.motions = wander(scene, scripted)
        self._bodies = [Body(p, palette) for p in scene.people]
        handled = {h.furniture for m in self.motions for h in m.handlings}
        self.is_moving = [bool(f.moves or f.swivel or f.name in handled) for f in scene.furniture]
        self._things = [
            (f, furniture_mesh(f, palette)) for f, moving in zip(scene.furniture, self.is_moving, strict=True) if moving
        ]

    def at(self, t: float) -> list[Actor]:
        """Actors that exist at a time [s], people first."""
        actors, bodies = [], {}
        for i, (motion, body) in enumerate(zip(self.motions, self._bodies, strict=True)):
            if motion.exists(t):
                bodies[i] = body.pose(*pose_at(i, body.height_m, motion, t))
                actors.append(Actor(bodies[i].mesh, i + 1, bodies[i]))
        for item, mesh in self._things:
            place, heading, z = self._place(item, t, bodies)
            actors.append(Actor(place_mesh(mesh, place, heading, z)))
        return actors

    def _place(self, item: Furniture, t: float, bodies: dict[int, PosedBody]) -> tuple[F64, float, float]:
        place, heading, z = furniture_at(item, t)
        past: list[tuple[Handling, int]] = sorted(
            ((h, i) for i, m in enumerate(self.motions) for h in m.handlings if h.furniture == item.name and item.name),
            key=lambda pair: pair[0].from_s,
        )
        for handling, i in past:
            if t < handling.from_s:
                break
            xy, facing, _, _, _ = self.motions[i].at(min(t, handling.until_s))
            if handling.how == "push":
                place, heading = xy + PUSH_M * np.array([np.cos(facing), np.sin(facing)]), facing
            elif t < handling.until_s and i in bodies:
                hands = bodies[i].hands - 0.03 * np.array([np.cos(facing), np.sin(facing), 0.0])
                place, heading, z = hands[:2], facing, float(hands[2]) - 0.12
            else:
                place, heading = xy + 0.5 * np.array([np.cos(facing), np.sin(facing)]), facing
                z = handling.put_z_m
        return place, heading, z


def furniture_at(item: Furniture, t: float) -> tuple[F64, float, float]:
    """Place (2,), heading [rad] and base height of furniture that is not handled."""
    place, heading = np.asarray(item.at_m, np.float64), float(np.deg2rad(item.heading_deg))
    if item.moves:
        times = np.array([m.t_s for m in item.moves])
        xy = np.array([m.at_m for m in item.moves])
        angles = np.deg2rad([item.heading_deg if m.heading_deg is None else m.heading_deg for m in item.moves])
        place = np.array([np.interp(t, times, xy[:, 0]), np.interp(t, times, xy[:, 1])])
        heading = float(np.interp(t, times, angles))
    if item.swivel is not None:
        s = item.swivel
        u = float(np.clip(t, s.from_s, s.until_s)) - s.from_s
        heading += float(np.deg2rad(s.amplitude_deg) * np.sin(2 * np.pi * u / s.period_s))
    return place, heading, item.z_m


def place_mesh(mesh: Mesh, place: F64, heading: float, z: float) -> Mesh:
    """A mesh around its own origin, put into the room."""
    c, s = np.cos(heading), np.sin(heading)
    return mesh.moved(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), (place[0], place[1], z))
