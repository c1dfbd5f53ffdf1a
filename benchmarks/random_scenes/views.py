"""Random views of one camera, past which people walk over a line.

How large people are in the image is random, and the camera hung so that they are.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.random_scenes.appearance import clothes, floor_surface, lights_and_sensor, looks
from benchmarks.random_scenes.tables import RandomScene, ViewTable
from planview.synthetic.camera import ground_camera
from planview.synthetic.scene import CameraMount, Scene
from planview.synthetic.steps import Pair

BODY_M, DEPTH_M = 1.7, 0.45
"""A person's height and, from straight above, depth."""
BEYOND_M = 2.2
"""People come to be, and cease, so far beyond the openings: out of view."""
STEEP_DEG = 35.0
"""Cameras steeper than this hang over the middle of the room."""
GREYS = ("#b8b4ac", "#a8a8a4", "#98a0a4", "#c4c0b8")


def view(table: dict[str, Any], rng: np.random.Generator) -> RandomScene:
    """A room around one camera, people who walk through it, and the line to be counted at."""
    values = ViewTable.model_validate(table)
    way = Way(values)
    # Each part has its own numbers: a change of one leaves the others.
    room_rng, light_rng, people_rng = rng.spawn(3)
    grey = str(room_rng.choice(GREYS))
    lights, sensor = lights_and_sensor(values.light, way.size_m, values.duration_s, light_rng)
    people, enter_s = [], values.walks.start_s
    forward, lane, speed = True, 0.0, 1.0
    for i in range(values.walks.people):
        enter_s, forward, lane, speed = _next(values, way, i, (enter_s, forward, lane, speed), people_rng)
        if enter_s + way.length_m / speed > values.duration_s:
            break
        look = looks(people_rng, float(people_rng.uniform(1.55, 1.9))) | clothes(people_rng)
        if people_rng.random() < values.room.grey_clothes:
            look["shirt"] = {"colour": grey, "scale_m": 0.08, "contrast": 0.1}
        stop_s = float(people_rng.uniform(*values.walks.stop_s))
        people.append(look | {"enter_s": enter_s} | way.walk(forward, lane, speed, stop_s))
    scene = Scene.model_validate(
        {
            "description": values.description,
            "seed": int(rng.integers(1 << 31)),
            "fps": values.fps,
            "duration_s": values.duration_s,
            "room": {
                "size_m": way.size_m,
                "floor": floor_surface(room_rng, values.room.gloss),
                "walls": {"colour": grey, "scale_m": 0.8, "contrast": 0.06},
                "openings": way.openings(),
            },
            "camera": way.mount,
            "sensor": sensor,
            "lights": lights,
            "furniture": [_moved(values, way, room_rng)] if values.room.moved else [],
            "people": people,
            "capture": values.capture,
        }
    )
    return RandomScene(scene, wire_px=way.wire())


Pass = tuple[float, bool, float, float]
"""When a person enters [s], whether forward, in which lane [m], and how fast [m/s]."""


def _next(values: ViewTable, way: Way, i: int, before: Pass, rng: np.random.Generator) -> Pass:
    """How the i-th person passes, after the one before."""
    walks, (enter_s, forward, lane, speed) = values.walks, before
    if i and walks.order != "single" and rng.random() < walks.together:
        return enter_s + float(rng.uniform(0.0, 0.3)), forward, lane + (0.65 if lane < 0 else -0.65), speed
    if i and walks.order == "single":
        enter_s += way.length_m / speed + walks.stop_s[1] + float(rng.uniform(0.5, walks.every_s))
    elif i:
        enter_s += float(rng.uniform(0.5, 1.5)) * walks.every_s
    forward = i < walks.people / 2 if walks.order == "waves" else bool(rng.random() < 0.5)
    # On the right of the way, as seen by the one who walks there.
    lane = float(rng.uniform(0.0, 1.0)) * max(0.1, way.reach_m) * (1 if forward else -1)
    return enter_s, forward, lane, float(rng.uniform(*walks.speed_mps))


def _moved(values: ViewTable, way: Way, rng: np.random.Generator) -> dict[str, Any]:
    """A box next to the way that is moved once."""
    x = way.x + float(rng.choice((-1, 1))) * (way.size_m[0] / 2 - 0.35)
    y, t = way.middle_y, float(rng.uniform(0.35, 0.6)) * values.duration_s
    moves = ({"t_s": t, "at_m": (x, y)}, {"t_s": t + 1.5, "at_m": (x, y + 0.4)})
    return {"kind": "box", "at_m": (x, y), "size_m": (0.5, 0.5, 0.6), "moves": moves}


class Way:
    """A camera of a view and the way past it, in the room's frame: y ahead of the camera above (``x``, ``y``).

    Attributes:
        ahead_m: from below the camera to the middle of the view.
        size_m: of the room.
        reach_m: how far lanes are from the middle of the way, at most.
        length_m: of a person's way, from out of view to out of view.
    """

    def __init__(self, values: ViewTable) -> None:
        camera, self._walks = values.camera, values.walks
        tilt, width_m = math.radians(camera.tilt_deg), values.walks.width_m
        focal = camera.height / 2 / math.tan(math.radians(camera.lens_deg) / 2)
        body_m = BODY_M * math.sin(tilt) + DEPTH_M * math.cos(tilt)
        range_m = focal * body_m / (camera.person_share * camera.height)
        height_m = 0.9 + 0.5 * math.cos(tilt) + range_m * math.cos(tilt)
        self.ahead_m = range_m * math.sin(tilt)
        half = 0.5 * camera.width / focal * range_m
        across = values.walks.across
        self.reach_m = min(width_m / 2 - 0.3, 0.2 * range_m if across else 0.75 * half)
        wide = max(width_m, 2 * half if across else 0.0) + 1.0
        self.x, self.y = wide / 2, max(0.3, width_m / 2 + 1.0) if camera.tilt_deg < STEEP_DEG else 0.3
        self.middle_y = self.y + self.ahead_m
        self.size_m = (wide, self.middle_y + values.room.beyond_m, max(2.5, height_m + 0.3))
        self.length_m = self.size_m[0 if across else 1] + 2 * BEYOND_M
        self.mount = CameraMount(
            at_m=(self.x, self.y, height_m), tilt_deg=camera.tilt_deg, width=camera.width, height=camera.height,
            focal_px=focal,
        )  # fmt: skip

    def openings(self) -> list[dict[str, Any]]:
        """Where people come in and go out."""
        width_m, high = self._walks.width_m, min(5.5, self.size_m[2] - 0.2)
        low = max(0.4, self.middle_y - width_m / 2) if self._walks.across else self.x - width_m / 2
        if self._walks.across:
            width_m = min(width_m, self.size_m[1] - low - 0.2)
        walls = ("west", "east") if self._walks.across else ("north", "south")
        return [{"wall": wall, "from_m": low, "width_m": width_m, "height_m": high} for wall in walls]

    def walk(self, forward: bool, lane: float, speed: float, stop_s: float) -> dict[str, Any]:
        """A person's way in a lane, with a stop in the middle or without one."""
        ends = (-BEYOND_M, self.length_m - BEYOND_M)
        along = [*ends[:: 1 if forward else -1]]
        along.insert(1, self.size_m[0] / 2 if self._walks.across else self.middle_y)
        points = [(s, self.middle_y - lane) if self._walks.across else (self.x + lane, s) for s in along]
        if stop_s > 0.3:
            first, second = ({"go": [point], "speed_mps": speed} for point in points[1:])
            return {"start_m": points[0], "steps": [first, {"stand_s": stop_s}, second], "leaves": True}
        area = (0.3, 0.3, self.size_m[0] - 0.3, self.size_m[1] - 0.3)
        way = {"area_m": area, "speed_mps": (speed, speed), "until_s": 0, "exit_m": points[1:]}
        return {"start_m": points[0], "wander": way}

    def wire(self) -> tuple[Pair, Pair]:
        """Across the way through the middle of the view, at the feet of people; 0.7 m off where people stop, so that no
        person hesitates on it."""
        project, width, height = ground_camera(self.mount).project, self.mount.width - 1.0, self.mount.height - 1.0
        aside = 0.7 if self._walks.stop_s[1] > 0 else 0.0
        if self._walks.across:
            middle = float(project(np.array([[aside, self.ahead_m, 0.0]]))[0, 0])
            far = float(project(np.array([[0.0, self.ahead_m + self.reach_m + 1.0, 0.0]]))[0, 1])
            return (middle, max(0.0, far)), (middle, height)
        row = (height + 1) / 2
        if self.mount.tilt_deg >= STEEP_DEG:
            row = min(0.88 * height, float(project(np.array([[0.0, self.ahead_m + aside, 0.0]]))[0, 1]))
        return (0.0, row), (width, row)
