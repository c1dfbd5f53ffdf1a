"""Base of every parameter table, and the messages for values that it refuses.

A number in this project whose comment names no source is our choice; the comment has the reason.
"""

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

LARGEST = {"_m": 1e4, "_m2": 1e4, "_s": 1e6, "_px": 1e6, "_deg": 3600.0, "_mps": 100.0, "_mps2": 1e4}
"""Largest magnitude by the unit in a parameter's name: beyond the reach of any camera, a recording of ten days, an
image, a person; turns add up to some rounds. A field's own range comes first."""
SMALLEST = 1e-9
"""Smallest magnitude of a number that is not 0: less is lost in float32 in any sum."""

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


def dotted_name(location: Location) -> str:
    """``maps.cell_m`` for ("maps", "cell_m")."""
    return ".".join(map(str, location))


def first_problem(error: ValidationError, name: Callable[[Location], str] = dotted_name) -> str:
    """The first problem that pydantic found, in words that end an ``InputError``'s sentence, in which a value is called
    as ``name`` gives it."""
    first = error.errors()[0]
    where = name(first["loc"])
    if first["type"] == "extra_forbidden":
        return f"unknown name {where}"
    if first["type"] == "missing":
        return f"expected {where}, found none"
    if first["type"] == "value_error":
        problem = str(first["ctx"]["error"])
    else:
        problem = f"{first['msg'].removeprefix('Input ')}, found {first['input']!r:.80}"
        problem = problem[:1].lower() + problem[1:]
    return f"{where}: {problem}" if where else problem


class Described(NamedTuple):
    """A parameter in words: its default ("" where it is required), range of values, and what it means."""

    name: str
    default: str
    range: str
    meaning: str

    @property
    def sentence(self) -> str:
        """Its meaning in a sentence, without the reason of its default."""
        first = re.split(r"(?<=[.)\]])\s+(?=[A-Z])|;\s|(?<=\]):\s", self.meaning, maxsplit=1)[0]
        return re.sub(r"\s*\(our choice[^()]*\)", "", first).rstrip(".")


def tables_of(table: type[Params], name: str = "") -> Iterator[tuple[str, type[Params]]]:
    """The table and all that are inside of it, with their names in a file."""
    yield name, table
    for field, info in table.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, Params):
            yield from tables_of(info.annotation, f"{name}.{field}".lstrip("."))


def descriptions(table: type[Params], values: Params | None = None) -> list[Described]:
    """The parameters of a table in words, without those of tables inside of it; ``values`` gives the defaults where the
    table is part of another."""
    meanings = _field_docs(table)
    found = []
    for name, info in table.model_fields.items():
        if not (isinstance(info.annotation, type) and issubclass(info.annotation, Params)):
            default = _default(info) if values is None else _shown(getattr(values, name))
            found.append(Described(name, default, _range(info), " ".join(meanings.get(name, "").split())))
    return found


def _field_docs(table: type[BaseModel]) -> dict[str, str]:
    """The docstring beneath each field of a table, from its source.

    pydantic could collect them when a class is made (``use_attribute_docstrings``); reading the source of fifty tables
    takes half a second of every start.
    """
    found = {}
    for base in reversed([c for c in table.__mro__ if c is not BaseModel and issubclass(c, BaseModel)]):
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body  # type: ignore[attr-defined]
        for field, text in itertools.pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[ast.unparse(field.target)] = inspect.cleandoc(str(text.value.value))
    return found


def _default(info: Any) -> str:
    return "" if info.is_required() else _shown(info.get_default(call_default_factory=True))


def _shown(value: object) -> str:
    if isinstance(value, float):
        value = round(value, 6)
    return value if isinstance(value, str) and value else repr(value)


_BOUNDS = {"gt": "above {}", "ge": "from {}", "lt": "below {}", "le": "to {}"}


def _range(info: Any) -> str:
    choices = getattr(info.annotation, "__args__", ())
    if "Literal" in str(info.annotation) and choices:
        return ", ".join(c for c in choices if isinstance(c, str))
    found = [_BOUNDS[key].format(f"{getattr(m, key):g}") for m in info.metadata for key in _BOUNDS if hasattr(m, key)]
    return " ".join(found)
