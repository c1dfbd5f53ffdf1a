"""Random variants of two committed scenes: the conference room, and a room with two stereo rigs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from benchmarks.random_scenes.challenge import clothes, looks
from benchmarks.random_scenes.suite import resolved, too_near
from calib.errors import WorkError
from calib.io import load_toml
from calib.types import F64
from planview.synthetic.assets import SCENES
from planview.synthetic.camera import ground_camera
from planview.synthetic.motion import scripted_motion
from planview.synthetic.scene import CameraMount, Pair, Scene
from planview.synthetic.write import RigScene, rigs_of

ATTEMPTS = 200
"""Cameras that do not see all seats, and people who walk through each other, are tried again."""
CONFERENCE_CAMERA = {
    "at_m": [{"min": 2.4, "max": 5.6}, {"min": 0.15, "max": 0.3}, {"min": 2.7, "max": 3.3}],
    "tilt_deg": {"min": 46.0, "max": 60.0},
    "focal_px": {"min": 125.0, "max": 165.0},
    "width": 320,
    "height": 240,
}
MARGIN_M = 0.7
"""People walk this far from walls [m]; from those with a rig on them 1.4 m."""
LAYOUTS = {
    "opposite": ((0.36, 0.04, 84.0), (0.64, 0.96, 264.0)),
    "side by side": ((0.27, 0.04, 80.0), (0.73, 0.04, 100.0)),
    "corner": ((0.40, 0.04, 88.0), (0.97, 0.18, 150.0)),
}
"""Where two heads hang, as shares of width and depth, and their heading [deg]: they look across each other."""
HEAD = {
    "height_m": {"min": 2.25, "max": 2.55},
    "tilt_deg": {"min": 61.0, "max": 66.0},
    "roll_deg": {"min": -1.5, "max": 1.5},
    "focal_px": {"min": 106.0, "max": 123.0},
    "baseline_m": {"min": 0.14, "max": 0.18},
}


@dataclass(frozen=True)
class RandomConference:
    """A random scene, and the zone to be counted in: corners on the floor in the camera's frame [m]."""

    scene: Scene
    zone_m: tuple[Pair, ...]


def random_conference(seed: int) -> RandomConference:
    """The committed conference room with another camera, other seats, times and clothes; each seed has its own. Raises
    WorkError: no camera of many sees all seats, or people always meet in the same place."""
    rng = np.random.default_rng([seed, 1008])
    table = load_toml(SCENES / "single" / "conference.toml", "a scene in TOML")
    seats = [item for item in table["furniture"] if item.get("name", "").startswith("c")]
    mount, zone_m = _conference_camera(rng, table, np.array([seat["at_m"] for seat in seats]))
    kind = str(rng.choice(("office_chair", "chair")))
    for seat in seats:
        seat["kind"] = kind
    for _ in range(ATTEMPTS):
        people = _conference_people(table, rng)
        changed = {"seed": int(rng.integers(1 << 31)), "camera": mount, "people": people}
        scene = Scene.model_validate(table | changed)
        furniture, times = {f.name: f for f in scene.furniture if f.name}, np.arange(0.0, scene.duration_s, 0.2)
        sitting = [p for p in scene.people if not p.wander]  # the others give way
        if not too_near([scripted_motion(p, furniture, scene.duration_s).places(times) for p in sitting]):
            return RandomConference(scene, zone_m)
    raise WorkError(f"conference, seed {seed}: people walk through each other in all of {ATTEMPTS} attempts")


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
        people.append(person | looks(rng, float(rng.uniform(1.58, 1.88))) | worn | {"steps": steps})
        people[-1] |= {"enter_s": person["enter_s"] + float(rng.uniform(-1.8, 1.8)), "leaves": True}
    return people


def _conference_camera(
    rng: np.random.Generator, table: dict[str, Any], seats: F64
) -> tuple[CameraMount, tuple[Pair, ...]]:
    """A camera that has every seat in view, and the outline of the floor that it sees."""
    middle = seats.mean(axis=0)
    for _ in range(ATTEMPTS):
        values = resolved(CONFERENCE_CAMERA, rng)
        ahead = math.degrees(math.atan2(middle[1] - values["at_m"][1], middle[0] - values["at_m"][0]))
        mount = CameraMount.model_validate(values | {"heading_deg": ahead + float(rng.uniform(-6, 6))})
        outline = _visible_floor(mount, table["room"]["size_m"]).astype(np.float32)
        places = [(float(u), float(v)) for u, v in _to_camera(mount, seats)]
        # Seats are at least so far inside the zone: a person who sits on its outline is in and out by centimetres.
        if len(outline) > 2 and all(cv2.pointPolygonTest(outline, at, True) >= 0.25 for at in places):
            return mount, tuple((float(x), float(y)) for x, y in outline)
    raise WorkError(f"none of {ATTEMPTS} random cameras has all seats in view")


def _to_camera(mount: CameraMount, xy_m: F64) -> F64:
    """(N, 2) floor points of the room in the camera's frame: x to the right, y ahead, the camera above (0, 0)."""
    heading = math.radians(mount.heading_deg)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    right = np.array([ahead[1], -ahead[0]])
    away = xy_m - np.array(mount.at_m[:2])
    return np.column_stack([away @ right, away @ ahead])


def _visible_floor(mount: CameraMount, size_m: tuple[float, float, float]) -> F64:
    """(K, 2) convex outline of where most of a standing person is in the image, in the camera's frame [m]."""
    x, y = np.meshgrid(np.arange(0.3, size_m[0] - 0.3, 0.1), np.arange(0.5, size_m[1] - 0.2, 0.1))
    floor = _to_camera(mount, np.column_stack([x.ravel(), y.ravel()]))
    camera, inside = ground_camera(mount), np.zeros(len(floor))
    heights = np.linspace(0.0, 1.7, 18)
    for height_m in heights:
        u, v = camera.project(np.column_stack([floor, np.full(len(floor), height_m)])).T
        inside += (u >= 0) & (u < mount.width) & (v >= 0) & (v < mount.height)
    visible = floor[inside >= 0.7 * len(heights)].astype(np.float32)
    return np.zeros((0, 2)) if len(visible) < 3 else np.asarray(cv2.convexHull(visible)[:, 0], np.float64)


def random_rigs(seed: int) -> tuple[RigScene, ...]:
    """The rigs and the scene of a seed; the same seed gives the same recording."""
    rng = np.random.default_rng([seed, 1009])
    table: dict[str, Any] = resolved(load_toml(SCENES / "rigs" / "two.toml", "a scene in TOML"), rng)
    layout = list(LAYOUTS)[seed % len(LAYOUTS)]
    width, depth, _ = table["room"]["size_m"]
    east, north = 1.2 if layout == "corner" else MARGIN_M, 1.4 if layout == "opposite" else MARGIN_M
    area = (MARGIN_M, 1.4, width - east, depth - north)
    heads: list[dict[str, Any]] = []
    for name, (x, y, heading) in zip(("a", "b"), LAYOUTS[layout], strict=True):
        rig = resolved(HEAD, rng) | {"width": 320, "height": 240, "distortion": (-0.08, 0.02, 0.0003, -0.0002, 0.0)}
        rig["at_m"] = (x * width + float(rng.uniform(-0.2, 0.2)), y * depth, rig.pop("height_m"))
        rig["heading_deg"] = heading + float(rng.uniform(-4, 4))
        rig["right_rotation_deg"] = tuple(float(v) for v in rng.uniform(-0.3, 0.3, 3))
        heads.append({"name": name, "start_s": float(rng.uniform(0.15, 1.4)) if heads else 0.0, "rig": rig})
    people = [_walker(i, width, area, rng) for i in range(int(rng.integers(2, 4)))]
    return rigs_of(table | {"seed": int(rng.integers(1 << 31)), "people": people, "head": heads}, f"seed {seed}")


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
