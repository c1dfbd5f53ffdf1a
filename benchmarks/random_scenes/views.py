"""Random views of one camera: a seed decides camera, room, light, clothes and the ways of people past a line.

The table of a view has ranges as scenes of the challenge suite have (``suite.resolved``). How large people are in the
image is random, and the camera hung so that they are.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import Field

from benchmarks.random_scenes.challenge import clothes, looks
from benchmarks.random_scenes.suite import resolved
from calib.params import Params
from planview.synthetic.camera import ground_camera
from planview.synthetic.scene import Capture, Pair, Scene

BODY_M, DEPTH_M = 1.7, 0.45
"""A person's height and, from straight above, depth [m]."""
BEYOND_M = 2.2
"""People come to be, and cease, so far beyond the openings [m]: out of view."""
STEEP_DEG = 35.0
"""Cameras steeper than this hang over the middle of the room."""
FLOORS = (("tiles", "#a39a8a"), ("wood", "#b98f5f"), ("carpet", "#5c6a78"), ("concrete", "#8f959a"))
GREYS = ("#b8b4ac", "#a8a8a4", "#98a0a4", "#c4c0b8")


class ViewCamera(Params):
    """Where the camera hangs follows from how large people are in its image."""

    width: int = Field(320, ge=64, le=1280)
    height: int = Field(240, ge=48, le=960)
    tilt_deg: float = Field(ge=0, le=87)
    """Angle of the optical axis from straight down."""
    lens_deg: float = Field(50.0, ge=25, le=100)
    """Vertical field of view [deg]."""
    person_share: float = Field(ge=0.04, le=0.9)
    """Height of a person in the middle of the view over the height of the image."""


class ViewWalks(Params):
    """Who passes the line, and how."""

    people: int = Field(ge=1, le=30)
    start_s: float = Field(1.5, ge=0)
    """When the first person comes to be [s]."""
    every_s: float = Field(3.0, ge=0.2, le=60)
    """Mean time between two people's coming [s]."""
    across: bool = False
    """Across the view, from side to side; else towards the camera and away from it."""
    order: Literal["mixed", "waves", "single"] = "mixed"
    """mixed: each a direction of their own. waves: the first half one way, the second half the other. single: each
    comes when the one before has gone."""
    together: float = Field(0.2, ge=0, le=1)
    """Share of people who walk next to the one before."""
    width_m: float = Field(2.2, ge=0.8, le=12)
    """Width of the way [m]."""
    speed_mps: Pair = (0.9, 1.5)
    stop_s: Pair = (0.0, 0.0)
    """How long people stand in the middle of their way [s]."""


class ViewLight(Params):
    """Light in the room."""

    ambient: float = Field(0.5, ge=0.02, le=3)
    lamps: int = Field(1, ge=0, le=3)
    sun: bool = False
    brightness: float = Field(0.22, gt=0.005, le=0.8)
    """Mean linear level of the empty room: from dark to glaring."""
    dimmed: bool = False
    """Whether a lamp is dimmed for a while."""
    full_well_e: float = Field(9000.0, ge=150)
    """Electrons at full scale; few make noise."""
    blur_px: float = Field(0.6, ge=0, le=3)


class ViewRoom(Params):
    """The room around the way."""

    beyond_m: float = Field(2.0, ge=0.5, le=20)
    """From the middle of the view to the wall behind it [m]."""
    gloss: float = Field(0.0, ge=0, le=0.3)
    """Share of light that the floor mirrors."""
    grey_clothes: float = Field(0.1, ge=0, le=1)
    """Share of people whose clothes have the wall's colour."""
    moved: bool = False
    """Whether a piece of furniture is moved once."""


class ViewTable(Params):
    """A view with every range resolved, but no person placed yet."""

    description: str
    fps: float = Field(10.0, ge=5, le=30)
    duration_s: float = Field(30.0, ge=5, le=120)
    camera: ViewCamera
    walks: ViewWalks
    light: ViewLight = ViewLight()
    room: ViewRoom = ViewRoom()
    capture: Capture = Capture()


@dataclass(frozen=True)
class RandomView:
    """A random scene and the line to be counted at.

    Attributes:
        wire_px: both ends in the image.
    """

    scene: Scene
    wire_px: tuple[Pair, Pair]


def random_view(
    table: Mapping[str, Any], seed: int, name: str, changes: Mapping[str, Mapping[str, Any]] | None = None
) -> RandomView:
    """The view of a seed; the same table, seed and name give the same view.

    Args:
        changes: values by section and key that take the place of the random ones, e.g. ``{"room": {"gloss": 0.2}}``.
    Raises:
        pydantic.ValidationError: the table is no view, or a value is out of its range.
    """
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    values = dict(resolved(table, rng))
    for section, others in (changes or {}).items():
        values[section] = {**values.get(section, {}), **others}
    return _ViewComposer(ViewTable.model_validate(values), rng).composed()


class _ViewComposer:
    """A room around one camera, seen from the room's frame: y ahead, the camera above (``_x``, ``_y``)."""

    def __init__(self, view: ViewTable, rng: np.random.Generator) -> None:
        self._view, self._rng = view, rng
        camera = view.camera
        tilt = math.radians(camera.tilt_deg)
        self._focal = camera.height / 2 / math.tan(math.radians(camera.lens_deg) / 2)
        length = BODY_M * math.sin(tilt) + DEPTH_M * math.cos(tilt)
        self._range_m = self._focal * length / (camera.person_share * camera.height)
        self._height_m = 0.9 + 0.5 * math.cos(tilt) + self._range_m * math.cos(tilt)
        self._ahead_m = self._range_m * math.sin(tilt)
        half = 0.5 * camera.width / self._focal * self._range_m
        self._reach_m = min(view.walks.width_m / 2 - 0.3, 0.75 * half) if not view.walks.across else half
        is_steep = camera.tilt_deg < STEEP_DEG
        self._y = max(0.3, view.walks.width_m / 2 + 1.0) if is_steep else 0.3
        wide = max(view.walks.width_m, 2 * half if view.walks.across else 0.0) + 1.0
        self._size = (wide, self._y + self._ahead_m + view.room.beyond_m, max(2.5, self._height_m + 0.3))
        self._x = wide / 2
        self._mount = {
            "at_m": (self._x, self._y, self._height_m), "heading_deg": 90.0, "tilt_deg": camera.tilt_deg,
            "width": camera.width, "height": camera.height, "focal_px": self._focal,
        }  # fmt: skip

    def composed(self) -> RandomView:
        """The scene and the line to be counted at."""
        view, light = self._view, self._view.light
        scene = Scene.model_validate(
            {
                "description": view.description,
                "seed": int(self._rng.integers(1 << 31)),
                "fps": view.fps,
                "duration_s": view.duration_s,
                "room": self._room(),
                "camera": self._mount,
                "sensor": {
                    "brightness": light.brightness,
                    "full_well_e": light.full_well_e,
                    "blur_px": light.blur_px,
                    "vignetting": float(self._rng.uniform(0.05, 0.3)),
                },
                "lights": self._lights(),
                "furniture": self._furniture(),
                "people": self._people(),
                "capture": view.capture,
            }
        )
        return RandomView(scene, self._wire(scene))

    def _room(self) -> dict[str, Any]:
        walks, (x, y, z) = self._view.walks, self._size
        texture, colour = FLOORS[int(self._rng.integers(len(FLOORS)))]
        if walks.across:
            low = max(0.4, self._y + self._ahead_m - walks.width_m / 2)
            width = min(walks.width_m, y - low - 0.2)
            openings = [{"wall": wall, "from_m": low, "width_m": width} for wall in ("west", "east")]
        else:
            low = self._x - walks.width_m / 2
            openings = [{"wall": wall, "from_m": low, "width_m": walks.width_m} for wall in ("north", "south")]
        high = min(5.5, z - 0.2)
        scale_m, contrast = float(self._rng.uniform(0.15, 0.5)), float(self._rng.uniform(0.1, 0.35))
        self._grey = str(self._rng.choice(GREYS))
        return {
            "size_m": (x, y, z),
            "floor": {"texture": texture, "colour": colour, "scale_m": scale_m, "contrast": contrast,
                      "gloss": self._view.room.gloss},
            "walls": {"colour": self._grey, "scale_m": 0.8, "contrast": 0.06},
            "openings": [o | {"height_m": high} for o in openings],
        }  # fmt: skip

    def _lights(self) -> dict[str, Any]:
        light, rng, (x, y, z) = self._view.light, self._rng, self._size
        lamps: list[dict[str, Any]] = [
            {"at_m": (float(rng.uniform(0.2, 0.8) * x), float(rng.uniform(0.3, 0.9) * y), z - 0.1),
             "level": float(rng.uniform(0.2, 0.5)) * max(1.0, (z / 2.8) ** 2), "shadows": k == 0}
            for k in range(light.lamps)
        ]  # fmt: skip
        if light.sun:
            towards = (float(rng.choice((-1, 1)) * rng.uniform(0.4, 0.9)), float(rng.uniform(-0.2, 0.4)), -0.8)
            lamps.append({"kind": "sun", "towards": towards, "level": float(rng.uniform(0.4, 0.9))})
        if light.dimmed and lamps:
            at, level = float(rng.uniform(0.3, 0.6)) * self._view.duration_s, float(rng.uniform(0.3, 0.7))
            lamps[0]["dim"] = ((at, 1.0), (at + 0.4, level), (at + 5.0, level), (at + 5.4, 1.0))
        return {"ambient": light.ambient, "lamps": lamps}

    def _furniture(self) -> list[dict[str, Any]]:
        if not self._view.room.moved:
            return []
        x = self._x + float(self._rng.choice((-1, 1))) * (self._size[0] / 2 - 0.35)
        y, t = self._y + self._ahead_m, float(self._rng.uniform(0.35, 0.6)) * self._view.duration_s
        moves = ({"t_s": t, "at_m": (x, y)}, {"t_s": t + 1.5, "at_m": (x, y + 0.4)})
        return [{"kind": "box", "at_m": (x, y), "size_m": (0.5, 0.5, 0.6), "moves": moves}]

    def _people(self) -> list[dict[str, Any]]:
        walks, rng, people = self._view.walks, self._rng, []
        enter, forward, lane, speed = walks.start_s, True, 0.0, 1.0
        for i in range(walks.people):
            aside = i > 0 and walks.order != "single" and rng.random() < walks.together
            if aside:
                shift = 0.65 if lane < 0 else -0.65
                enter, lane = enter + float(rng.uniform(0.0, 0.3)), lane + shift
            else:
                if i and walks.order == "single":
                    enter += self._length_m / speed + walks.stop_s[1] + float(rng.uniform(0.5, walks.every_s))
                elif i:
                    enter += float(rng.uniform(0.5, 1.5)) * walks.every_s
                forward = i < walks.people / 2 if walks.order == "waves" else bool(rng.random() < 0.5)
                speed = float(rng.uniform(*walks.speed_mps))
                # On the right of the way, as seen by the one who walks there.
                lane = float(rng.uniform(0.0, 1.0)) * max(0.1, self._reach()) * (1 if forward else -1)
            people.append(self._person(enter, forward, lane, speed))
            if enter + self._length_m / speed > self._view.duration_s:
                people.pop()
                break
        return people

    def _reach(self) -> float:
        walks = self._view.walks
        return min(walks.width_m / 2 - 0.3, 0.2 * self._range_m) if walks.across else self._reach_m

    @property
    def _length_m(self) -> float:
        return (self._size[0] if self._view.walks.across else self._size[1]) + 2 * BEYOND_M

    def _person(self, enter_s: float, forward: bool, lane: float, speed: float) -> dict[str, Any]:
        walks, rng = self._view.walks, self._rng
        ends = (-BEYOND_M, self._length_m - BEYOND_M)
        start, end = ends if forward else ends[::-1]
        middle = self._size[0] / 2 if walks.across else self._y + self._ahead_m
        points = [
            (along, self._y + self._ahead_m - lane) if walks.across else (self._x + lane, along)
            for along in (start, middle, end)
        ]
        look = looks(rng, float(rng.uniform(1.55, 1.9))) | clothes(rng)
        if rng.random() < self._view.room.grey_clothes:
            look["shirt"] = {"colour": self._grey, "scale_m": 0.08, "contrast": 0.1}
        look |= {"start_m": points[0], "enter_s": enter_s}
        stop = float(rng.uniform(*walks.stop_s))
        if stop > 0.3:
            steps = [
                {"go": [points[1]], "speed_mps": speed},
                {"stand_s": stop},
                {"go": [points[2]], "speed_mps": speed},
            ]
            return look | {"steps": steps, "leaves": True}
        area = (0.3, 0.3, self._size[0] - 0.3, self._size[1] - 0.3)
        way = {"area_m": area, "speed_mps": (speed, speed), "until_s": 0, "exit_m": points[1:]}
        return look | {"wander": way}

    def _wire(self, scene: Scene) -> tuple[Pair, Pair]:
        """Across the way through the middle of the view, at the feet of people; 0.7 m off where people stop."""
        camera = self._view.camera
        width, height = float(camera.width - 1), float(camera.height - 1)
        assert scene.camera is not None  # composed above
        project = ground_camera(scene.camera).project
        # How far from where people stand the line is [m]: no person hesitates on it.
        aside = 0.7 if self._view.walks.stop_s[1] > 0 else 0.0
        if self._view.walks.across:
            middle = float(project(np.array([[aside, self._ahead_m, 0.0]]))[0, 0])
            far = float(project(np.array([[0.0, self._ahead_m + self._reach() + 1.0, 0.0]]))[0, 1])
            return (middle, max(0.0, far)), (middle, height)
        row = height / 2
        if camera.tilt_deg >= STEEP_DEG:
            row = min(0.88 * height, float(project(np.array([[0.0, self._ahead_m + aside, 0.0]]))[0, 1]))
        return (0.0, row), (width, row)
