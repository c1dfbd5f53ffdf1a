"""The state of an engine as plain values (JSON) and arrays, and back.

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
    writer = _Writer()
    values = {name: writer.value(root, name) for name, root in roots.items()}
    return SavedState(values, writer.nodes, writer.arrays)


def decode(state: SavedState, present: Mapping[str, object]) -> dict[str, Any]:
    """Restore a graph.

    Args:
        state: from ``encode``, by the same code.
        present: new objects of the same names. One of a class of ours stays itself and gets the restored attributes,
            so that all that refers to it resumes.
    Returns:
        The restored values by name.
    Raises:
        ValueError: a class that is not the project's, or another one than the present object's.
    """
    reader = _Reader(state)
    for name, root in present.items():
        if _is_ours(type(root)):
            reader.fill(state.roots[name]["#"], root)
    return {name: reader.value(value) for name, value in state.roots.items()}


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


class _Writer:
    def __init__(self) -> None:
        self.nodes: list[list[Any]] = []
        self.arrays: list[AnyArray] = []
        self._numbers: dict[int, int] = {}
        self._alive: list[object] = []  # as long as their ids are in use

    def value(self, value: Any, path: str) -> Any:
        """A plain value, or a reference to the node of anything else."""
        if type(value) in PLAIN:
            return value
        number = self._numbers.get(id(value))
        if number is None:
            number = self._numbers[id(value)] = len(self.nodes)
            self.nodes.append([])
            self._alive.append(value)
            self.nodes[number] = self._node(value, path)
        return {"#": number}

    def _node(self, value: Any, path: str) -> list[Any]:
        cls = type(value)
        if cls is dict:
            return ["dict", [self._all(pair, path) for pair in value.items()]]
        if cls in _GROUPS.values():
            return [cls.__name__, self._all(value, path), getattr(value, "maxlen", None)]
        if (cls is np.ndarray or isinstance(value, np.generic)) and not value.dtype.hasobject:
            self.arrays.append(np.array(value))
            return ["array" if cls is np.ndarray else "scalar", len(self.arrays) - 1]
        if cls is np.random.Generator:
            return ["generator", self.value(dict(value.bit_generator.state), path)]
        if not _is_ours(cls):
            raise TypeError(f"{path} is of class {cls.__module__}.{cls.__qualname__}, which a checkpoint cannot hold")
        if isinstance(value, tuple):
            return ["record", self._all(value, path), _name_of(cls)]
        attributes = dict(getattr(value, "__dict__", {}))
        attributes |= {name: getattr(value, name) for name in getattr(cls, "__slots__", ())}
        return ["object", {n: self.value(held, f"{path}.{n}") for n, held in attributes.items()}, _name_of(cls)]

    def _all(self, values: Iterable[Any], path: str) -> list[Any]:
        return [self.value(value, f"{path}[{n}]") for n, value in enumerate(values)]


class _Reader:
    def __init__(self, state: SavedState) -> None:
        self._state = state
        self._made: dict[int, Any] = {}

    def fill(self, number: int, present: object) -> None:
        """Make the restored object of a node in place of the present one."""
        _, attributes, class_name = self._state.nodes[number]
        if class_name != _name_of(type(present)):
            raise ValueError(f"expected the state of {_name_of(type(present))}, found that of {class_name}")
        self._made[number] = present
        for extra in set(getattr(present, "__dict__", ())) - attributes.keys():
            object.__delattr__(present, extra)
        self._set(present, attributes)

    def value(self, value: Any) -> Any:
        """The value of a plain value or reference."""
        if type(value) in PLAIN:
            return value
        if value["#"] not in self._made:
            self._make(value["#"])
        return self._made[value["#"]]

    def _make(self, number: int) -> None:
        kind, content, *more = self._state.nodes[number]
        made: Any
        if kind in ("dict", "list", "set", "deque"):  # these may hold themselves: made first, filled then
            made = {} if kind == "dict" else deque(maxlen=more[0]) if kind == "deque" else _GROUPS[kind]()
            self._made[number] = made
            held = map(self._all, content) if kind == "dict" else self._all(content)
            (made.update if kind in ("dict", "set") else made.extend)(held)
        elif kind == "object":
            self._made[number] = made = object.__new__(_class_of(more[0]))
            self._set(made, content)
        elif kind in _GROUPS:
            self._made[number] = _GROUPS[kind](self._all(content))
        elif kind == "record":
            self._made[number] = tuple.__new__(_class_of(more[0]), self._all(content))
        elif kind in ("array", "scalar"):
            array = self._state.arrays[content]
            self._made[number] = array if kind == "array" else array[()]
        else:
            self._made[number] = generator = np.random.default_rng()
            generator.bit_generator.state = self.value(content)

    def _all(self, values: list[Any]) -> list[Any]:
        return [self.value(value) for value in values]

    def _set(self, made: object, attributes: dict[str, Any]) -> None:
        """Set all attributes, also of frozen classes."""
        for name, value in attributes.items():
            object.__setattr__(made, name, self.value(value))


def _class_of(name: str) -> Any:
    """A class from a file, found among those that are loaded; nothing is imported for it."""
    found = _named(name)
    if not isinstance(found, type) or not _is_ours(found):
        raise ValueError(f"expected a class of planview, found {name!r}")
    return found
