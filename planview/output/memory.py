"""The memory of an engine as plain values (JSON) and blocks of bytes, and back.

Every value becomes itself (None, bool, int, float, str) or a reference ``{"#": n}`` to a node ``[kind, content, ...]``
of a list. Objects that are shared, and cycles, stay so. Arrays keep their strides, and arrays that share memory keep
sharing it: results of numpy may depend on either. No code is taken from a file: classes are found by name among those
of the project, instances are made without calling anything of theirs, and attributes are set. Machinery (threads)
comes from the object in whose place the restored one goes.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Generic, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel

from calib.types import U8, AnyArray

PACKAGES = frozenset({"calib", "stereo", "planview"})
KEPT = (ThreadPoolExecutor,)
"""Machinery without memory of frames: a resumed run keeps its own."""
PLAIN = (type(None), bool, int, float, str)
BIT_GENERATORS = ("PCG64", "PCG64DXSM", "Philox", "SFC64", "MT19937")
_OPEN: dict[str, type[Any]] = {"list": list, "set": set, "dict": dict, "deque": deque}
"""What may hold itself: made first, filled then."""


class Encoded(NamedTuple):
    """A graph as plain values and memory.

    Attributes:
        roots: encoded values by name.
        nodes: what references refer to.
        blocks: (n,) uint8 each; arrays lie in them.
    """

    roots: dict[str, Any]
    nodes: list[list[Any]]
    blocks: list[U8]


def _named(name: str) -> Any:
    """What is called "module:qualified name" in a loaded module of the project; None for all else."""
    module, _, path = name.partition(":")
    found: Any = sys.modules.get(module) if module.partition(".")[0] in PACKAGES else None
    for part in path.split("."):
        found = getattr(found, part, None)
    return found


def _name_of(cls: type[Any]) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _kind_of(cls: type[Any]) -> str:
    """The kind of node for instances of a class; empty where a checkpoint cannot hold them.

    Named tuples of ours, and objects that are their attributes and no more.
    """
    if _named(_name_of(cls)) is not cls:
        return ""
    if issubclass(cls, tuple):
        return "record" if hasattr(cls, "_fields") else ""
    others = (object, Generic, Protocol, BaseModel)
    return "object" if all(base in others or _named(_name_of(base)) is base for base in cls.__mro__) else ""


def encode(roots: Mapping[str, object]) -> Encoded:
    """Encode objects and everything that they refer to.

    Raises:
        TypeError: something of a class that is not the project's, by where it was found.
    """
    encoder = _Encoder()
    values = {name: encoder.value(root, name) for name, root in roots.items()}
    return Encoded(values, encoder.nodes, encoder.blocks)


class _Encoder:
    def __init__(self) -> None:
        self.nodes: list[list[Any]] = []
        self.blocks: list[U8] = []
        self._known: dict[int, int] = {}
        self._owners: dict[int, int] = {}
        self._alive: list[object] = []  # as long as their ids are in use

    def value(self, value: Any, path: str) -> Any:
        """A plain value, or a reference to the node of anything else."""
        if type(value) in PLAIN:
            return value
        number = self._known.get(id(value))
        if number is None:
            number = self._known[id(value)] = len(self.nodes)
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
        if isinstance(value, KEPT):
            return ["kept", None]
        if (cls is np.ndarray or isinstance(value, np.generic)) and not value.dtype.hasobject:
            return ["array" if cls is np.ndarray else "scalar", self._array(np.asarray(value))]
        if isinstance(value, np.random.Generator) and type(value.bit_generator).__name__ in BIT_GENERATORS:
            bits = value.bit_generator
            return ["generator", self.value(dict(bits.state), path), type(bits).__name__]
        kind = _kind_of(cls)
        if kind == "record":
            return [kind, self._all(value, path), _name_of(cls)]
        if kind == "object":
            attributes = dict(getattr(value, "__dict__", {}))
            attributes |= {name: getattr(value, name) for name in _slots_of(cls) if hasattr(value, name)}
            content = {name: self.value(held, f"{path}.{name}") for name, held in attributes.items()}
            return [kind, content, _name_of(cls)]
        raise TypeError(f"{path} is of class {cls.__module__}.{cls.__qualname__}, which a checkpoint cannot hold")

    def _all(self, values: Any, path: str) -> list[Any]:
        return [self.value(value, f"{path}[{n}]") for n, value in enumerate(values)]

    def _array(self, array: AnyArray) -> list[Any]:
        """Kind, layout, and where it lies: in the block of the array that owns its memory."""
        owner = array
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        outer = owner.transpose(np.argsort(owner.strides, kind="stable")[::-1])
        if not outer.flags.c_contiguous:  # memory of another library, with gaps
            owner = outer = array = array.copy()
        if id(owner) not in self._owners:
            self._owners[id(owner)] = len(self.blocks)
            self._alive.append(owner)
            self.blocks.append(outer.flatten().view(np.uint8))
        offset = array.__array_interface__["data"][0] - owner.__array_interface__["data"][0]
        layout = [np.lib.format.dtype_to_descr(array.dtype), list(array.shape), list(array.strides)]
        return [*layout, bool(array.flags.writeable), self._owners[id(owner)], offset]


def _slots_of(cls: type[Any]) -> list[str]:
    """Names of the attributes that instances of a class hold outside of a dictionary."""
    names: list[str] = []
    for base in cls.__mro__:
        slots = base.__dict__.get("__slots__", ())
        names += [slots] if isinstance(slots, str) else list(slots)
    return [name for name in names if name not in ("__dict__", "__weakref__")]


def decode(encoded: Encoded, present: Mapping[str, object]) -> dict[str, Any]:
    """Restore a graph.

    Args:
        encoded: from ``encode``.
        present: objects of the same names, freshly made; one that is of a plain class of ours gets the attributes of
            the restored one and stays itself, so that who refers to it goes on with the restored memory.
    Returns:
        The restored values by name.
    Raises:
        ValueError: nodes that are no graph of ``encode``, a class that is not the project's, or another kind of object
            than the present one.
    """
    decoder = _Decoder(encoded)
    try:
        for name, root in present.items():
            if _kind_of(type(root)) == "object":
                decoder.fill(int(encoded.roots[name]["#"]), root, name)
        return {name: decoder.value(value, present.get(name)) for name, value in encoded.roots.items()}
    except (KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"expected the memory of a run, found {type(error).__name__}: {error}") from error


class _Decoder:
    def __init__(self, encoded: Encoded) -> None:
        self._encoded = encoded
        self._made: dict[int, Any] = {}

    def fill(self, number: int, present: object, name: str) -> None:
        """Make the restored object of a node in place of the present one."""
        kind, attributes, class_name = self._encoded.nodes[number]
        if kind != "object" or class_name != _name_of(type(present)):
            raise ValueError(f"expected the memory of {_name_of(type(present))} for {name}, found another")
        self._made[number] = present
        for extra in set(getattr(present, "__dict__", ())) - attributes.keys():
            object.__delattr__(present, extra)
        self._set(present, attributes, present)

    def value(self, value: Any, present: Any = None) -> Any:
        """The value of a plain value or reference; ``present`` is what holds its place now."""
        if type(value) in PLAIN:
            return value
        number = int(value["#"])
        if number in self._made:
            return self._made[number]
        kind, content, *more = self._encoded.nodes[number]
        made: Any
        if kind in _OPEN:
            self._made[number] = made = _OPEN[kind](**({"maxlen": more[0]} if kind == "deque" else {}))
            held = (self._all(pair) for pair in content) if kind == "dict" else self._all(content)
            (made.update if kind in ("dict", "set") else made.extend)(held)
        elif kind == "object":
            self._made[number] = made = object.__new__(self._class(more[0], kind))
            self._set(made, content, present)
        else:
            self._made[number] = made = self._closed(kind, content, more, present)
        return made

    def _closed(self, kind: str, content: Any, more: list[Any], present: Any) -> Any:
        """A value that is made of others."""
        if kind in ("tuple", "frozenset"):
            return (tuple if kind == "tuple" else frozenset)(self._all(content))
        if kind in ("array", "scalar"):
            array = self._array(*content)
            array.flags.writeable |= isinstance(present, np.ndarray) and present.flags.writeable
            return array if kind == "array" else array[()]
        if kind == "record":
            return tuple.__new__(self._class(more[0], kind), self._all(content))
        if kind == "generator" and more[0] in BIT_GENERATORS:
            bits = getattr(np.random, more[0])()
            bits.state = self.value(content)
            return np.random.Generator(bits)
        if kind == "kept" and isinstance(present, KEPT):
            return present
        raise ValueError(f"expected the memory of a run, found {kind!r}")

    def _all(self, values: list[Any]) -> list[Any]:
        return [self.value(value) for value in values]

    def _set(self, made: object, attributes: dict[str, Any], present: object) -> None:
        """Set all attributes, also of frozen classes."""
        for name, value in attributes.items():
            object.__setattr__(made, name, self.value(value, getattr(present, name, None)))

    @staticmethod
    def _class(name: str, kind: str) -> Any:
        """A class from a file, found among those that are loaded; nothing is imported for it."""
        found = _named(name)
        if not isinstance(found, type) or _kind_of(found) != kind:
            raise ValueError(f"expected a class of planview, found {name!r}")
        return found

    def _array(
        self, descr: Any, shape: list[int], strides: list[int], writeable: bool, block: int, offset: int
    ) -> AnyArray:
        """An array in its block: others share its memory as they did. numpy refuses what lies outside of the block."""
        if not isinstance(descr, str):  # JSON made lists of its tuples
            descr = [tuple(tuple(part) if isinstance(part, list) else part for part in field) for field in descr]
        kind = np.lib.format.descr_to_dtype(descr)
        if kind.hasobject:
            raise ValueError("expected numbers in an array, found objects")
        if math.prod(shape) * kind.itemsize > max(1, sum(len(part) for part in self._encoded.blocks)):
            raise ValueError(f"expected an array within the memory of the run, found one of shape {shape}")
        made: AnyArray = np.ndarray(tuple(shape), kind, self._encoded.blocks[block], offset, tuple(strides))
        made.flags.writeable = writeable
        return made
