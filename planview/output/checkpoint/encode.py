"""From a graph of objects to plain values (JSON) and blocks of memory: the generic half that saves.

Every value becomes itself (None, bool, int, float, str) or a reference ``{"#": n}`` to a node ``[kind, ...]`` of a
list. Objects that are shared, and cycles, stay so. Arrays keep their strides, and arrays that share memory keep sharing
it: results of numpy may depend on either.
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np

from calib.types import U8, AnyArray
from planview.output.checkpoint import classes

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
        if isinstance(value, classes.KEPT):
            return ["kept"]
        if isinstance(value, type) or classes.is_function(value):
            if classes.is_own(value):
                return ["name", classes.name_of(value)]
        elif classes.is_enum(kind):
            return ["enum", classes.name_of(kind), value.name]
        elif classes.is_record(kind):
            return ["record", classes.name_of(kind), self._all(value, path)]
        elif classes.is_params(kind):
            return ["params", classes.name_of(kind), self._attributes(vars(value), path)]
        elif classes.is_plain(kind):
            return ["object", classes.name_of(kind), self._attributes(_attributes_of(value), path)]
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
    for name in classes.slots_of(type(value)):
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
