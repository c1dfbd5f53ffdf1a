"""The memory of an engine as plain values (JSON) and blocks of bytes, and back.

Every value becomes itself (None, bool, int, float, str) or a reference ``{"#": n}`` to a node ``[kind, ...]`` of a
list. Objects that are shared, and cycles, stay so. Arrays keep their strides, and arrays that share memory keep sharing
it: results of numpy may depend on either. No code is taken from a file: classes are found by name among those of the
project, instances are made without calling anything of theirs, and attributes are set. Machinery (threads) comes from
the object in whose place the restored one goes.
"""

from __future__ import annotations

import ctypes
import sys
from collections import deque
from collections.abc import Callable, Iterable, Mapping
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
_PLAIN_BASES = (object, Generic, Protocol)


def name_of(what: Any) -> str:
    """A class or function of the project as "module:qualified name"."""
    return f"{what.__module__}:{what.__qualname__}"


def is_own(what: Any) -> bool:
    """Whether a class or function is the project's, and can be found again by its name."""
    module = getattr(what, "__module__", None) or ""
    if module.partition(".")[0] not in PACKAGES:
        return False
    return _found(module, getattr(what, "__qualname__", "")) is what


def own(name: str) -> Any:
    """The class or function of a name from a file; nothing is imported for it.

    Raises:
        ValueError: no class or function of the project that is loaded.
    """
    module, _, path = name.partition(":")
    found = _found(module, path) if module.partition(".")[0] in PACKAGES else None
    if found is None or not is_own(found):
        raise ValueError(f"expected a class or function of planview, found {name!r}")
    return found


def own_class(name: str) -> type[Any]:
    """The plain class of a name from a file (same error as ``own``)."""
    found = own(name)
    if not isinstance(found, type):
        raise ValueError(f"expected a class of planview, found {name!r}")
    return found


def is_plain(kind: type[Any]) -> bool:
    """Whether the instances of a class of ours are their attributes and nothing else."""
    return is_own(kind) and all(base in _PLAIN_BASES or is_own(base) for base in kind.__mro__)


def is_params(kind: type[Any]) -> bool:
    """Whether a class holds parameters (pydantic)."""
    return is_own(kind) and issubclass(kind, Params)


def is_record(kind: type[Any]) -> bool:
    """Whether a class is a NamedTuple of ours."""
    return is_own(kind) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def is_enum(kind: type[Any]) -> bool:
    """Whether a class is an enumeration of ours."""
    return is_own(kind) and issubclass(kind, Enum)


def is_function(what: Any) -> bool:
    """Whether a value is a function of one of our modules, compiled by numba or not."""
    plain = getattr(what, "py_func", what)
    return isinstance(plain, FunctionType) and is_own(what)


def slots_of(kind: type[Any]) -> list[str]:
    """Names of the attributes that instances of a class hold outside of a dictionary."""
    names: list[str] = []
    for base in kind.__mro__:
        slots = base.__dict__.get("__slots__", ())
        names += [slots] if isinstance(slots, str) else list(slots)
    return [name for name in names if name not in ("__dict__", "__weakref__")]


def _found(module: str, path: str) -> Any:
    found: Any = sys.modules.get(module)
    for part in path.split("."):
        found = getattr(found, part, None)
    return found


PLAIN = (type(None), bool, int, float, str)
BIT_GENERATORS = ("PCG64", "PCG64DXSM", "Philox", "SFC64", "MT19937")


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
        self._alive: list[object] = []
        self._arrays: list[tuple[int, AnyArray]] = []

    def value(self, value: Any, path: str) -> Any:
        """A plain value, or a reference to the node of anything else."""
        if type(value) in PLAIN:
            return value
        number = self._known.get(id(value))
        if number is None:
            number = self._known[id(value)] = len(self.nodes)
            self.nodes.append([])
            # Whatever lives as long as its id is in use.
            self._alive.append(value)
            self.nodes[number] = self._node(value, path, number)
        return {"#": number}

    def _node(self, value: Any, path: str, number: int) -> list[Any]:
        if type(value) in _BUILT_IN:
            return _BUILT_IN[type(value)](self, value, path)
        if type(value) is np.ndarray:
            return self._array(value, path, number)
        if isinstance(value, np.generic):
            return self._scalar(np.array(value), path, number)
        if isinstance(value, PurePath):
            return ["path", str(value)]
        if isinstance(value, np.random.Generator):
            return self._generator(value, path)
        return self._own(value, path)

    def _own(self, value: Any, path: str) -> list[Any]:
        kind = type(value)
        if isinstance(value, KEPT):
            return ["kept"]
        if isinstance(value, type) or is_function(value):
            if is_own(value):
                return ["name", name_of(value)]
        elif is_enum(kind):
            return ["enum", name_of(kind), value.name]
        elif is_record(kind):
            return ["record", name_of(kind), self._all(value, path)]
        elif is_params(kind):
            return ["params", name_of(kind), self._attributes(vars(value), path)]
        elif is_plain(kind):
            return ["object", name_of(kind), self._attributes(_attributes_of(value), path)]
        raise TypeError(f"{path} is of class {kind.__module__}.{kind.__qualname__}, which a checkpoint cannot hold")

    def _attributes(self, attributes: Mapping[str, Any], path: str) -> dict[str, Any]:
        return {name: self.value(value, f"{path}.{name}") for name, value in attributes.items()}

    def _all(self, values: Iterable[Any], path: str) -> list[Any]:
        return [self.value(value, f"{path}[{n}]") for n, value in enumerate(values)]

    def _generator(self, value: np.random.Generator, path: str) -> list[Any]:
        bits = value.bit_generator
        if type(bits).__name__ not in BIT_GENERATORS:
            raise TypeError(f"{path} is a random generator that a checkpoint cannot hold")
        return ["generator", type(bits).__name__, self.value(dict(bits.state), path)]

    def _scalar(self, value: AnyArray, path: str, number: int) -> list[Any]:
        return ["scalar", *self._array(value, path, number)[1:]]

    def _array(self, value: AnyArray, path: str, number: int) -> list[Any]:
        if value.dtype.hasobject:
            raise TypeError(f"{path} is an array of objects, which a checkpoint cannot hold")
        self._arrays.append((number, value))
        self._alive.append(value)
        kind = np.lib.format.dtype_to_descr(value.dtype)
        return ["array", kind, list(value.shape), list(value.strides), bool(value.flags.writeable)]

    def place_arrays(self) -> list[U8]:
        """Copies of the memory that arrays lie in; to the arrays' nodes their block and offset are added.

        Blocks are in the order of the first of their arrays, wherever these lie: the same objects are encoded the same
        in every process.
        """
        spans = sorted((*_span(array), _address(array), number) for number, array in self._arrays)
        blocks: list[tuple[int, int]] = []
        holders: list[list[tuple[int, int]]] = []
        for low, high, address, number in spans:
            if blocks and low < blocks[-1][1]:
                blocks[-1] = blocks[-1][0], max(high, blocks[-1][1])
            else:
                blocks.append((low, high))
                holders.append([])
            holders[-1].append((number, address - blocks[-1][0]))
        order = sorted(range(len(blocks)), key=lambda n: min(holders[n]))
        for place, n in enumerate(order):
            for number, offset in holders[n]:
                self.nodes[number] += [place, offset]
        return [_memory(*blocks[n]) for n in order]


def _address(array: AnyArray) -> int:
    """Where an array's first item lies."""
    return int(array.__array_interface__["data"][0])


def _span(array: AnyArray) -> tuple[int, int]:
    """First and last address + 1 of an array's items."""
    low = high = _address(array)
    if array.size == 0:
        return low, low
    for size, stride in zip(array.shape, array.strides, strict=True):
        reach = (size - 1) * stride
        low, high = low + min(reach, 0), high + max(reach, 0)
    return low, high + array.itemsize


def _memory(low: int, high: int) -> U8:
    """The bytes between two addresses, all of one allocation: what arrays that overlap lie in."""
    return np.frombuffer(ctypes.string_at(low, high - low), dtype=np.uint8).copy()


def _attributes_of(value: Any) -> dict[str, Any]:
    attributes = dict(getattr(value, "__dict__", {}))
    missing = object()
    for name in slots_of(type(value)):
        held = getattr(value, name, missing)
        if held is not missing:
            attributes[name] = held
    return attributes


_BUILT_IN: dict[type[Any], Callable[[_Encoder, Any, str], list[Any]]] = {
    list: lambda e, v, p: ["list", e._all(v, p)],
    tuple: lambda e, v, p: ["tuple", e._all(v, p)],
    set: lambda e, v, p: ["set", e._all(v, p)],
    frozenset: lambda e, v, p: ["frozenset", e._all(v, p)],
    deque: lambda e, v, p: ["deque", v.maxlen, e._all(v, p)],
    dict: lambda e, v, p: ["dict", [[e.value(k, p), e.value(held, p + "[]")] for k, held in v.items()]],
    bytes: lambda e, v, p: ["bytes", v.hex()],
}


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
            decoder.fill(encoded.roots[name], root, name)
        return {name: decoder.value(value, present.get(name)) for name, value in encoded.roots.items()}
    except (KeyError, IndexError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"expected the memory of a run, found {type(error).__name__}: {error}") from error


class _Decoder:
    def __init__(self, encoded: Encoded) -> None:
        self._encoded = encoded
        self._made: dict[int, Any] = {}

    def fill(self, value: Any, present: object, name: str) -> None:
        """Make the restored object of a reference in place of the present one."""
        if not is_plain(type(present)):
            return
        number = value["#"]
        kind, class_name, attributes = self._encoded.nodes[number]
        if kind != "object" or own_class(class_name) is not type(present):
            raise ValueError(f"expected the memory of {name_of(type(present))} for {name}, found another")
        self._made[number] = present
        self._set(present, attributes, present)

    def value(self, value: Any, present: Any = None) -> Any:
        """The value of a plain value or reference; ``present`` is what holds its place now."""
        if type(value) in PLAIN:
            return value
        number = int(value["#"])
        if number not in self._made:
            kind, *fields = self._encoded.nodes[number]
            if kind in _CONTAINERS:
                self._made[number] = made = _CONTAINERS[kind](fields)
                self._put(kind, made, fields[-1])
            elif kind in ("object", "params"):
                self._made[number] = made = _blank(kind, fields[0])
                self._set(made, fields[1], present)
            else:
                self._made[number] = _LEAVES[kind](self, fields, present)
        return self._made[number]

    def all(self, values: list[Any]) -> list[Any]:
        return [self.value(value) for value in values]

    def _put(self, kind: str, made: Any, values: list[Any]) -> None:
        if kind == "dict":
            made.update((self.value(key), self.value(held)) for key, held in values)
        elif kind == "set":
            made.update(self.all(values))
        else:
            made.extend(self.all(values))

    def _set(self, made: object, attributes: dict[str, Any], present: object) -> None:
        """Set all attributes, also of frozen classes, and take away what the present one has beyond them."""
        if made is present:
            for name in set(getattr(made, "__dict__", ())) - attributes.keys():
                object.__delattr__(made, name)
        for name, value in attributes.items():
            object.__setattr__(made, name, self.value(value, getattr(present, name, None)))

    def kept(self, fields: list[Any], present: Any) -> Any:
        if not isinstance(present, KEPT):
            raise ValueError("expected machinery in the place of the restored one, found none")
        return present

    def array(self, fields: list[Any]) -> AnyArray:
        """An array in its block: others share its memory as they did. numpy refuses what lies outside of the block."""
        descr, shape, strides, writeable, block, offset = fields
        kind = np.lib.format.descr_to_dtype(_as_descr(descr))
        if kind.hasobject:
            raise ValueError("expected numbers in an array, found objects")
        buffer = self._encoded.blocks[block]
        made: AnyArray = np.ndarray(tuple(shape), kind, buffer, offset, tuple(strides))
        if not writeable:
            made.flags.writeable = False
        return made

    def generator(self, fields: list[Any]) -> np.random.Generator:
        name, state = fields
        if name not in BIT_GENERATORS:
            raise ValueError(f"expected a random generator of numpy, found {name!r}")
        bits = getattr(np.random, name)()
        bits.state = self.value(state)
        return np.random.Generator(bits)


def _blank(kind: str, name: str) -> Any:
    """An instance without attributes, made without calling anything of its class."""
    found = own_class(name)
    if kind == "params":
        if not is_params(found):
            raise ValueError(f"expected parameters, found {name!r}")
        return found.model_construct()
    if not is_plain(found):
        raise ValueError(f"expected a plain class, found {name!r}")
    return object.__new__(found)


def _record(decoder: _Decoder, fields: list[Any]) -> Any:
    kind = own_class(fields[0])
    if not is_record(kind):
        raise ValueError(f"expected a named tuple, found {fields[0]!r}")
    return tuple.__new__(kind, decoder.all(fields[1]))


def _enum(fields: list[Any]) -> Any:
    kind = own_class(fields[0])
    if not is_enum(kind):
        raise ValueError(f"expected an enumeration, found {fields[0]!r}")
    return kind[fields[1]]


def _as_descr(descr: Any) -> Any:
    """A dtype's description as it was before JSON made lists of its tuples."""
    if isinstance(descr, str):
        return descr
    return [tuple(tuple(part) if isinstance(part, list) else part for part in field) for field in descr]


_CONTAINERS: dict[str, Callable[[list[Any]], Any]] = {
    "list": lambda fields: [],
    "dict": lambda fields: {},
    "set": lambda fields: set(),
    "deque": lambda fields: deque(maxlen=fields[0]),
}
_LEAVES: dict[str, Callable[[_Decoder, list[Any], Any], Any]] = {
    "tuple": lambda d, fields, present: tuple(d.all(fields[0])),
    "frozenset": lambda d, fields, present: frozenset(d.all(fields[0])),
    "record": lambda d, fields, present: _record(d, fields),
    "bytes": lambda d, fields, present: bytes.fromhex(fields[0]),
    "path": lambda d, fields, present: Path(fields[0]),
    "name": lambda d, fields, present: own(fields[0]),
    "enum": lambda d, fields, present: _enum(fields),
    "array": lambda d, fields, present: d.array(fields),
    "scalar": lambda d, fields, present: d.array(fields)[()],
    "generator": lambda d, fields, present: d.generator(fields),
    "kept": lambda d, fields, present: d.kept(fields, present),
}
