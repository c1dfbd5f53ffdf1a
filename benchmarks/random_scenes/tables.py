"""Tables of random scenes after their ranges are replaced by numbers, before people are placed.

``{ min = 2.1, max = 3.2 }`` is a number of that range (a whole one between whole bounds), ``{ choose = [1, 2] }``
one of the list; everything else is taken as it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from calib.params import Params
from planview.synthetic.scene import Pair, Scene
from planview.synthetic.write import RigScene

Phenomenon = Literal[
    "occlusion by people", "occlusion by static objects", "close interaction of two", "close interaction of three",
    "rolling chairs", "objects put down and taken", "large dark shadows", "heads above partitions",
    "sitting on chairs", "sitting on the floor", "unusual postures", "standing still",
    "eight or more people", "leaving and returning", "similar clothes", "pairs in step", "children",
    "camera straight down", "camera nearly horizontal", "320x240", "640x480", "10 frames per second",
    "30 frames per second", "short baseline", "long baseline", "narrow lens", "wide lens", "automatic exposure",
]  # fmt: skip
"""What a scene may be hard for. Up to "unusual postures": Harville 2002, section 5; the rest is ours."""

Plot = Literal[
    "cross", "meet", "stand", "pair", "return", "wander", "postures",
    "sit", "floor", "chair", "bag", "book", "partition",
]  # fmt: skip


def resolved(value: Any, rng: np.random.Generator) -> Any:
    """A table with a number for each range and one entry for each choice."""
    if isinstance(value, Mapping):
        if set(value) == {"min", "max"}:
            low, high = value["min"], value["max"]
            whole = isinstance(low, int) and isinstance(high, int)
            return int(rng.integers(low, high + 1)) if whole else float(rng.uniform(low, high))
        if set(value) == {"choose"}:
            return resolved(value["choose"][int(rng.integers(len(value["choose"])))], rng)
        return {key: resolved(value[key], rng) for key in value}
    return [resolved(item, rng) for item in value] if isinstance(value, list) else value


class NoPlaceError(Exception):
    """The random room, camera and people do not fit; another attempt may."""


@dataclass(frozen=True)
class RandomScene:
    """A scene of a seed, and what is to be counted in it.

    Attributes:
        zone_m: corners of a zone on the floor in the camera's frame, of a conference room.
        rigs: the stereo rigs in the room; empty where the scene's own camera is the only one.
    """

    scene: Scene
    zone_m: tuple[Pair, ...] = ()
    rigs: tuple[RigScene, ...] = ()


class LightTable(Params):
    """Light and exposure."""

    lamps: int = Field(2, ge=0, le=3)
    ambient: float = Field(0.45, ge=0.02, le=3)
    sun: bool = False
    """A low, strong sun that throws long dark shadows through the room."""
    changes: int = Field(0, ge=0, le=6)
    """How many times a lamp is dimmed for a while, at once or slowly."""
    automatic_exposure: bool = False
    """Whether the exposure follows the light with a delay; constant otherwise."""
    brightness: float | None = Field(None, gt=0.005, le=0.8)
    """Mean linear level of the empty room: from dark to glaring; random, 0.2 to 0.3, when absent."""
    full_well_e: float | None = Field(None, ge=150)
    """Electrons at full scale, of which few make noise; random, 6,000 to 16,000, when absent."""
    blur_px: float = Field(0.55, ge=0, le=3)


class Choreography(Params):
    """Several people doing something together."""

    kind: Plot
    """cross: walk through the view and back, each in a lane of its own. meet: come together, move around each other,
    part. stand: stand and fidget. pair: walk shoulder to shoulder in step. return: leave the view and come back.
    wander: random walks. postures: crouch, bend, reach. sit, floor: take a seat. chair: roll a
    chair to another place. bag, book: put one down (a book on a shelf), and take it. partition: walk behind screens."""
    people: int = Field(1, ge=1, le=12)
    start_s: float = Field(0.5, ge=0)
    """When the first person sets out from outside the room [s]."""
    every_s: float = Field(2.2, ge=0.5, le=30)
    """Time between the people's setting out [s]."""
    duration_s: float = Field(10.0, gt=0, le=600)
    """How long the middle part takes: the meeting, the standing, the sitting [s]."""
    speed_mps: float = Field(1.1, ge=0.4, le=6.0)
    spacing_m: float = Field(0.55, ge=0.42, le=1.5)
    """Distance between the body axes of people who meet or walk as a pair [m]."""
    joiners: int = Field(0, ge=0, le=2)
    """How many of those who meet come later and go earlier than the others."""
    away_s: Pair = (1.0, 6.0)
    """Shortest and longest time out of view before coming back [s]."""
    turns: int = Field(0, ge=0, le=10)
    """Most turns at an end of the lane, in view, of people who cross or walk as a pair before they go out; each walk
    has one at least. 0: they walk straight through."""

    @property
    def end_s(self) -> float:
        return self.start_s + self.duration_s

    def begin_s(self, k: int) -> float:
        """When the k-th person sets out [s]."""
        return self.start_s + k * self.every_s


class ChallengeRoom(Params):
    """A room with an opening in each side wall; the camera hangs on the wall at y = 0 or below the ceiling."""

    width_m: float = Field(6.5, ge=4, le=12)
    depth_m: float = Field(6.0, ge=4, le=12)
    height_m: float = Field(2.9, ge=2.4, le=6)


class ChallengeCamera(Params):
    """The stereo pair."""

    width: int = 320
    height: int = 240
    lens_deg: float = Field(67.0, ge=40, le=110)
    """Horizontal field of view [deg]."""
    baseline_m: float = Field(0.12, ge=0.05, le=0.3)
    height_m: float = Field(2.2, ge=1.2, le=5)
    tilt_deg: float = Field(66.0, ge=0, le=89)
    """Angle of the optical axis from straight down; below 20 the camera is above the middle of the room."""
    roll_deg: float = Field(0.0, ge=-5, le=5)
    grey: bool = False

    @property
    def focal_px(self) -> float:
        return self.width / 2 / math.tan(math.radians(self.lens_deg) / 2)


class Challenge(Params):
    """A stereo scene of the challenge suite (``data/synthetic/suite``)."""

    description: str
    covers: tuple[Phenomenon, ...] = Field(min_length=1)
    """The phenomena that every seed of the scene contains."""
    fps: float = Field(15.0, ge=5, le=60)
    duration_s: float = Field(30.0, ge=5, le=600)
    room: ChallengeRoom = ChallengeRoom()
    camera: ChallengeCamera = ChallengeCamera()
    light: LightTable = LightTable()
    people_m: Pair = (1.52, 1.95)
    """Shortest and tallest grown-up [m]."""
    children: int = Field(0, ge=0, le=6)
    """How many of the people are children of 1.0 to 1.2 m."""
    clothes: Literal["different", "similar"] = "different"
    """similar: all wear the same shirt and trousers."""
    choreography: tuple[Choreography, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _camera_in_room(self) -> Challenge:
        if self.camera.height_m > self.room.height_m - 0.1:
            raise ValueError("expected the camera at least 0.1 m below the ceiling")
        return self
