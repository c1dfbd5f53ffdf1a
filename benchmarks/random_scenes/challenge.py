"""A scene of the challenge suite before a seed decides where and when, and how its people and lamps look."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from calib.params import Params
from planview.synthetic.scene import Pair

Phenomenon = Literal[
    "occlusion by people", "occlusion by static objects", "close interaction of two", "close interaction of three",
    "rolling chairs", "objects put down and taken", "large dark shadows", "heads above partitions",
    "sitting on chairs", "sitting on the floor", "cartwheel", "unusual postures", "standing still",
    "eight or more people", "leaving and returning", "similar clothes", "pairs in step", "children",
    "camera straight down", "camera nearly horizontal", "320x240", "640x480", "10 frames per second",
    "30 frames per second", "short baseline", "long baseline", "narrow lens", "wide lens", "automatic exposure",
]  # fmt: skip
"""What a scene may be hard for. Up to "unusual postures": Harville 2002, section 5; the rest is our choice."""

Kind = Literal[
    "cross", "meet", "stand", "pair", "return", "wander", "cartwheel", "postures",
    "sit", "floor", "chair", "bag", "book", "partition",
]  # fmt: skip


class Choreography(Params):
    """Several people doing something together."""

    kind: Kind
    """cross: walk through the view and back, each in a lane of its own. meet: come together, move around each other,
    part. stand: stand and fidget. pair: walk shoulder to shoulder in step. return: leave the view and come back.
    wander: random walks. cartwheel, postures: turn a wheel; crouch, bend, reach. sit, floor: take a seat. chair: roll a
    chair to another place. bag, book: put one down (a book on a shelf), and take it. partition: walk behind screens."""
    people: int = Field(1, ge=1, le=12)
    start_s: float = Field(0.5, ge=0)
    """When the first person sets out from outside the room [s]."""
    every_s: float = Field(2.2, ge=0.5, le=30)
    """Time between the people's setting out [s]."""
    duration_s: float = Field(10.0, gt=0, le=600)
    """How long the middle part takes: the meeting, the standing, the sitting [s]."""
    speed_mps: float = Field(1.1, ge=0.4, le=1.6)
    spacing_m: float = Field(0.55, ge=0.42, le=1.5)
    """Distance between the body axes of people who meet or walk as a pair [m]."""
    joiners: int = Field(0, ge=0, le=2)
    """How many of those who meet come later and go earlier than the others."""
    away_s: Pair = (1.0, 6.0)
    """Shortest and longest time out of view before coming back [s]."""
    turns: int = Field(0, ge=0, le=10)
    """Most turns at an end of the lane, in view, of people who cross or walk as a pair before they go out; each walk
    has one at least. 0: they walk straight through."""


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


class ChallengeLight(Params):
    """Light and exposure."""

    lamps: int = Field(2, ge=1, le=3)
    ambient: float = Field(0.45, ge=0.05, le=2)
    sun: bool = False
    """A low, strong sun that throws long dark shadows through the room."""
    changes: int = Field(0, ge=0, le=6)
    """How many times a lamp is dimmed, switched or switched back."""
    automatic_exposure: bool = False
    """Whether the exposure follows the light with a delay; constant otherwise."""


class Challenge(Params):
    """A scene with every range resolved, but no person placed yet."""

    description: str
    covers: tuple[Phenomenon, ...] = Field(min_length=1)
    """The phenomena that every seed of the scene contains."""
    fps: float = Field(15.0, ge=5, le=60)
    duration_s: float = Field(30.0, ge=5, le=600)
    room: ChallengeRoom = ChallengeRoom()
    camera: ChallengeCamera = ChallengeCamera()
    light: ChallengeLight = ChallengeLight()
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


_SHIRTS = ("#3a5a8a", "#b04838", "#3c6a4a", "#c8b8a0", "#24282c", "#d9a441", "#c05878", "#e0e0d8", "#6a4a8a", "#3878a0",
           "#8a5a3c", "#a8b4c0")  # fmt: skip
_TROUSERS = ("#2f3e58", "#3a3a44", "#55504a", "#6a5a44", "#24242a", "#46586e", "#8a7a60", "#403848")
_SKIN = ("#d0a080", "#e0b898", "#b98560", "#8a5a3c", "#6a4430")
_HAIR = ("#1c1a18", "#3a2a1c", "#6b4423", "#b08848", "#787470", "#c8c4bc")
_TEXTURES = ("plain", "plain", "stripes", "checks", "print")
EXPOSURE_DELAY_S = 0.7
"""Time constant with which an automatic exposure follows the light. Our choice: webcams take 0.5 to 1 s."""


def clothes(rng: np.random.Generator) -> dict[str, Any]:
    """Shirt and trousers of a person."""
    main, second = (str(c) for c in rng.choice(_SHIRTS, 2, replace=False))
    shirt: dict[str, Any] = {"texture": str(rng.choice(_TEXTURES)), "colour": main, "colour2": second}
    shirt |= {"scale_m": float(rng.uniform(0.05, 0.12)), "contrast": float(rng.uniform(0.2, 0.35))}
    trousers = {"colour": str(rng.choice(_TROUSERS)), "scale_m": 0.05, "contrast": float(rng.uniform(0.15, 0.3))}
    return {"shirt": shirt, "trousers": trousers, "skirt": bool(rng.random() < 0.15)}


def looks(rng: np.random.Generator, height_m: float) -> dict[str, Any]:
    """All of a person but clothes and movement."""
    style = str(rng.choice(("short", "short", "long", "bald"))) if height_m > 1.3 else "short"
    return {
        "height_m": float(height_m),
        "build": float(rng.uniform(0.88, 1.2)),
        "skin": str(rng.choice(_SKIN)),
        "hair": str(rng.choice(_HAIR)),
        "hair_style": style,
        "sleeves": str(rng.choice(("long", "short"))),
    }


def random_light(challenge: Challenge, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """The scene's lights and sensor, as tables."""
    light = challenge.light
    room, lamps = challenge.room, []
    for k in range(light.lamps):
        x = room.width_m * (k + 0.5) / light.lamps + rng.uniform(-0.4, 0.4)
        at_m = (x, room.depth_m * rng.uniform(0.35, 0.75), room.height_m - 0.1)
        # One lamp throws the shadows that show; those of the others cost as much time and are filled by the first.
        lamps.append({"at_m": at_m, "level": float(rng.uniform(0.35, 0.6)), "shadows": k == 0})
    lights: dict[str, Any] = {"ambient": light.ambient, "lamps": lamps}
    if light.sun:
        lights["ambient"] = min(light.ambient, 0.3)
        side = float(rng.choice((-1.0, 1.0)))
        towards = (side * rng.uniform(0.5, 1.0), rng.uniform(-0.2, 0.5), -rng.uniform(0.45, 0.8))
        lamps.append({"kind": "sun", "towards": towards, "level": float(rng.uniform(0.6, 1.0)), "softness_deg": 0.6})
    for _ in range(light.changes):  # a lamp is dimmed for a while, at once or slowly
        lamp = lamps[int(rng.integers(len(lamps)))]
        start = float(rng.uniform(0.15, 0.75) * challenge.duration_s)
        ramp, stay, level = float(rng.choice((0.07, 0.5, 2.0))), float(rng.uniform(3, 8)), float(rng.uniform(0.15, 0.6))
        on_again = start + ramp + stay
        lamp.setdefault("dim", ((start, 1.0), (start + ramp, level), (on_again, level), (start + 2 * ramp + stay, 1.0)))
    sensor: dict[str, Any] = {
        "brightness": float(rng.uniform(0.2, 0.3)),
        "full_well_e": float(rng.uniform(6000, 16000)),
        "vignetting": float(rng.uniform(0.1, 0.3)),
        "mismatch": float(rng.uniform(0.0, 0.03)),
        "grey": challenge.camera.grey,
    }
    if light.automatic_exposure:
        sensor["exposure"] = automatic_exposure(lights, challenge.duration_s)
    return lights, sensor


def automatic_exposure(lights: dict[str, Any], duration_s: float) -> tuple[tuple[float, float], ...]:
    """Keyframes of the exposure that holds the room's mean level, following it with EXPOSURE_DELAY_S.

    The mean level is taken to be that of the ambient light and the lamps' levels together.
    """
    times = np.arange(0.0, duration_s, 0.1)
    total = np.full(len(times), float(lights["ambient"]))
    for lamp in lights["lamps"]:
        dim = np.array(lamp.get("dim", ((0.0, 1.0),)))
        total += lamp["level"] * np.interp(times, dim[:, 0], dim[:, 1])
    wanted, exposure = total[0] / total, np.ones(len(times))
    for k in range(1, len(times)):
        exposure[k] = exposure[k - 1] + 0.1 / EXPOSURE_DELAY_S * (wanted[k] - exposure[k - 1])
    return tuple((float(t), float(e)) for t, e in zip(times, exposure, strict=True))
