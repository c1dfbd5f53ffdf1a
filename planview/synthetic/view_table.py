"""The tables of views of one camera, before a seed decides where and when (``views.draw_view``)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.params import Params
from planview.synthetic.scene import Capture
from planview.synthetic.setting import Pair


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
    """Share of people who walk beside the one before."""
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
    """A view with every range drawn, but no person placed yet."""

    description: str
    fps: float = Field(10.0, ge=5, le=30)
    duration_s: float = Field(30.0, ge=5, le=120)
    camera: ViewCamera
    walks: ViewWalks
    light: ViewLight = ViewLight()
    room: ViewRoom = ViewRoom()
    capture: Capture = Capture()
