"""A scene as a TOML file: room, furniture, people, lights and cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError, model_validator

from calib.errors import InputError
from calib.ground_camera import LENS_K_320
from calib.io import parse_toml, read_text
from calib.params import Params, first_problem
from planview.synthetic.persons import Person
from planview.synthetic.setting import Colour, Furniture, Keyframes, Pair, Room, Triple


class Light(Params):
    """A lamp or the sun."""

    kind: Literal["point", "sun"] = "point"
    at_m: Triple | None = None
    """Where a point light hangs, room frame [m]."""
    towards: Triple | None = None
    """Direction in which sunlight travels; it ignores walls and ceiling, unless it comes through a window."""
    window: int | None = None
    """Index of the panel through which the sun shines."""
    radius_m: float = Field(0.12, ge=0, le=1)
    """Radius of a point light [m], softens its shadows."""
    softness_deg: float = Field(1.0, ge=0, le=20)
    """Angular radius of the sun, softens its shadows."""
    level: float = Field(0.6, ge=0, le=100)
    """Irradiance at 2 m from a point light, or across sunlight; 1 lights white to full scale before auto exposure."""
    colour: Colour = "#fff4e4"
    dim: Keyframes = ((0.0, 1.0),)
    """Factor on the level over time: steps and ramps."""
    shadows: bool = True

    @model_validator(mode="after")
    def _placed(self) -> Light:
        if self.kind == "point" and self.at_m is None:
            raise ValueError("expected at_m for a point light, found none")
        if self.kind == "sun" and self.towards is None:
            raise ValueError("expected towards for the sun, found none")
        return self


class Lights(Params):
    """All light of the scene."""

    ambient: float = Field(0.45, ge=0, le=10)
    ambient_dim: Keyframes = ((0.0, 1.0),)
    lamps: tuple[Light, ...] = ()


class Sensor(Params):
    """From light to grey levels."""

    grey: bool = False
    brightness: float = Field(0.22, gt=0, le=0.8)
    """Mean linear level of the empty room in the first frame: the automatic exposure at the start."""
    exposure: Keyframes = ((0.0, 1.0),)
    """Factor on the exposure over time: steps of gain or shutter."""
    full_well_e: float = Field(8000.0, gt=100)
    """Electrons at full scale: shot noise is the square root of the signal."""
    read_noise_e: float = Field(12.0, ge=0)
    vignetting: float = Field(0.25, ge=0, le=0.9)
    """Loss of light in the corners."""
    blur_px: float = Field(0.55, ge=0, le=3)
    """Standard deviation of the lens's blur [px]; also what keeps edges band-limited."""
    mismatch: float = Field(0.02, ge=0, le=0.3)
    """Relative gain difference of the right camera."""


class Capture(Params):
    """What a cheap camera does to its frames."""

    shutter_s: float = Field(0.0, ge=0, le=0.2)
    """Time over which a frame is exposed [s]: motion blur."""
    auto_exposure: float = Field(0.0, ge=0, le=1)
    """How much of a change of the frame's mean level the camera takes back; each frame by itself."""
    auto_white_balance: float = Field(0.0, ge=0, le=1)
    """How much of the frame's mean colour the camera takes back."""
    jpeg_quality: int = Field(0, ge=0, le=100)
    """Of compression; 0 for none."""


class Mount(Params):
    """Where the (left) camera is in the room."""

    at_m: Triple
    """Camera centre, room frame [m]; z is its height above the floor."""
    heading_deg: float = 90.0
    """Direction of the view's horizontal part (for a camera straight down: where the top of its image points)."""
    tilt_deg: float = Field(55.0, ge=0, lt=100)
    """Angle of the optical axis from straight down."""
    roll_deg: float = Field(0.0, ge=-45, le=45)
    width: int = Field(640, ge=32, le=4096)
    height: int = Field(480, ge=32, le=4096)
    focal_px: float = Field(480.0, gt=10)


class Rig(Mount):
    """A stereo pair."""

    baseline_m: float = Field(0.12, gt=0.01, le=2)
    right_rotation_deg: Triple = (0.0, 0.0, 0.0)
    """Rotation vector of the right camera relative to the left [deg]."""
    right_offset_m: Pair = (0.0, 0.0)
    """Offset of the right camera along the left one's y and z axes [m]."""
    aspect: float = Field(1.0, ge=0.9, le=1.1)
    """fy / fx."""
    centre_offset_px: Pair = (0.0, 0.0)
    """Principal point from the middle of the image [px]; the right camera has the opposite."""
    distortion: tuple[float, ...] = ()
    """Brown k1 k2 p1 p2 k3 of the left camera; the right one's are 3 % smaller."""


class CameraMount(Mount):
    """One camera of the four-parameter model (calib.ground_camera): no roll, centred."""

    lens: str = "pinhole"

    @model_validator(mode="after")
    def _known(self) -> CameraMount:
        if self.lens not in LENS_K_320:
            raise ValueError(f"expected a lens of {', '.join(LENS_K_320)}, found {self.lens!r}")
        if self.roll_deg != 0 or self.tilt_deg >= 90:
            raise ValueError("expected a single camera without roll and tilted less than 90 degrees")
        return self


class Scene(Params):
    """Everything that decides the pixels of a recording."""

    description: str = ""
    seed: int = Field(1, ge=0)
    fps: float = Field(15.0, gt=0, le=120)
    duration_s: float = Field(10.0, gt=0, le=3600)
    room: Room = Room()
    rig: Rig | None = None
    camera: CameraMount | None = None
    sensor: Sensor = Sensor()
    lights: Lights = Lights()
    capture: Capture | None = None
    furniture: tuple[Furniture, ...] = ()
    people: tuple[Person, ...] = Field((), max_length=60)

    @model_validator(mode="after")
    def _consistent(self) -> Scene:
        if (self.rig is None) == (self.camera is None):
            raise ValueError("expected either a [rig] or a [camera]")
        names = [f.name for f in self.furniture if f.name]
        if len(set(names)) != len(names):
            raise ValueError("expected every furniture name once")
        for i, person in enumerate(self.people):
            for step in person.steps:
                for name in (step.on, step.push, step.carry):
                    if name is not None and name not in names:
                        raise ValueError(f"person {i + 1} uses furniture {name!r}, known are {sorted(names)}")
        for lamp in self.lights.lamps:
            if lamp.window is not None and not 0 <= lamp.window < len(self.room.panels):
                raise ValueError(f"expected a panel index for the window of a light, found {lamp.window}")
        return self

    @property
    def n_frames(self) -> int:
        return max(1, round(self.duration_s * self.fps))

    @property
    def mount(self) -> Rig | CameraMount:
        mount = self.rig or self.camera
        assert mount is not None  # the validator refuses a scene with neither
        return mount


def load_scene(path: Path) -> Scene:
    """Read a scene.

    Raises:
        InputError: unreadable, not TOML, an unknown key or a value out of range.
    """
    return parse_scene(read_text(path, "a scene in TOML"), str(path))


def parse_scene(text: str, source: str) -> Scene:
    """A scene from its TOML text; ``source`` names it in messages (same errors as ``load_scene``)."""
    try:
        return Scene.model_validate(parse_toml(text))
    except ValidationError as error:
        raise InputError(f"{source}: {first_problem(error)}") from error
    except ValueError as error:
        raise InputError(f"{source}: expected a scene in TOML, found {error}") from error
