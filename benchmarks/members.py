"""Members of a committed scene: the same story at other places and speeds, in other clothes, light and cameras."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.errors import WorkError
from planview.synthetic.motion import scripted_motion
from planview.synthetic.scene import Room, Scene
from planview.synthetic.write import RigScene, rigs_of

ATTEMPTS = 200
"""A member in which people would walk through each other is drawn again."""
APART_M = 0.38
"""Smallest distance between two body axes [m]: shoulders turned, touching."""
STRETCH = (0.96, 1.06)
"""Factor on all places on the floor."""
PACE = (0.88, 1.12)
"""Factor on all times; speeds change by its inverse."""
SET_OUT_S = 0.6
"""People set out this much earlier or later, on their own [s]."""
TALL = (0.97, 1.03)
"""Factor on a person's height."""
SHIRTS = ("#3a5a8a", "#b04838", "#3c6a4a", "#c8b8a0", "#24282c", "#d9a441", "#c05878", "#e0e0d8", "#6a4a8a", "#3878a0",
          "#8a5a3c", "#a8b4c0")  # fmt: skip
TROUSERS = ("#2f3e58", "#3a3a44", "#55504a", "#6a5a44", "#24242a", "#46586e", "#8a7a60", "#403848")
SKIN = ("#d0a080", "#e0b898", "#b98560", "#8a5a3c", "#6a4430")
HAIR = ("#1c1a18", "#3a2a1c", "#6b4423", "#b08848", "#787470", "#c8c4bc")
TEXTURES = ("plain", "plain", "stripes", "checks", "print")
FLOORS = (("tiles", "#a39a8a"), ("wood", "#b98f5f"), ("carpet", "#5c6a78"), ("carpet", "#786858"),
          ("concrete", "#8f959a"))  # fmt: skip
WALLS = ("#d8d4c8", "#cfd6d8", "#dcd2c0")
SIDES = {"west": "east", "east": "west"}
Table = dict[str, Any]


@dataclass(frozen=True)
class Placement:
    """Map of places of the committed scene to a member: mirrored left to right, or not, and stretched."""

    width_m: float
    is_mirrored: bool
    stretch: float

    def point(self, at_m: Sequence[float]) -> list[float]:
        """A place x, y, or one at a height x, y, z [m]."""
        x_m, y_m, *z_m = at_m
        if self.is_mirrored:
            x_m = self.width_m - x_m
        return [x_m * self.stretch, y_m * self.stretch, *z_m]

    def heading_deg(self, heading_deg: float) -> float:
        """A direction on the floor."""
        return 180.0 - heading_deg if self.is_mirrored else heading_deg


class Variation:
    """A member of a committed scene, as tables of its TOML file."""

    def __init__(self, table: Mapping[str, Any], rng: np.random.Generator) -> None:
        self.rng = rng
        self.pace = float(rng.uniform(*PACE))
        width_m, _, self.ceiling_m = Room.model_validate(table.get("room", {})).size_m
        self.floor = Placement(width_m, bool(rng.random() < 0.5), float(rng.uniform(*STRETCH)))
        self.table: Table = {
            "description": table.get("description", ""),
            "seed": int(rng.integers(1 << 31)),
            "fps": table.get("fps", 15.0),
            "duration_s": table.get("duration_s", 10.0) * self.pace,
            "room": self.room(table.get("room", {})),
            "sensor": self.sensor(table.get("sensor", {})),
            "lights": self.lights(table.get("lights", {})),
            "furniture": [self.furniture(item) for item in table.get("furniture", ())],
            "people": self.people(table.get("people", ())),
        }
        for key in ("rig", "camera"):
            if key in table:
                self.table[key] = self.mount(table[key])
        if "mount" in table:
            self.table["mount"] = [mount | {"rig": self.mount(mount["rig"])} for mount in table["mount"]]

    def near(self, value: float, most: float) -> float:
        """A value within a tolerance."""
        return value + float(self.rng.uniform(-most, most))

    def times(self, value: float, least: float, most: float) -> float:
        """A value times a random factor."""
        return value * float(self.rng.uniform(least, most))

    def choose(self, choices: Sequence[Any]) -> Any:
        """One of several."""
        return choices[int(self.rng.integers(len(choices)))]

    def room(self, room: Table) -> Table:
        """The room, with another floor and other walls."""
        width_m, depth_m, height_m = Room.model_validate(room).size_m
        stretch = self.floor.stretch
        texture, colour = self.choose(FLOORS)
        surface = {"texture": texture, "colour": colour, "scale_m": self.near(0.32, 0.18)}
        surface |= {"contrast": self.near(0.25, 0.13), "gloss": room.get("floor", {}).get("gloss", 0.0)}
        return room | {
            "size_m": [width_m * stretch, depth_m * stretch, height_m],
            "floor": surface,
            "walls": {"colour": self.choose(WALLS), "scale_m": 0.8, "contrast": 0.06},
            "openings": [self.on_wall(opening, width_m, 1.0) for opening in room.get("openings", ())],
            "panels": [self.on_wall(panel, width_m, 0.8) for panel in room.get("panels", ())],
        }

    def on_wall(self, item: Table, room_width_m: float, usual_width_m: float) -> Table:
        """An opening or a panel on its wall, or on the other one."""
        wall = item["wall"]
        from_m = item["from_m"]
        width_m = item.get("width_m", usual_width_m)
        if self.floor.is_mirrored:
            if wall not in SIDES:
                from_m = room_width_m - from_m - width_m
            wall = SIDES.get(wall, wall)
        stretch = self.floor.stretch
        return item | {"wall": wall, "from_m": from_m * stretch, "width_m": width_m * stretch}

    def sensor(self, sensor: Table) -> Table:
        """Another sensor, with the exposure of the committed one over time."""
        varied: Table = {
            "brightness": self.near(0.25, 0.05),
            "full_well_e": self.near(11_000.0, 5000.0),
            "vignetting": self.near(0.2, 0.1),
            "mismatch": float(self.rng.uniform(0.0, 0.03)),
        }
        if "exposure" in sensor:
            varied["exposure"] = self.keyframes(sensor["exposure"])
        return sensor | varied

    def keyframes(self, frames: Sequence[Sequence[float]]) -> list[list[float]]:
        """Values at other times."""
        return [[time_s * self.pace, value] for time_s, value in frames]

    def lights(self, lights: Table) -> Table:
        """Other levels, and lamps at other places."""
        lamps = []
        for lamp in lights.get("lamps", ()):
            varied = lamp | {"level": self.times(lamp.get("level", 0.6), 0.8, 1.25)}
            if "at_m" in lamp:
                x_m, y_m, z_m = self.floor.point(lamp["at_m"])
                varied["at_m"] = [self.near(x_m, 0.4), self.near(y_m, 0.4), z_m]
            if "towards" in lamp:
                x_m, y_m, z_m = lamp["towards"]
                if self.floor.is_mirrored:
                    x_m = -x_m
                varied["towards"] = [self.near(x_m, 0.1), self.near(y_m, 0.1), z_m]
            if "dim" in lamp:
                varied["dim"] = self.keyframes(lamp["dim"])
            lamps.append(varied)
        return lights | {"ambient": self.times(lights.get("ambient", 0.45), 0.8, 1.25), "lamps": lamps}

    def furniture(self, item: Table) -> Table:
        """A thing at its place."""
        varied = item | {"at_m": self.floor.point(item["at_m"])}
        varied["heading_deg"] = self.floor.heading_deg(item.get("heading_deg", 0.0))
        if "moves" in item:
            varied["moves"] = [self.move(move) for move in item["moves"]]
        return varied

    def move(self, move: Table) -> Table:
        """Place of a thing at a time."""
        varied = move | {"t_s": move["t_s"] * self.pace, "at_m": self.floor.point(move["at_m"])}
        if "heading_deg" in move:
            varied["heading_deg"] = self.floor.heading_deg(move["heading_deg"])
        return varied

    def people(self, people: Sequence[Table]) -> list[Table]:
        """People who look different; those who are dressed alike, equally tall, or set out together still are or do."""
        clothes: dict[str, Table] = {}
        tall: dict[float, float] = {}
        later_s: dict[float, float] = {}
        varied = []
        for person in people:
            worn = str(person.get("shirt")), str(person.get("trousers"))
            height_m = person.get("height_m", 1.72)
            enter_s = person.get("enter_s", 0.0)
            own = clothes.setdefault(str(worn), self.clothes())
            factor = tall.setdefault(height_m, float(self.rng.uniform(*TALL)))
            delay_s = later_s.setdefault(enter_s, self.near(0.0, SET_OUT_S))
            looks = {
                "height_m": height_m * factor,
                "build": self.times(person.get("build", 1.0), 0.95, 1.05),
                "skin": self.choose(SKIN),
                "hair": self.choose(HAIR),
            }
            varied.append(person | own | looks | self.movement(person, enter_s, delay_s))
        return varied

    def clothes(self) -> Table:
        """Shirt and trousers."""
        main, second = self.rng.choice(SHIRTS, 2, replace=False).tolist()
        shirt = {"texture": self.choose(TEXTURES), "colour": main, "colour2": second}
        shirt |= {"scale_m": self.near(0.085, 0.035), "contrast": self.near(0.27, 0.07)}
        trousers = {"colour": self.choose(TROUSERS), "scale_m": 0.05, "contrast": self.near(0.22, 0.07)}
        return {"shirt": shirt, "trousers": trousers}

    def movement(self, person: Table, enter_s: float, delay_s: float) -> Table:
        """The steps of a person."""
        movement: Table = {
            "enter_s": max(0.0, enter_s * self.pace + delay_s),
            "start_m": self.floor.point(person["start_m"]),
            "face_deg": self.floor.heading_deg(person.get("face_deg", 0.0)),
            "steps": [self.step(step) for step in person.get("steps", ())],
        }
        if "wander" in person:
            movement["wander"] = self.wander(person["wander"])
        return movement

    def step(self, step: Table) -> Table:
        """A step at its place, in its time."""
        varied: Table = {}
        for key, value in step.items():
            if key == "go":
                varied[key] = [self.floor.point(point) for point in value]
            elif key == "face_deg":
                varied[key] = self.floor.heading_deg(value)
            elif key.endswith("_s"):
                varied[key] = value * self.pace
            else:
                varied[key] = value
        if "go" in step:
            varied["speed_mps"] = step.get("speed_mps", 1.2) * self.floor.stretch / self.pace
        return varied

    def wander(self, wander: Table) -> Table:
        """Random walks, which the seed of the member draws."""
        x_min, y_min, x_max, y_max = wander["area_m"]
        corners = np.array([self.floor.point((x_min, y_min)), self.floor.point((x_max, y_max))])
        varied = wander | {"area_m": [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()]}
        if "exit_m" in wander:
            varied["exit_m"] = [self.floor.point(point) for point in wander["exit_m"]]
        if "until_s" in wander:
            varied["until_s"] = wander["until_s"] * self.pace
        return varied

    def mount(self, mount: Table) -> Table:
        """Another camera, or another pair, which looks nearly there."""
        x_m, y_m, z_m = self.floor.point(mount["at_m"])
        varied = mount | {
            "at_m": [self.near(x_m, 0.2), y_m, min(self.near(z_m, 0.1), self.ceiling_m - 0.1)],
            "heading_deg": self.floor.heading_deg(mount.get("heading_deg", 90.0)) + self.near(0.0, 6.0),
            "tilt_deg": max(0.0, self.near(mount.get("tilt_deg", 55.0), 2.0)),
            "focal_px": self.times(mount.get("focal_px", 480.0), 0.95, 1.06),
        }
        if "baseline_m" in mount:
            k1 = -0.12 * float(self.rng.uniform(0.3, 1.2))
            p1, p2 = self.rng.uniform(-5e-4, 5e-4, 2).tolist()
            varied |= {
                "roll_deg": self.near(0.0, 1.5),
                "baseline_m": self.times(mount["baseline_m"], 0.93, 1.08),
                "right_rotation_deg": self.rng.uniform(-0.3, 0.3, 3).tolist(),
                "centre_offset_px": self.rng.uniform(-4.0, 4.0, 2).tolist(),
                "distortion": [k1, -0.25 * k1, p1, p2, 0.0],
            }
        return varied


def draw_member(table: Mapping[str, Any], seed: int, name: str) -> Variation:
    """The member of a committed scene that a seed draws; a seed gives others under every name. Raises WorkError: in all
    attempts people walk through each other."""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), attempt])
        member = Variation(table, rng)
        if keep_apart(scenes_of(member)[0]):
            return member
    raise WorkError(f"{name}, seed {seed}: people walk through each other in each of {ATTEMPTS} attempts")


def scenes_of(member: Variation) -> list[Scene]:
    """The scene of a member, as each of its sensors records it."""
    if "mount" in member.table:
        return [sensor.scene for sensor in rig_scenes(member)]
    return [Scene.model_validate(member.table)]


def rig_scenes(member: Variation) -> tuple[RigScene, ...]:
    """The sensors of a member."""
    return rigs_of(member.table, "a member of a scene")


def draw_scene(table: Mapping[str, Any], seed: int, name: str) -> Scene:
    """The member that a seed draws, as a scene (see ``draw_member``)."""
    return scenes_of(draw_member(table, seed, name))[0]


def keep_apart(scene: Scene) -> bool:
    """No two people walk through each other; those who wander give way by themselves."""
    furniture = {item.name: item for item in scene.furniture if item.name}
    times_s = np.arange(0.0, scene.duration_s, 0.1)
    places = []
    for person in scene.people:
        if person.wander is None:
            places.append(scripted_motion(person, furniture, scene.duration_s).places(times_s))
    for first, second in itertools.combinations(places, 2):
        if (np.linalg.norm(first - second, axis=1) < APART_M).any():
            return False
    return True
