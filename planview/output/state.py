"""Named values (``calib.carried``) as JSON and arrays, and back.

Numbers and texts become themselves, all else ``{kind: content}``; an object in two places is one again. No code is
taken from a file: classes are found by name among those of the project, instances are made without calling anything of
theirs, and attributes are set.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.types import AnyArray

PACKAGES = frozenset({"calib", "stereo", "planview"})
PLAIN = (type(None), bool, int, float, str)
_GROUPS: dict[str, type[Any]] = {"list": list, "set": set, "tuple": tuple, "frozenset": frozenset}


class SavedState(NamedTuple):
    """A value as JSON, in which numbers stand for the arrays that go with it."""

    document: Any
    arrays: list[AnyArray]


def encode(value: object) -> SavedState:
    """A value and all that it holds. Raises TypeError: something of a class that is not the project's, with the place
    where it was found."""
    arrays: list[AnyArray] = []
    return SavedState(_encoded(value, "", arrays, {}), arrays)


def _encoded(value: Any, path: str, arrays: list[AnyArray], known: dict[int, int]) -> Any:
    """``known``: numbers of the objects so far, by their id."""

    def every(values: Any) -> list[Any]:
        return [_encoded(held, f"{path}[{n}]", arrays, known) for n, held in enumerate(values)]

    def named(values: Mapping[Any, Any]) -> list[Any]:
        return [_encoded(held, f"{path}.{name}".strip("."), arrays, known) for name, held in values.items()]

    cls = type(value)
    if cls in PLAIN:
        return value
    if cls is dict:
        return {"dict": [every(value), named(value)]}
    if cls in _GROUPS.values():
        return {cls.__name__: every(value)}
    if cls is deque:
        return {"deque": [every(value), value.maxlen]}
    if (cls is np.ndarray or isinstance(value, np.generic)) and not value.dtype.hasobject:
        arrays.append(np.array(value))
        return {"array" if cls is np.ndarray else "scalar": len(arrays) - 1}
    if cls is np.random.Generator:
        return {"generator": _encoded(dict(value.bit_generator.state), path, arrays, known)}
    name = f"{cls.__module__}:{cls.__qualname__}"
    if _named(name) is not cls:
        raise TypeError(f"{path} is of class {cls.__module__}.{cls.__qualname__}, which a checkpoint cannot hold")
    if isinstance(value, tuple):
        return {"record": [name, every(value)]}
    if id(value) in known:
        return {"same": known[id(value)]}
    known[id(value)] = len(known)
    held = {slot: getattr(value, slot) for slot in getattr(cls, "__slots__", ()) if slot != "__dict__"}
    held |= getattr(value, "__dict__", {})
    return {"object": [name, dict(zip(held, named(held), strict=True))]}


def decode(state: SavedState) -> Any:
    """The value that ``encode`` took, made by the same code. Raises ValueError: a class that is not the project's."""
    return _decoded(state.document, state.arrays, [])


def _decoded(value: Any, arrays: Sequence[AnyArray], known: list[Any]) -> Any:
    """``known``: the objects so far."""

    def every(values: Sequence[Any]) -> list[Any]:
        return [_decoded(held, arrays, known) for held in values]

    if type(value) in PLAIN:
        return value
    ((kind, content),) = value.items()
    if kind in _GROUPS:
        return _GROUPS[kind](every(content))
    if kind in ("array", "scalar"):
        return arrays[content] if kind == "array" else arrays[content][()]
    if kind == "same":
        return known[content]
    if kind == "generator":
        generator = np.random.default_rng()
        generator.bit_generator.state = _decoded(content, arrays, known)
        return generator
    first, second = content
    if kind == "dict":
        return dict(zip(every(first), every(second), strict=True))
    if kind == "deque":
        return deque(every(first), second)
    if kind == "record":
        return tuple.__new__(_class_of(first), every(second))
    made = object.__new__(_class_of(first))
    known.append(made)
    for name, held in second.items():  # also of frozen classes
        object.__setattr__(made, name, _decoded(held, arrays, known))
    return made


def _named(name: str) -> Any:
    """The object called "module:qualified name" in a loaded module of the project; None for all others."""
    module, _, path = name.partition(":")
    found: Any = sys.modules.get(module) if module.partition(".")[0] in PACKAGES else None
    for part in path.split("."):
        found = getattr(found, part, None)
    return found


def _class_of(name: str) -> Any:
    """A class from a file, found among those that are loaded; nothing is imported for it."""
    found = _named(name)
    if not isinstance(found, type) or f"{found.__module__}:{found.__qualname__}" != name:
        raise ValueError(f"expected a class of planview, found {name!r}")
    return found
