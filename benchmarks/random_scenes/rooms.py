"""Random rooms with a fixed programme: a conference room, and a room with two stereo rigs."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from benchmarks.random_scenes.challenge import Challenge, clothes, looks, random_light
from calib.errors import WorkError
from calib.types import F64
from planview.synthetic.camera import ground_camera
from planview.synthetic.scene import CameraMount, Pair, Scene
from planview.synthetic.write import RigScene, rigs_of

PEOPLE, FPS = 12, 10.0
ATTEMPTS = 200
"""Cameras that do not see all seats are tried again."""
WALLS = ("#dad4c8", "#c8ccd0", "#b8b4ac", "#e2dccf")
CARPETS = ("#66707c", "#7c6a5c", "#5c6a5e", "#8a8478")


@dataclass(frozen=True)
class RandomConference:
    """A drawn scene, and the zone to be counted in: corners on the floor in the camera's frame [m]."""

    scene: Scene
    zone_m: tuple[Pair, ...]


@dataclass(frozen=True)
class _Seat:
    """A chair: name, place [m], and on which side of the table (-1 nearer to the camera, 1 beyond)."""

    name: str
    at_m: Pair
    side: int


def random_conference(seed: int) -> RandomConference:
    """The room of a seed; the same seed gives the same room. Raises WorkError: no camera of many sees all seats."""
    return _RoomComposer(np.random.default_rng([seed, 1008])).composed()


class _RoomComposer:
    """Draws one room: x to the east, y to the north, the camera on the south wall or in one of its corners."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._size = (self._uniform(7.2, 9.0), self._uniform(7.0, 8.4), 3.5)
        self._door_x = 0.6 if rng.random() < 0.5 else self._size[0] - 0.6
        self._wall = str(rng.choice(WALLS))
        per_side = 4 if self._size[0] < 8.0 else 5
        self._table = (0.9 * per_side + 0.3, self._uniform(1.1, 1.4))
        x, y = (0.5 * self._size[0] + self._uniform(-0.2, 0.2), self._size[1] - self._uniform(2.6, 3.0))
        self._middle = (x, y)
        self._chair = str(rng.choice(("office_chair", "office_chair", "chair")))
        across = 0.5 * self._table[1] + 0.5
        self._seats = [
            _Seat(f"c{2 * i + (side > 0)}", (x + 0.9 * (i - 0.5 * (per_side - 1)), y + side * across), side)
            for i in range(per_side)
            for side in (-1, 1)
        ]
        self._outside = (self._door_x + math.copysign(3.2, self._door_x - 1.0), 1.0)

    def composed(self) -> RandomConference:
        """Camera, furniture and people."""
        mount, zone_m = self._camera()
        width, depth, high = self._size
        seed, carpet = int(self._rng.integers(1 << 31)), str(self._rng.choice(CARPETS))
        floor = {"texture": "carpet", "colour": carpet, "scale_m": 0.25, "contrast": self._uniform(0.2, 0.4)}
        room = {
            "size_m": self._size,
            "floor": floor,
            "walls": {"colour": self._wall, "scale_m": 0.8, "contrast": 0.05},
            "openings": [{"wall": "west" if self._door_x < 1.0 else "east", "from_m": 0.4, "width_m": 1.2}],
        }
        lamps = [{"at_m": (a * width, b * depth, high - 0.1), "level": self._uniform(0.3, 0.5)}
                 for a, b in ((0.3, 0.4), (0.7, 0.65))]  # fmt: skip
        lights = {"ambient": self._uniform(0.4, 0.6), "lamps": lamps}
        chairs: list[dict[str, Any]] = [
            {"kind": self._chair, "name": s.name, "at_m": s.at_m, "heading_deg": -90.0 * s.side} for s in self._seats
        ]
        swivelled = chairs[int(self._rng.integers(len(chairs)))]
        swivelled["swivel"] = {"from_s": 8, "until_s": 14, "amplitude_deg": 50, "period_s": 3}
        table = {"kind": "table", "at_m": self._middle, "size_m": (*self._table, 0.74)}
        scene = Scene.model_validate(
            {
                "description": "A drawn conference room fills from no person to twelve and empties again.",
                "seed": seed,
                "fps": FPS,
                "duration_s": 115.0,
                "room": room,
                "camera": mount,
                "lights": lights,
                "furniture": [table, *chairs],
                "people": self._people(),
            }
        )
        return RandomConference(scene, zone_m)

    def _uniform(self, low: float, high: float) -> float:
        return float(self._rng.uniform(low, high))

    def _camera(self) -> tuple[CameraMount, tuple[Pair, ...]]:
        """A camera that has every seat in view, and the outline of the floor that it sees."""
        width, rng, seats = self._size[0], self._rng, np.array([seat.at_m for seat in self._seats])
        for _ in range(ATTEMPTS):
            x = self._uniform(0.3, 0.7) * width if rng.random() < 0.6 else float(rng.choice((0.25, width - 0.25)))
            y, z = self._uniform(0.15, 0.3), self._uniform(2.7, 3.3)
            ahead = math.degrees(math.atan2(self._middle[1] - y, self._middle[0] - x))
            mount = CameraMount.model_validate(
                {"at_m": (x, y, z), "heading_deg": ahead + self._uniform(-6, 6), "tilt_deg": self._uniform(46, 60),
                 "focal_px": self._uniform(125, 165), "width": 320, "height": 240}
            )  # fmt: skip
            outline = _visible_floor(mount, self._size).astype(np.float32)
            places = [(float(u), float(v)) for u, v in _to_camera(mount, seats)]
            # Seats are at least so far inside the zone: a person who sits on its outline is in and out by centimetres.
            if len(outline) > 2 and all(cv2.pointPolygonTest(outline, at, True) >= 0.25 for at in places):
                return mount, tuple((float(x), float(y)) for x, y in outline)
        raise WorkError(f"no camera of {ATTEMPTS} drawn has all seats in view")

    def _people(self) -> list[dict[str, Any]]:
        rng, seats = self._rng, list(self._seats)
        rng.shuffle(seats)
        sitting = 8 if len(seats) < 10 else int(rng.integers(8, 10))
        # When the first person gets up [s].
        enter, leave = self._times(6.0, 3.6), self._times(64.0, 2.6)
        rng.shuffle(leave)
        front = self._middle[1] - 0.5 * self._table[1] - 1.2
        area = (1.4, min(1.3, front - 0.8), self._size[0] - 1.4, front)
        people: list[dict[str, Any]] = []
        for i, enter_s in enumerate(enter):
            person, worn = looks(rng, self._uniform(1.58, 1.88)), clothes(rng)
            if people and rng.random() < 0.25:  # in the clothes of another
                other = people[int(rng.integers(len(people)))]
                worn = {name: other[name] for name in worn}
            if rng.random() < 0.1:  # in a shirt of the wall's colour
                worn["shirt"] = {"colour": self._wall, "scale_m": 0.08, "contrast": 0.1}
            person |= worn | {"start_m": self._outside, "enter_s": float(enter_s), "leaves": True}
            if i < sitting:
                people.append(person | {"steps": self._sitting(seats[i], enter_s, float(leave[i]))})
            else:
                way = {"area_m": area, "speed_mps": (0.6, 1.1), "pause_s": (3, 9), "until_s": float(leave[i]),
                       "exit_m": [(self._door_x, 1.0), self._outside]}  # fmt: skip
                people.append(person | {"steps": [{"go": [(self._door_x, 1.0)], "speed_mps": 1.2}], "wander": way})
        return people

    def _times(self, first_s: float, mean_s: float) -> F64:
        # Some follow the one before at an arm's length.
        file = self._rng.random(PEOPLE) < 0.3
        gaps = np.where(file, self._rng.uniform(0.8, 1.2, PEOPLE), self._rng.uniform(0.7, 1.7, PEOPLE) * mean_s)
        return first_s + np.cumsum(gaps)

    def _sitting(self, seat: _Seat, enter_s: float, leave_s: float) -> list[dict[str, Any]]:
        x, y = seat.at_m
        beside, aisle = (x + 0.45, y), y + 0.9 * seat.side
        way = [(self._door_x, 1.0), (x + 0.45, aisle), beside]
        if seat.side > 0:
            way.insert(1, (self._door_x, aisle))
        speed = self._uniform(1.0, 1.3)
        length = sum(math.dist(a, b) for a, b in zip([self._outside, *way[:-1]], way, strict=True))
        seconds = max(5.0, leave_s - enter_s - length / speed - 2.0)
        return [
            {"go": way, "speed_mps": speed},
            {"sit_s": seconds, "on": seat.name},
            {"go": [*way[::-1], self._outside], "speed_mps": self._uniform(1.0, 1.3)},
        ]


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
    body = np.linspace(0.0, 1.7, 18)
    points = np.concatenate(
        [
            np.repeat(floor[:, None], len(body), axis=1),
            np.broadcast_to(body[None, :, None], (len(floor), len(body), 1)),
        ],
        axis=2,
    )
    u, v = np.moveaxis(ground_camera(mount).project(points), -1, 0)
    inside = (u >= 0) & (u < mount.width) & (v >= 0) & (v < mount.height)
    visible = floor[inside.mean(axis=1) >= 0.7].astype(np.float32)
    if len(visible) < 3:
        return np.zeros((0, 2))
    return np.asarray(cv2.convexHull(visible)[:, 0], np.float64)


MARGIN_M = 0.7
"""People walk this far from walls [m]; from those with a rig on them 1.4 m."""
LAYOUTS = ("opposite", "beside", "corner")


def random_rigs(seed: int) -> tuple[RigScene, ...]:
    """The rigs and the scene of a seed; the same seed gives the same recording."""
    rng = np.random.default_rng([seed, zlib.crc32(b"heads")])
    size = float(rng.uniform(6.5, 7.5)), float(rng.uniform(5.4, 6.2)), 2.9
    layout = LAYOUTS[seed % len(LAYOUTS)]
    challenge = Challenge.model_validate(
        {
            "description": f"two heads {layout}, people walk from one to the other",
            "covers": ["320x240"],
            "choreography": [{"kind": "wander"}],
            "room": dict(zip(("width_m", "depth_m", "height_m"), size, strict=True)),
            "light": {"lamps": 2, "ambient": float(rng.uniform(0.35, 0.6))},
        }
    )
    lights, sensor = random_light(challenge, rng)
    openings = [{"wall": wall, "from_m": 0.5 * size[1] - 1.2, "width_m": 2.4} for wall in ("west", "east")]
    table: dict[str, Any] = {
        "description": challenge.description,
        "seed": int(rng.integers(1 << 31)),
        "fps": 10.0,
        "duration_s": 36.0,
        "room": {
            "size_m": size,
            "floor": {
                "texture": "tiles",
                "colour": "#a39a8a",
                "scale_m": float(rng.uniform(0.2, 0.5)),
                "contrast": 0.3,
            },
            "walls": {"colour": "#d6d0c2", "scale_m": 0.8, "contrast": 0.08},
            "openings": openings,
            "panels": [{"wall": wall, "from_m": float(rng.uniform(1, 4))} for wall in ("north", "south")],
        },
        "furniture": [{"kind": "plant", "at_m": (0.5, size[1] - 0.5)}, {"kind": "box", "at_m": (size[0] - 0.5, 0.5)}],
        "lights": lights,
        "sensor": sensor,
        "people": [_walker(i, size, layout, rng) for i in range(int(rng.integers(2, 4)))],
        "head": _heads(layout, size, rng),
    }
    return rigs_of(table, f"seed {seed}")


def _heads(layout: str, size: tuple[float, float, float], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Two mounts on the walls, one to one and a half shoulder-heights above people, looking across each other."""
    width, depth, _ = size
    first, second = {
        "opposite": ((0.36 * width, 0.2, 84.0), (0.64 * width, depth - 0.2, 264.0)),
        "beside": ((0.27 * width, 0.2, 80.0), (0.73 * width, 0.2, 100.0)),
        "corner": ((0.40 * width, 0.2, 88.0), (width - 0.2, 0.18 * depth, 150.0)),
    }[layout]
    starts = 0.0, float(rng.uniform(0.15, 1.4))
    return [
        {
            "name": name,
            "start_s": start,
            "rig": {
                "at_m": (x + float(rng.uniform(-0.2, 0.2)), y, float(rng.uniform(2.25, 2.55))),
                "heading_deg": heading + float(rng.uniform(-4, 4)),
                "tilt_deg": float(rng.uniform(61, 66)),
                "roll_deg": float(rng.uniform(-1.5, 1.5)),
                "width": 320,
                "height": 240,
                "focal_px": 160 / math.tan(math.radians(rng.uniform(66, 74)) / 2),
                "baseline_m": float(rng.uniform(0.14, 0.18)),
                "right_rotation_deg": tuple(float(v) for v in rng.uniform(-0.3, 0.3, 3)),
                "distortion": (-0.08, 0.02, 0.0003, -0.0002, 0.0),
            },
        }
        for name, start, (x, y, heading) in zip(("a", "b"), starts, (first, second), strict=True)
    ]


def _walker(i: int, size: tuple[float, float, float], layout: str, rng: np.random.Generator) -> dict[str, Any]:
    """A person who enters through an opening and walks about until the end."""
    width, depth, _ = size
    west = i % 2 == 0
    lane = 0.5 * depth + (-0.5, 0.5, 0.0)[i % 3]
    hidden, behind, inside = (-2.1, 0.5 * depth - 2.1), (-0.9, lane), (0.5, lane)
    way = [p if west else (width - p[0], p[1]) for p in (hidden, behind, inside)]
    north = 1.4 if layout == "opposite" else MARGIN_M
    east = 1.2 if layout == "corner" else MARGIN_M
    # The room is empty for so long, while the background is learned [s].
    return (
        looks(rng, float(rng.uniform(1.55, 1.9)))
        | clothes(rng)
        | {
            "start_m": way[0],
            "enter_s": 3.0 + 2.5 * i,
            "face_deg": 0.0 if west else 180.0,
            "steps": [{"go": way[1:], "speed_mps": 1.2}],
            "wander": {
                "area_m": (MARGIN_M, 1.4, width - east, depth - north),
                "speed_mps": (0.7, 1.3),
                "pause_s": (0.0, 1.0),
            },
        }
    )
