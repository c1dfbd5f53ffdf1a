"""Base of every parameter table, and what is said of values that a table refuses."""

from collections.abc import Callable

from pydantic import BaseModel, ConfigDict, ValidationError

Location = tuple[int | str, ...]
"""Keys and list positions that lead to a value."""


class Params(BaseModel):
    """Frozen, unknown keys refused, values checked; each field's docstring gives meaning, unit and source."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


def dotted(location: Location) -> str:
    """``maps.cell_m`` for ("maps", "cell_m")."""
    return ".".join(map(str, location))


def first_problem(error: ValidationError, name: Callable[[Location], str] = dotted) -> str:
    """The first problem that pydantic found, in words that end an ``InputError``'s sentence.

    Args:
        error: as raised by a model's validation.
        name: how a value is called in the sentence.
    """
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
