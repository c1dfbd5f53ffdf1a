"""A scene as a TOML file: what people do step by step, room, furniture, people, lights and cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from calib.errors import InputError
from calib.ground_camera import LENS_K_320
from calib.io import parse_toml, read_text
from calib.params import Params, first_problem

Pair = tuple[float, float]
STEP_KEYS = ("go", "stand_s", "until_s", "sit_s", "reach_s", "bend_s", "crouch_s")
"""The keys of a step in TOML, of which it has exactly one."""


class Walk(Params):
    """Walk through points."""

    go: tuple[Pair, ...]
    """Points [m]."""
    speed_mps: float = Field(1.2, gt=0.1, le=6)
    face_deg: float | None = None
    """Direction to face, as who walks backwards or sideways does; along the way when absent."""
    push: str | None = None
    """Furniture pushed while walking (it stays where the walk ends)."""
    carry: str | None = None
    """Furniture carried while walking."""
    put_z_m: float = Field(0.0, ge=0, le=2)
    """Height at which a carried thing is put down after the walk [m]."""


class OnSpot(Params):
    """Something done on the spot."""

    face_deg: float | None = None
    """Direction to face."""


class Stand(OnSpot):
    stand_s: float = Field(gt=0)


class StandUntil(OnSpot):
    until_s: float = Field(ge=0)
    """Stand until this time of the recording [s]."""


class Sit(OnSpot):
    sit_s: float = Field(gt=0)
    """Duration [s]."""
    on: str | None = None
    """Chair to sit on; sits on the floor when absent."""


class Reach(OnSpot):
    reach_s: float = Field(gt=0)


class Bend(OnSpot):
    bend_s: float = Field(gt=0)


class Crouch(OnSpot):
    crouch_s: float = Field(gt=0)


def _action(step: Any) -> str | None:
    """The action of a step, or of its table; None where that has none or several."""
    names = [name for name in STEP_KEYS if name in (step if isinstance(step, dict) else type(step).model_fields)]
    return names[0] if len(names) == 1 else None


Step = Annotated[
    Annotated[Walk, Tag("go")]
    | Annotated[Stand, Tag("stand_s")]
    | Annotated[StandUntil, Tag("until_s")]
    | Annotated[Sit, Tag("sit_s")]
    | Annotated[Reach, Tag("reach_s")]
    | Annotated[Bend, Tag("bend_s")]
    | Annotated[Crouch, Tag("crouch_s")],
    Discriminator(
        _action,
        custom_error_type="step",
        custom_error_message=f"expected exactly one of {', '.join(STEP_KEYS)} in a step",
    ),
]
"""One thing a person does."""


Triple = tuple[float, float, float]
Keyframes = tuple[Pair, ...]
"""(time [s], value) pairs in order of time; linear between them, constant outside."""
Colour = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
Texture = Literal["plain", "tiles", "wood", "carpet", "concrete", "stripes", "checks", "print", "books", "poster"]
Wall = Literal["south", "north", "west", "east"]
FurnitureKind = Literal[
    "table", "chair", "office_chair", "partition", "box", "shelf", "plant", "sofa", "column", "bench", "door", "bag"
]


class Surface(Params):
    """Appearance of a surface."""

    texture: Texture = "plain"
    """Pattern, a function of coordinates fixed to the surface."""
    colour: Colour = "#b8b4ac"
    """Main sRGB colour."""
    colour2: Colour | None = None
    """Second colour of patterns; darker than the first when absent."""
    scale_m: float = Field(0.3, gt=0.002, le=10)
    """Size of the pattern: tile, plank, stripe or blotch [m]."""
    contrast: float = Field(0.15, ge=0, le=1)
    """Strength of the irregular variation on top of the pattern."""
    gloss: float = Field(0.0, ge=0, le=0.6)
    """Share of mirrored light (floors only)."""


class Opening(Params):
    """A door opening in a wall, with a piece of corridor behind it."""

    wall: Wall
    from_m: float = Field(ge=0)
    """Distance of its near edge from the wall's lower corner (smaller x or y) [m]."""
    width_m: float = Field(1.0, gt=0.3, le=10)
    height_m: float = Field(2.1, gt=1, le=6)


class Panel(Params):
    """A flat rectangle on a wall: a poster, a board or a window."""

    kind: Literal["poster", "window", "board"] = "poster"
    wall: Wall
    from_m: float = Field(ge=0)
    bottom_m: float = Field(1.0, ge=0)
    width_m: float = Field(0.8, gt=0)
    height_m: float = Field(1.1, gt=0)
    surface: Surface = Surface(texture="poster", colour="#d8c8a0", colour2="#305070", scale_m=0.2)


class Room(Params):
    """A rectangular room: x from 0 to size[0], y from 0 to size[1], floor at z = 0."""

    size_m: Triple = (6.0, 5.0, 3.0)
    floor: Surface = Surface(texture="tiles", colour="#a8a090", scale_m=0.4)
    walls: Surface = Surface(colour="#d8d4c8", scale_m=0.8, contrast=0.05)
    ceiling: Surface = Surface(colour="#e8e8e4", contrast=0.03)
    openings: tuple[Opening, ...] = ()
    panels: tuple[Panel, ...] = ()

    @model_validator(mode="after")
    def _plausible(self) -> Room:
        if not all(1.0 <= s <= 80.0 for s in self.size_m):
            raise ValueError(f"expected a room of 1 to 80 m, found {self.size_m}")
        return self


class Move(Params):
    """Place of a piece of furniture at a time; linear between moves."""

    t_s: float = Field(ge=0)
    at_m: Pair
    heading_deg: float | None = None


class Furniture(Params):
    """A thing in the room."""

    kind: FurnitureKind
    name: str = ""
    at_m: Pair
    z_m: float = Field(0.0, ge=0, le=5)
    """Height of its base above the floor [m] (a box on a table)."""
    heading_deg: float = 0.0
    """Direction its front faces: 0 along +x, 90 along +y."""
    size_m: Triple | None = None
    """Length (along its front), depth and height; the kind's own when absent."""
    surface: Surface | None = None
    moves: tuple[Move, ...] = ()


class Wander(Params):
    """Random walks between places with pauses, avoiding people and furniture."""

    area_m: tuple[float, float, float, float]
    """x_min, y_min, x_max, y_max of the floor to walk on [m]."""
    speed_mps: Pair = (0.7, 1.3)
    pause_s: Pair = (0.0, 2.0)
    until_s: float | None = None
    """When the person leaves towards ``exit_m``; stays to the end when absent."""
    exit_m: tuple[Pair, ...] = ()


class ScenePerson(Params):
    """A person. Ids count from 1 in the order of the file."""

    height_m: float = Field(1.72, ge=0.9, le=2.2)
    """Top of the head above the floor, standing, hair and shoes included [m]."""
    build: float = Field(1.0, ge=0.7, le=1.5)
    """Width of the body relative to an average one."""
    shirt: Surface = Surface(colour="#4a6a9a", scale_m=0.05, contrast=0.25)
    trousers: Surface = Surface(colour="#3a3a44", scale_m=0.05, contrast=0.2)
    skin: Colour = "#d0a080"
    hair: Colour = "#3a2a1c"
    hair_style: Literal["short", "long", "bald"] = "short"
    sleeves: Literal["long", "short"] = "long"
    skirt: bool = False
    enter_s: float = Field(0.0, ge=0)
    """When the person comes to be, at ``start_m`` (choose a place out of view) [s]."""
    start_m: Pair
    face_deg: float = 0.0
    steps: tuple[Step, ...] = ()
    wander: Wander | None = None
    leaves: bool = False
    """True for a person who is gone after the last step."""

    @property
    def things(self) -> set[str]:
        """Names of the furniture that the person carries or pushes."""
        return {name for step in self.steps if isinstance(step, Walk) for name in (step.push, step.carry) if name}

    @property
    def seats(self) -> list[str]:
        """Names of the chairs that the person sits on, in order."""
        return [step.on for step in self.steps if isinstance(step, Sit) and step.on]


class Light(Params):
    """A lamp or the sun."""

    kind: Literal["point", "sun"] = "point"
    at_m: Triple | None = None
    """Place of a point light, room frame [m]."""
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
    def _check_place(self) -> Light:
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


class ImageSensor(Params):
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
    """Effects of a cheap camera on its frames."""

    shutter_s: float = Field(0.0, ge=0, le=0.2)
    """Time over which a frame is exposed [s]: motion blur."""
    auto_exposure: float = Field(0.0, ge=0, le=1)
    """Share of a change of the frame's mean level that the camera takes back; each frame by itself."""
    auto_white_balance: float = Field(0.0, ge=0, le=1)
    """Share of the frame's mean colour that the camera takes back."""
    jpeg_quality: int = Field(0, ge=0, le=100)
    """Quality of compression; 0 for none."""


class Mount(Params):
    """Pose of the (left) camera in the room."""

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
    sensor: ImageSensor = ImageSensor()
    lights: Lights = Lights()
    capture: Capture | None = None
    furniture: tuple[Furniture, ...] = ()
    people: tuple[ScenePerson, ...] = Field((), max_length=60)

    @model_validator(mode="after")
    def _consistent(self) -> Scene:
        if (self.rig is None) == (self.camera is None):
            raise ValueError("expected either a [rig] or a [camera]")
        names = [f.name for f in self.furniture if f.name]
        if len(set(names)) != len(names):
            raise ValueError("expected every furniture name once")
        for i, person in enumerate(self.people):
            if unknown := (person.things | {*person.seats}) - {*names}:
                raise ValueError(f"person {i + 1} uses furniture {min(unknown)!r}, known are {sorted(names)}")
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
    """Read a scene. Raises InputError: unreadable, not TOML, an unknown key or a value out of range."""
    return parse_scene(read_text(path, "a scene in TOML"), str(path))


def parse_scene(text: str, source: str) -> Scene:
    """A scene from its TOML text; ``source`` names it in messages (same errors as ``load_scene``)."""
    try:
        return Scene.model_validate(parse_toml(text))
    except ValidationError as error:
        raise InputError(f"{source}: {first_problem(error)}") from error
    except ValueError as error:
        raise InputError(f"{source}: expected a scene in TOML, found {error}") from error
