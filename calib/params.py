"""Base of every parameter table, and the messages for values that it refuses."""

from collections.abc import Callable
from typing import Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

LARGEST = {"_m": 1e4, "_m2": 1e4, "_s": 1e6, "_px": 1e6, "_deg": 3600.0, "_mps": 100.0, "_mps2": 1e4}
"""Largest magnitude by the unit in a parameter's name: beyond the reach of any camera, a recording of ten days, an
image, a person; turns add up to some rounds. A field's own range comes first."""
SMALLEST = 1e-9
"""Smallest magnitude of a number that is not 0: less is lost in float32 in any sum (our choice)."""

Location = tuple[int | str, ...]
"""Keys and list positions that lead to a value."""


class Params(BaseModel):
    """Frozen, unknown keys refused, values checked; each field's docstring gives meaning, unit and source."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="after")
    def _within_reason(self) -> Self:
        """Refuse numbers beyond what their unit can mean, where a field has no narrower range of its own."""
        for name, value in self:
            if isinstance(value, float) and value:
                largest = next((most for unit, most in LARGEST.items() if name.endswith(unit)), 1e12)
                if not SMALLEST <= abs(value) <= largest:
                    raise ValueError(f"expected {name} of 0 or from {SMALLEST:g} to {largest:g}, found {value:g}")
        return self


def dotted(location: Location) -> str:
    """``maps.cell_m`` for ("maps", "cell_m")."""
    return ".".join(map(str, location))


def first_problem(error: ValidationError, name: Callable[[Location], str] = dotted) -> str:
    """The first problem that pydantic found, in words that end an ``InputError``'s sentence, in which a value is called
    as ``name`` gives it."""
    first = error.errors()[0]
    where = name(first["loc"])
    if first["type"] == "extra_forbidden":
        return f"expected only known names, found {where}"
    if first["type"] == "missing":
        return f"expected {where}, found none"
    if first["type"] == "value_error":
        problem = str(first["ctx"]["error"])
    else:
        problem = f"{first['msg'][:1].lower()}{first['msg'][1:]}, found {first['input']!r:.80}"
    return f"{where}: {problem}" if where else problem
