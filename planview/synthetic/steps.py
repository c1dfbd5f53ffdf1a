"""What a person of a scene does, one step after the other."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag

from calib.params import Params

Pair = tuple[float, float]
ACTIONS = ("go", "stand_s", "until_s", "sit_s", "reach_s", "bend_s", "crouch_s", "cartwheel")
"""The keys of a step in TOML, of which it has exactly one."""


class Walk(Params):
    """Walk through points."""

    go: tuple[Pair, ...]
    """Points [m]."""
    speed_mps: float = Field(1.2, gt=0.1, le=2.5)
    push: str | None = None
    """Furniture pushed while walking (it stays where the walk ends)."""
    carry: str | None = None
    """Furniture carried while walking."""
    put_z_m: float = Field(0.0, ge=0, le=2)
    """Height at which a carried thing is put down after the walk [m]."""


class Cartwheel(Params):
    """Turn a cartwheel to the left."""

    cartwheel: Pair
    """Its end [m]."""


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
    """How long [s]."""
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
    names = [name for name in ACTIONS if name in (step if isinstance(step, dict) else type(step).model_fields)]
    return names[0] if len(names) == 1 else None


Step = Annotated[
    Annotated[Walk, Tag("go")]
    | Annotated[Stand, Tag("stand_s")]
    | Annotated[StandUntil, Tag("until_s")]
    | Annotated[Sit, Tag("sit_s")]
    | Annotated[Reach, Tag("reach_s")]
    | Annotated[Bend, Tag("bend_s")]
    | Annotated[Crouch, Tag("crouch_s")]
    | Annotated[Cartwheel, Tag("cartwheel")],
    Discriminator(
        _action,
        custom_error_type="step",
        custom_error_message=f"expected exactly one of {', '.join(ACTIONS)} in a step",
    ),
]
"""One thing a person does."""
