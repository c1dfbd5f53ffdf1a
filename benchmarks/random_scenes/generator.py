"""Random scenes of every kind: a seed decides room, cameras, light, people and ways.

Challenges have a file of their own. Here are the committed conference room and room of two heads, varied.
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
from benchmarks.random_scenes.stage import clothes, looks
from benchmarks.random_scenes.tables import NoPlaceError, RandomScene, resolved
from calib.errors import InputError, WorkError
from calib.io import load_toml
from calib.params import first_problem
from calib.types import F64
from planview.synthetic.assets import SCENES
from planview.synthetic.camera import ground_camera
from planview.synthetic.motion import scripted_motion
from planview.synthetic.scene import CameraMount, Scene
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


SUITE = SCENES / "suite"
SceneKind = Literal["suite", "conference", "rigs"]
KINDS: dict[SceneKind, tuple[Path, Callable[[dict[str, Any], np.random.Generator], RandomScene]]] = {
    "suite": (SUITE, challenge),
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
