"""Who is in a scene and what they do."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from calib.params import Params
from planview.synthetic.setting import Colour, Pair, Surface

_ACTIONS = ("go", "stand_s", "until_s", "sit_s", "reach_s", "bend_s", "crouch_s", "cartwheel")


class Step(Params):
    """One thing a person does; exactly one of the actions."""

    go: tuple[Pair, ...] | None = None
    """Walk through these points [m]."""
    speed_mps: float = Field(1.2, gt=0.1, le=2.5)
    stand_s: float | None = Field(None, gt=0)
    until_s: float | None = Field(None, ge=0)
    """Stand until this time of the recording [s]."""
    sit_s: float | None = Field(None, gt=0)
    on: str | None = None
    """Chair to sit on; sits on the floor when absent."""
    reach_s: float | None = Field(None, gt=0)
    bend_s: float | None = Field(None, gt=0)
    crouch_s: float | None = Field(None, gt=0)
    cartwheel: Pair | None = None
    """Turn a cartwheel to the left, to this point [m]."""
    face_deg: float | None = None
    """Direction to face while standing, sitting, reaching, bending or crouching."""
    push: str | None = None
    """Furniture pushed while walking (it stays where the walk ends)."""
    carry: str | None = None
    """Furniture carried while walking."""
    put_z_m: float = Field(0.0, ge=0, le=2)
    """Height at which a carried thing is put down after the walk [m]."""

    @model_validator(mode="after")
    def _one_action(self) -> Step:
        actions = [n for n in _ACTIONS if getattr(self, n) is not None]
        if len(actions) != 1:
            raise ValueError(
                f"expected exactly one of {', '.join(_ACTIONS)} in a step, found {', '.join(actions) or 'none'}"
            )
        if (self.push or self.carry) and not self.go:
            raise ValueError("expected push and carry together with go")
        return self


class Wander(Params):
    """Random walks between places with pauses, avoiding people and furniture."""

    area_m: tuple[float, float, float, float]
    """x_min, y_min, x_max, y_max of the floor to walk on [m]."""
    speed_mps: Pair = (0.7, 1.3)
    pause_s: Pair = (0.0, 2.0)
    until_s: float | None = None
    """When the person leaves towards ``exit_m``; stays to the end when absent."""
    exit_m: tuple[Pair, ...] = ()


class Person(Params):
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
    """Whether the person is gone after the last step."""
