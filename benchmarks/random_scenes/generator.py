"""Random scenes of every kind: a seed decides room, cameras, light, people and ways.

Challenges have a file of their own. Here are the committed conference room and room of two heads, varied, and views
past which people walk over a line: how large people are in the image is random, and the camera hung so that they are.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from pydantic import ValidationError

from benchmarks.random_scenes.challenge import challenge, refuse_too_near
from benchmarks.random_scenes.stage import clothes, floor_surface, lights_and_sensor, looks
from benchmarks.random_scenes.tables import NoPlaceError, RandomScene, ViewTable, resolved
from calib.errors import InputError, WorkError
from calib.io import load_toml
from calib.params import first_problem
from calib.types import F64
from planview.synthetic.assets import SCENES
from planview.synthetic.camera import ground_camera
from planview.synthetic.motion import scripted_motion
from planview.synthetic.scene import CameraMount, Pair, Scene
from planview.synthetic.write import rigs_of

CONFERENCE_CAMERA = {
    "at_m": [{"min": 2.4, "max": 5.6}, {"min": 0.15, "max": 0.3}, {"min": 2.7, "max": 3.3}],
    "tilt_deg": {"min": 46.0, "max": 60.0},
    "focal_px": {"min": 125.0, "max": 165.0},
    "width": 320,
    "height": 240,
}
SEAT_INSIDE_M = 0.25
"""Seats are at least so far inside the zone: a person who sits on its outline is in and out by centimetres."""
MARGIN_M = 0.7
"""People walk this far from walls; from those with a rig on them 1.4 m."""
LAYOUTS = {
    "opposite": ((0.36, 0.04, 84.0), (0.64, 0.96, 264.0)),
    "side by side": ((0.27, 0.04, 80.0), (0.73, 0.04, 100.0)),
    "corner": ((0.40, 0.04, 88.0), (0.97, 0.18, 150.0)),
}
"""Where two rigs hang, as shares of width and depth, and their heading [deg]: they look across each other."""
RIG = {
    "height_m": {"min": 2.25, "max": 2.55},
    "tilt_deg": {"min": 61.0, "max": 66.0},
    "roll_deg": {"min": -1.5, "max": 1.5},
    "focal_px": {"min": 106.0, "max": 123.0},
    "baseline_m": {"min": 0.14, "max": 0.18},
    "width": 320,
    "height": 240,
    "distortion": (-0.08, 0.02, 0.0003, -0.0002, 0.0),
}


def conference(table: dict[str, Any], rng: np.random.Generator) -> RandomScene:
    """The committed conference room with another camera, other seats, times and clothes, and the zone that it sees.
    Raises NoPlaceError: the camera does not see all seats, or people walk through each other."""
    seats = [item for item in table["furniture"] if item.get("name", "").startswith("c")]
    kind = str(rng.choice(("office_chair", "chair")))
    for seat in seats:
        seat["kind"] = kind
    mount = _conference_camera(rng, np.array([seat["at_m"] for seat in seats]))
    outline = _visible_floor(mount, table["room"]["size_m"])
    places = _to_camera(mount, np.array([seat["at_m"] for seat in seats]))
    if len(outline) < 3 or any(cv2.pointPolygonTest(outline, at, True) < SEAT_INSIDE_M for at in places.tolist()):
        raise NoPlaceError("the camera does not see all seats")
    people = _conference_people(table, rng)
    scene = Scene.model_validate(table | {"seed": int(rng.integers(1 << 31)), "camera": mount, "people": people})
    furniture, times = {f.name: f for f in scene.furniture if f.name}, np.arange(0.0, scene.duration_s, 0.2)
    sitting = [p for p in scene.people if not p.wander]  # the others give way
    refuse_too_near([scripted_motion(p, furniture, scene.duration_s).places(times) for p in sitting])
    return RandomScene(scene, zone_m=tuple((float(x), float(y)) for x, y in outline))


def _conference_people(table: dict[str, Any], rng: np.random.Generator) -> list[dict[str, Any]]:
    """The people of the committed scene on each other's seats, at other times and in other clothes."""
    ways = [person["steps"] for person in table["people"] if len(person["steps"]) == 3]
    rng.shuffle(ways)
    people: list[dict[str, Any]] = []
    for person in table["people"]:
        steps = person["steps"]
        if len(steps) == 3:  # to a seat and back, with the stay of the person who has the seat in the committed scene
            there, sit, back = ways.pop()
            steps = [there, {**sit, "sit_s": max(5.0, steps[1]["sit_s"] + float(rng.uniform(-8, 8)))}, back]
        worn = clothes(rng)
        if people and rng.random() < 0.25:  # in the clothes of another
            worn = {name: people[int(rng.integers(len(people)))][name] for name in worn}
        if rng.random() < 0.1:  # in a shirt of the wall's colour
            worn["shirt"] = table["room"]["walls"]
        people.append(person | looks(rng, float(rng.uniform(1.58, 1.88))) | worn | {"steps": steps, "leaves": True})
        people[-1]["enter_s"] += float(rng.uniform(-1.8, 1.8))
    return people


def _conference_camera(rng: np.random.Generator, seats: F64) -> CameraMount:
    """A camera that looks at the middle of the seats, nearly."""
    values, middle = resolved(CONFERENCE_CAMERA, rng), seats.mean(axis=0)
    ahead = math.degrees(math.atan2(middle[1] - values["at_m"][1], middle[0] - values["at_m"][0]))
    return CameraMount.model_validate(values | {"heading_deg": ahead + float(rng.uniform(-6, 6))})


def _to_camera(mount: CameraMount, xy_m: F64) -> F64:
    """(N, 2) floor points of the room in the camera's frame: x to the right, y ahead, the camera above (0, 0)."""
    heading = math.radians(mount.heading_deg)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    right = np.array([ahead[1], -ahead[0]])
    away = xy_m - np.array(mount.at_m[:2])
    return np.column_stack([away @ right, away @ ahead])


def _visible_floor(mount: CameraMount, size_m: tuple[float, float, float]) -> np.ndarray:
    """(K, 2) float32 convex outline of where most of a standing person is in the image, in the camera's frame [m]."""
    x, y = np.meshgrid(np.arange(0.3, size_m[0] - 0.3, 0.1), np.arange(0.5, size_m[1] - 0.2, 0.1))
    floor = _to_camera(mount, np.column_stack([x.ravel(), y.ravel()]))
    camera, inside = ground_camera(mount), np.zeros(len(floor))
    heights = np.linspace(0.0, 1.7, 18)
    for height_m in heights:
        u, v = camera.project(np.column_stack([floor, np.full(len(floor), height_m)])).T
        inside += (u >= 0) & (u < mount.width) & (v >= 0) & (v < mount.height)
    visible = floor[inside >= 0.7 * len(heights)].astype(np.float32)
    return visible if len(visible) < 3 else np.asarray(cv2.convexHull(visible)[:, 0])


def two_rigs(table: dict[str, Any], rng: np.random.Generator) -> RandomScene:
    """Two rigs of a random layout in the committed room, whose clocks begin apart, and people who walk about."""
    layout = str(rng.choice(list(LAYOUTS)))
    width, depth, _ = table["room"]["size_m"]
    east, north = 1.2 if layout == "corner" else MARGIN_M, 1.4 if layout == "opposite" else MARGIN_M
    area = (MARGIN_M, 1.4, width - east, depth - north)
    heads: list[dict[str, Any]] = []
    for name, (x, y, heading) in zip(("a", "b"), LAYOUTS[layout], strict=True):
        rig = resolved(RIG, rng)
        rig["at_m"] = (x * width + float(rng.uniform(-0.2, 0.2)), y * depth, rig.pop("height_m"))
        rig["heading_deg"] = heading + float(rng.uniform(-4, 4))
        rig["right_rotation_deg"] = tuple(float(v) for v in rng.uniform(-0.3, 0.3, 3))
        heads.append({"name": name, "start_s": float(rng.uniform(0.15, 1.4)) if heads else 0.0, "rig": rig})
    people = [_walker(i, width, area, rng) for i in range(int(rng.integers(2, 4)))]
    rigs = rigs_of(table | {"seed": int(rng.integers(1 << 31)), "people": people, "head": heads}, "a random scene")
    return RandomScene(rigs[0].scene, rigs=rigs)


def _walker(
    i: int, width: float, area_m: tuple[float, float, float, float], rng: np.random.Generator
) -> dict[str, Any]:
    """A person who enters through an opening and walks about until the end."""
    lane = 2.9 + (-0.5, 0.5, 0.0)[i % 3]
    start, behind, inside = [(x if i % 2 == 0 else width - x, y) for x, y in ((-2.1, 0.8), (-0.9, lane), (0.5, lane))]
    # The room is empty for so long, while the background is learned [s].
    way = {"start_m": start, "enter_s": 3.0 + 2.5 * i, "steps": [{"go": [behind, inside], "speed_mps": 1.2}]}
    wander = {"area_m": area_m, "speed_mps": (0.7, 1.3), "pause_s": (0.0, 1.0)}
    return looks(rng, float(rng.uniform(1.55, 1.9))) | clothes(rng) | way | {"wander": wander}


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


SUITE, VIEWS = SCENES / "suite", SCENES / "views"
SceneKind = Literal["suite", "views", "conference", "rigs"]
KINDS: dict[SceneKind, tuple[Path, Callable[[dict[str, Any], np.random.Generator], RandomScene]]] = {
    "suite": (SUITE, challenge),
    "views": (VIEWS, view),
    "conference": (SCENES / "single" / "conference.toml", conference),
    "rigs": (SCENES / "rigs" / "two.toml", two_rigs),
}
"""The committed table of a kind of scene, or the folder with its tables, and what makes a scene of a table."""
ATTEMPTS = 1000
"""Attempts in which people would walk through each other, or do not fit into the view, are repeated. Ways are random
without regard to when others pass, so the tightest scene, overhead, fits in one attempt of fifty: that all fail has
a probability of 2e-9."""


def random_scene(kind: SceneKind, seed: int, path: Path | None = None) -> RandomScene:
    """The scene of a seed, from 0; the same table and seed give the same scene. Raises InputError: unreadable, no table
    of the kind, or a value out of its range. WorkError: no attempt fits; the ranges ask for too much."""
    path = path or KINDS[kind][0]
    try:
        return scene_of_table(kind, load_toml(path, "a random scene in TOML"), seed, path.stem)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(error)}") from error


def scene_of_table(kind: SceneKind, table: Mapping[str, Any], seed: int, name: str) -> RandomScene:
    """As ``random_scene``; a seed gives other values under every name. Raises pydantic.ValidationError: no table of the
    kind."""
    reason = ""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), attempt])
        try:
            return KINDS[kind][1](resolved(table, rng), rng)
        except NoPlaceError as error:
            reason = str(error)
    raise WorkError(f"{name}, seed {seed}: none of {ATTEMPTS} attempts fits into its room: {reason}")
