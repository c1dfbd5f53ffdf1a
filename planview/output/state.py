"""Named values (``calib.carried``) as JSON and arrays, and back.

Every value becomes itself (None, bool, int, float, str) or a reference ``{"#": n}`` to a node ``[kind, content, ...]``
of a list, so that shared objects and cycles stay so. No code is taken from a file: classes are found by name among
those of the project, instances are made without calling anything of theirs, and attributes are set.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from calib.types import AnyArray

PACKAGES = frozenset({"calib", "stereo", "planview"})
PLAIN = (type(None), bool, int, float, str)
_GROUPS: dict[str, type[Any]] = {"list": list, "set": set, "deque": deque, "tuple": tuple, "frozenset": frozenset}


class SavedState(NamedTuple):
    """A graph of objects: encoded values by name, what references refer to, and arrays."""

    roots: dict[str, Any]
    nodes: list[list[Any]]
    arrays: list[AnyArray]


def encode(roots: Mapping[str, object]) -> SavedState:
    """Encode objects and everything that they refer to. Raises TypeError: something of a class that is not the
    project's, with the place where it was found."""
    encoder = _Encoder()
    encoder.saved.roots.update({name: encoder.save(root, name) for name, root in roots.items()})
    return encoder.saved


class _Encoder:
    """Walks a graph once. Functions that call each other by closure would keep the whole state as a cycle."""

    def __init__(self) -> None:
        self.saved = SavedState({}, [], [])
        self._numbers: dict[int, int] = {}
        self._alive: list[object] = []  # as long as their ids are in use

    def save(self, value: Any, path: str) -> Any:
        """A plain value, or a reference to the node of anything else."""
        if type(value) in PLAIN:
            return value
        if id(value) not in self._numbers:
            number = self._numbers[id(value)] = len(self.saved.nodes)
            self._alive.append(value)
            self.saved.nodes.append([])
            self.saved.nodes[number] = self._node(value, path)
        return {"#": self._numbers[id(value)]}

    def _save_all(self, values: Iterable[Any], path: str) -> list[Any]:
        return [self.save(value, f"{path}[{n}]") for n, value in enumerate(values)]

    def _node(self, value: Any, path: str) -> list[Any]:
        cls = type(value)
        if cls is dict:
            return ["dict", [self._save_all(pair, path) for pair in value.items()]]
        if cls in _GROUPS.values():
            return [cls.__name__, self._save_all(value, path), getattr(value, "maxlen", None)]
        if (cls is np.ndarray or isinstance(value, np.generic)) and not value.dtype.hasobject:
            self.saved.arrays.append(np.array(value))
            return ["array" if cls is np.ndarray else "scalar", len(self.saved.arrays) - 1]
        if cls is np.random.Generator:
            return ["generator", self.save(dict(value.bit_generator.state), path)]
        if not _is_ours(cls):
            raise TypeError(f"{path} is of class {cls.__module__}.{cls.__qualname__}, which a checkpoint cannot hold")
        if isinstance(value, tuple):
            return ["record", self._save_all(value, path), _name_of(cls)]
        attributes = dict(getattr(value, "__dict__", {}))
        attributes |= {name: getattr(value, name) for name in getattr(cls, "__slots__", ())}
        return ["object", {n: self.save(held, f"{path}.{n}") for n, held in attributes.items()}, _name_of(cls)]


def decode(state: SavedState) -> dict[str, Any]:
    """The values that ``encode`` took, by name, made by the same code. Raises ValueError: a class that is not the
    project's."""
    decoder = _Decoder(state)
    return {name: decoder.restore(value) for name, value in state.roots.items()}


class _Decoder:
    """Makes every object of a graph once."""

    def __init__(self, state: SavedState) -> None:
        self._state = state
        self._made: dict[int, Any] = {}

    def restore(self, value: Any) -> Any:
        """A plain value, or what a reference refers to."""
        if type(value) in PLAIN:
            return value
        if value["#"] not in self._made:
            self._make(value["#"])
        return self._made[value["#"]]

    def _restore_all(self, values: list[Any]) -> list[Any]:
        return [self.restore(value) for value in values]

    def _make(self, number: int) -> None:
        kind, content, *more = self._state.nodes[number]
        made, arrays = self._made, self._state.arrays
        new: Any
        if kind in ("dict", "list", "set", "deque"):  # these may hold themselves: made first, filled then
            new = {} if kind == "dict" else deque(maxlen=more[0]) if kind == "deque" else _GROUPS[kind]()
            made[number] = new
            held = map(self._restore_all, content) if kind == "dict" else self._restore_all(content)
            (new.update if kind in ("dict", "set") else new.extend)(held)
        elif kind == "object":
            made[number] = new = object.__new__(_class_of(more[0]))
            for name, value in content.items():  # also of frozen classes
                object.__setattr__(new, name, self.restore(value))
        elif kind in _GROUPS:
            made[number] = _GROUPS[kind](self._restore_all(content))
        elif kind == "record":
            made[number] = tuple.__new__(_class_of(more[0]), self._restore_all(content))
        elif kind in ("array", "scalar"):
            made[number] = arrays[content] if kind == "array" else arrays[content][()]
        else:
            made[number] = generator = np.random.default_rng()
            generator.bit_generator.state = self.restore(content)


def _named(name: str) -> Any:
    """The object called "module:qualified name" in a loaded module of the project; None for all others."""
    module, _, path = name.partition(":")
    found: Any = sys.modules.get(module) if module.partition(".")[0] in PACKAGES else None
    for part in path.split("."):
        found = getattr(found, part, None)
    return found


def _name_of(cls: type[Any]) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _is_ours(cls: type[Any]) -> bool:
    """Whether a class, found by its name, is of the project."""
    return _named(_name_of(cls)) is cls


def _class_of(name: str) -> Any:
    """A class from a file, found among those that are loaded; nothing is imported for it."""
    found = _named(name)
    if not isinstance(found, type) or not _is_ours(found):
        raise ValueError(f"expected a class of planview, found {name!r}")
    return found
