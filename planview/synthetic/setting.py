"""What a scene's room and furniture are made of."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from calib.params import Params

Pair = tuple[float, float]
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
    """How a surface looks."""

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
    """Where a piece of furniture is at a time; linear between moves."""

    t_s: float = Field(ge=0)
    at_m: Pair
    heading_deg: float | None = None


class Swivel(Params):
    """A chair that turns to and fro about its column."""

    from_s: float = Field(0.0, ge=0)
    until_s: float = Field(1e6, gt=0)
    amplitude_deg: float = Field(60.0, gt=0, le=360)
    period_s: float = Field(4.0, gt=0.5)


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
    swivel: Swivel | None = None
