"""The state of an engine as plain values (JSON) and arrays, and back.

Every value becomes itself (None, bool, int, float, str) or a reference ``{"#": n}`` to a node ``[kind, content, ...]``
of a list, so that shared objects and cycles stay so. No code is taken from a file: classes are found by name among
those of the project, instances are made without calling anything of theirs, and attributes are set. Threads come from
the object in whose place the restored one goes.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Generic, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel

from calib.types import AnyArray

PACKAGES = frozenset({"calib", "stereo", "planview"})
PLAIN = (type(None), bool, int, float, str)
BIT_GENERATORS = ("PCG64", "PCG64DXSM", "Philox", "SFC64", "MT19937")
_OPEN: dict[str, type[Any]] = {"list": list, "set": set, "dict": dict, "deque": deque}
"""What may hold itself: made first, filled then."""


class SavedState(NamedTuple):
    """A graph of objects: encoded values by name, what references refer to, and arrays."""

    roots: dict[str, Any]
    nodes: list[list[Any]]
    arrays: list[AnyArray]


def encode(roots: Mapping[str, object]) -> SavedState:
    """Encode objects and everything that they refer to.

    Raises:
        TypeError: something of a class that is not the project's, with the place where it was found.
    """
    writer = _Writer()
    values = {name: writer.value(root, name) for name, root in roots.items()}
    return SavedState(values, writer.nodes, writer.arrays)


def decode(state: SavedState, present: Mapping[str, object]) -> dict[str, Any]:
    """Restore a graph.

    Args:
        state: from ``encode``.
        present: new objects of the same names. One of a class of ours stays itself and gets the restored attributes,
            so that all that refers to it resumes.
    Returns:
        The restored values by name.
    Raises:
        ValueError: nodes that ``encode`` does not write, a class that is not the project's, or another class than the
            present object's.
    """
    reader = _Reader(state)
    try:
        for name, root in present.items():
            if _is_ours(type(root)) and not isinstance(root, tuple):
                reader.fill(int(state.roots[name]["#"]), root, name)
        return {name: reader.value(value, present.get(name)) for name, value in state.roots.items()}
    except (KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"expected the state of a run, found {type(error).__name__}: {error}") from error


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
    """Whether instances of a class are their attributes, or a named tuple, and no more."""
    bases = (object, Generic, Protocol, BaseModel, *([tuple] if hasattr(cls, "_fields") else []))
    return cls not in bases and all(base in bases or _named(_name_of(base)) is base for base in cls.__mro__)


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
        if cls is deque:
            return ["deque", self._all(value, path), value.maxlen]
        if cls in (list, tuple, set, frozenset):
            return [cls.__name__, self._all(value, path)]
        if cls is ThreadPoolExecutor:
            return ["threads", None]
        if (cls is np.ndarray or isinstance(value, np.generic)) and not value.dtype.hasobject:
            array = np.asarray(value)
            axes = np.argsort(array.strides, kind="stable")[::-1]  # as they lie in memory
            self.arrays.append(np.array(array.transpose(axes), order="C"))
            return ["array" if cls is np.ndarray else "scalar", len(self.arrays) - 1, np.argsort(axes).tolist()]
        if isinstance(value, np.random.Generator) and type(value.bit_generator).__name__ in BIT_GENERATORS:
            bits = value.bit_generator
            return ["generator", self.value(dict(bits.state), path), type(bits).__name__]
        if not _is_ours(cls):
            raise TypeError(f"{path} is of class {cls.__module__}.{cls.__qualname__}, which a checkpoint cannot hold")
        if isinstance(value, tuple):
            return ["record", self._all(value, path), _name_of(cls)]
        attributes = dict(getattr(value, "__dict__", {}))
        attributes |= {name: getattr(value, name) for name in _slots_of(cls) if hasattr(value, name)}
        return ["object", {n: self.value(held, f"{path}.{n}") for n, held in attributes.items()}, _name_of(cls)]

    def _all(self, values: Any, path: str) -> list[Any]:
        return [self.value(value, f"{path}[{n}]") for n, value in enumerate(values)]


def _slots_of(cls: type[Any]) -> set[str]:
    """Names of the attributes that instances of a class hold outside of a dictionary."""
    slots = [base.__dict__.get("__slots__", ()) for base in cls.__mro__]
    names = {name for of_base in slots for name in ([of_base] if isinstance(of_base, str) else of_base)}
    return names - {"__dict__", "__weakref__"}


class _Reader:
    def __init__(self, state: SavedState) -> None:
        self._state = state
        self._made: dict[int, Any] = {}

    def fill(self, number: int, present: object, name: str) -> None:
        """Make the restored object of a node in place of the present one."""
        kind, attributes, class_name = self._state.nodes[number]
        if kind != "object" or class_name != _name_of(type(present)):
            raise ValueError(f"expected the state of {_name_of(type(present))} for {name}, found another")
        self._made[number] = present
        for extra in set(getattr(present, "__dict__", ())) - attributes.keys():
            object.__delattr__(present, extra)
        self._set(present, attributes, present)

    def value(self, value: Any, present: Any = None) -> Any:
        """The value of a plain value or reference; ``present`` is what is in its place now."""
        if type(value) in PLAIN:
            return value
        number = int(value["#"])
        if number in self._made:
            return self._made[number]
        kind, content, *more = self._state.nodes[number]
        made: Any
        if kind in _OPEN:
            self._made[number] = made = _OPEN[kind](**({"maxlen": more[0]} if kind == "deque" else {}))
            held = (self._all(pair) for pair in content) if kind == "dict" else self._all(content)
            (made.update if kind in ("dict", "set") else made.extend)(held)
        elif kind == "object":
            self._made[number] = made = object.__new__(self._class(more[0], is_tuple=False))
            self._set(made, content, present)
        else:
            self._made[number] = made = self._closed(kind, content, more, present)
        return made

    def _closed(self, kind: str, content: Any, more: list[Any], present: Any) -> Any:
        """A value that is made of others."""
        if kind in ("tuple", "frozenset"):
            return (tuple if kind == "tuple" else frozenset)(self._all(content))
        if kind in ("array", "scalar"):
            array = self._state.arrays[content].transpose(more[0])
            return array if kind == "array" else array[()]
        if kind == "record":
            return tuple.__new__(self._class(more[0], is_tuple=True), self._all(content))
        if kind == "generator" and more[0] in BIT_GENERATORS:
            bits = getattr(np.random, more[0])()
            bits.state = self.value(content)
            return np.random.Generator(bits)
        if kind == "threads" and isinstance(present, ThreadPoolExecutor):
            return present
        raise ValueError(f"expected the state of a run, found {kind!r}")

    def _all(self, values: list[Any]) -> list[Any]:
        return [self.value(value) for value in values]

    def _set(self, made: object, attributes: dict[str, Any], present: object) -> None:
        """Set all attributes, also of frozen classes."""
        for name, value in attributes.items():
            object.__setattr__(made, name, self.value(value, getattr(present, name, None)))

    @staticmethod
    def _class(name: str, *, is_tuple: bool) -> Any:
        """A class from a file, found among those that are loaded; nothing is imported for it."""
        found = _named(name)
        if not isinstance(found, type) or not _is_ours(found) or issubclass(found, tuple) != is_tuple:
            raise ValueError(f"expected a class of planview, found {name!r}")
        return found
