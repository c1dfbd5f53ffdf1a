"""The memory of an engine as plain values (JSON) and blocks of bytes, and back.

Every value becomes itself (None, bool, int, float, str) or a reference ``{"#": n}`` to a node ``[kind, ...]`` of a
list. Objects that are shared, and cycles, stay so. Arrays keep their strides, and arrays that share memory keep sharing
it: results of numpy may depend on either. No code is taken from a file: classes are found by name among those of the
project, instances are made without calling anything of theirs, and attributes are set. Machinery (threads) comes from
the object in whose place the restored one goes.
"""

from __future__ import annotations

import ctypes
import math
import sys
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from enum import Enum
from pathlib import Path, PurePath
from types import FunctionType
from typing import Any, Generic, NamedTuple, Protocol

import numpy as np

from calib.params import Params
from calib.types import U8, AnyArray

PACKAGES = frozenset({"calib", "stereo", "planview"})
KEPT = (ThreadPoolExecutor,)
"""Machinery without memory of frames: a resumed run keeps its own."""
PLAIN = (type(None), bool, int, float, str)
BIT_GENERATORS = ("PCG64", "PCG64DXSM", "Philox", "SFC64", "MT19937")
_SEQUENCES: dict[type[Any], str] = {list: "list", tuple: "tuple", set: "set", frozenset: "frozenset"}


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


def name_of(what: Any) -> str:
    """A class or function of the project as "module:qualified name"."""
    return f"{what.__module__}:{what.__qualname__}"


def _named(module: str, path: str) -> Any:
    """What has a name in a loaded module of the project; None for all else."""
    found: Any = sys.modules.get(module) if module.partition(".")[0] in PACKAGES else None
    for part in path.split("."):
        found = getattr(found, part, None)
    return found


def _is_own(what: Any) -> bool:
    """Whether a class or function is the project's, and can be found again by its name."""
    found = _named(getattr(what, "__module__", None) or "", getattr(what, "__qualname__", ""))
    return found is not None and found is what


def _kind_of(cls: type[Any]) -> str:
    """The kind of node for instances of a class; empty where a checkpoint cannot hold them.

    Parameters (pydantic), named tuples and enumerations of ours, and objects that are their attributes and no more.
    """
    if not _is_own(cls):
        return ""
    if issubclass(cls, Enum):
        return "enum"
    if issubclass(cls, tuple):
        return "record" if hasattr(cls, "_fields") else ""
    if issubclass(cls, Params):
        return "params"
    return "object" if all(base in (object, Generic, Protocol) or _is_own(base) for base in cls.__mro__) else ""


def encode(roots: Mapping[str, object]) -> Encoded:
    """Encode objects and everything that they refer to.

    Raises:
        TypeError: something of a class that is not the project's, by where it was found.
    """
    encoder = _Encoder()
    values = {name: encoder.value(root, name) for name, root in roots.items()}
    return Encoded(values, encoder.nodes, encoder.place_arrays())


class _Encoder:
    def __init__(self) -> None:
        self.nodes: list[list[Any]] = []
        self._known: dict[int, int] = {}
        self._alive: list[object] = []  # as long as their ids are in use
        self._arrays: list[tuple[int, AnyArray]] = []

    def value(self, value: Any, path: str) -> Any:
        """A plain value, or a reference to the node of anything else."""
        if type(value) in PLAIN:
            return value
        number = self._known.get(id(value))
        if number is None:
            number = self._known[id(value)] = len(self.nodes)
            self.nodes.append([])
            self._alive.append(value)
            self.nodes[number] = self._node(value, path, number)
        return {"#": number}

    def _node(self, value: Any, path: str, number: int) -> list[Any]:
        cls = type(value)
        if cls in _SEQUENCES:
            return [_SEQUENCES[cls], self._all(value, path)]
        if cls is dict:
            return ["dict", [[self.value(k, path), self.value(held, path + "[]")] for k, held in value.items()]]
        if cls is deque:
            return ["deque", value.maxlen, self._all(value, path)]
        if cls is bytes:
            return ["bytes", value.hex()]
        if isinstance(value, PurePath):
            return ["path", str(value)]
        if isinstance(value, KEPT):
            return ["kept"]
        if (cls is np.ndarray or isinstance(value, np.generic)) and not value.dtype.hasobject:
            array = np.asarray(value)
            self._arrays.append((number, array))
            layout = [np.lib.format.dtype_to_descr(array.dtype), list(array.shape), list(array.strides)]
            return ["array" if cls is np.ndarray else "scalar", *layout, bool(array.flags.writeable)]
        if isinstance(value, np.random.Generator) and type(value.bit_generator).__name__ in BIT_GENERATORS:
            bits = value.bit_generator
            return ["generator", type(bits).__name__, self.value(dict(bits.state), path)]
        if isinstance(value, type) or isinstance(getattr(value, "py_func", value), FunctionType):
            if _is_own(value):
                return ["name", name_of(value)]
        elif kind := _kind_of(cls):
            if kind == "enum":
                return [kind, name_of(cls), value.name]
            if kind == "record":
                return [kind, name_of(cls), self._all(value, path)]
            attributes = dict(getattr(value, "__dict__", {}))
            for name in _slots_of(cls) if kind == "object" else ():
                if hasattr(value, name):
                    attributes[name] = getattr(value, name)
            return [kind, name_of(cls), {name: self.value(v, f"{path}.{name}") for name, v in attributes.items()}]
        raise TypeError(f"{path} is of class {cls.__module__}.{cls.__qualname__}, which a checkpoint cannot hold")

    def _all(self, values: Any, path: str) -> list[Any]:
        return [self.value(value, f"{path}[{n}]") for n, value in enumerate(values)]

    def place_arrays(self) -> list[U8]:
        """Copies of the memory that arrays lie in; to the arrays' nodes their block and offset are added.

        Blocks are in the order of the first of their arrays, wherever these lie: the same objects are encoded the same
        in every process.
        """
        spans = sorted((*_span(array), number, array) for number, array in self._arrays)
        blocks: list[tuple[int, int]] = []
        holders: list[list[tuple[int, int]]] = []
        for low, high, number, array in spans:
            if blocks and low < blocks[-1][1]:
                blocks[-1] = blocks[-1][0], max(high, blocks[-1][1])
            else:
                blocks.append((low, high))
                holders.append([])
            holders[-1].append((number, int(array.__array_interface__["data"][0]) - blocks[-1][0]))
        order = sorted(range(len(blocks)), key=lambda n: min(holders[n]))
        for place, n in enumerate(order):
            for number, offset in holders[n]:
                self.nodes[number] += [place, offset]
        spanned = [blocks[n] for n in order]
        return [np.frombuffer(ctypes.string_at(low, high - low), dtype=np.uint8).copy() for low, high in spanned]


def _span(array: AnyArray) -> tuple[int, int]:
    """First and last address + 1 of an array's items."""
    low = high = int(array.__array_interface__["data"][0])
    if array.size == 0:
        return low, low
    reaches = [(size - 1) * stride for size, stride in zip(array.shape, array.strides, strict=True)]
    return low + sum(min(reach, 0) for reach in reaches), high + sum(max(r, 0) for r in reaches) + array.itemsize


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
        kind, class_name, attributes = self._encoded.nodes[number]
        if kind != "object" or class_name != name_of(type(present)):
            raise ValueError(f"expected the memory of {name_of(type(present))} for {name}, found another")
        self._made[number] = present
        for extra in set(getattr(present, "__dict__", ())) - attributes.keys():
            object.__delattr__(present, extra)
        self._set(present, attributes, present)

    def value(self, value: Any, present: Any = None) -> Any:
        """The value of a plain value or reference; ``present`` is what holds its place now."""
        if type(value) in PLAIN:
            return value
        number = int(value["#"])
        if number not in self._made:
            kind, *fields = self._encoded.nodes[number]
            if kind in ("list", "dict", "set", "deque", "object", "params"):
                self._open(number, kind, fields, present)
            else:
                self._made[number] = self._closed(kind, fields, present)
        return self._made[number]

    def _open(self, number: int, kind: str, fields: list[Any], present: Any) -> None:
        """A value that may hold itself: made first, filled then."""
        made: Any
        if kind == "list":
            self._made[number] = made = []
            made.extend(self._all(fields[0]))
        elif kind == "dict":
            self._made[number] = made = {}
            made.update((self.value(key), self.value(held)) for key, held in fields[0])
        elif kind == "set":
            self._made[number] = made = set()
            made.update(self._all(fields[0]))
        elif kind == "deque":
            self._made[number] = made = deque(maxlen=fields[0])
            made.extend(self._all(fields[1]))
        else:
            cls = self._class(fields[0], kind)
            self._made[number] = made = cls.model_construct() if kind == "params" else object.__new__(cls)
            self._set(made, fields[1], present)

    def _closed(self, kind: str, fields: list[Any], present: Any) -> Any:
        """A value that is made of others."""
        if kind in ("tuple", "frozenset"):
            return (tuple if kind == "tuple" else frozenset)(self._all(fields[0]))
        if kind == "bytes":
            return bytes.fromhex(fields[0])
        if kind == "path":
            return Path(fields[0])
        if kind == "array":
            return self._array(*fields)
        if kind == "scalar":
            return self._array(*fields)[()]
        if kind == "record":
            return tuple.__new__(self._class(fields[0], kind), self._all(fields[1]))
        if kind == "enum":
            return self._class(fields[0], kind)[fields[1]]
        if kind == "name" and _is_own(found := _named(*fields[0].split(":"))):
            return found
        if kind == "generator" and fields[0] in BIT_GENERATORS:
            bits = getattr(np.random, fields[0])()
            bits.state = self.value(fields[1])
            return np.random.Generator(bits)
        if kind == "kept" and isinstance(present, KEPT):
            return present
        raise ValueError(f"expected the memory of a run, found {kind!r} of {fields[:1]}")

    def _all(self, values: list[Any]) -> list[Any]:
        return [self.value(value) for value in values]

    def _set(self, made: object, attributes: dict[str, Any], present: object) -> None:
        """Set all attributes, also of frozen classes."""
        for name, value in attributes.items():
            object.__setattr__(made, name, self.value(value, getattr(present, name, None)))

    @staticmethod
    def _class(name: str, kind: str) -> Any:
        """A class from a file, found among those that are loaded; nothing is imported for it."""
        found = _named(*name.split(":"))
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
