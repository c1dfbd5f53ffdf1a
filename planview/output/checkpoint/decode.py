"""From plain values and blocks of memory back to a graph of objects: the generic half that restores.

No code is taken from a file: classes are found by name among those of the project, instances are made without calling
anything of theirs, and attributes are set. Machinery (threads) comes from the object in whose place the restored one
goes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calib.types import AnyArray
from planview.output.checkpoint import classes
from planview.output.checkpoint.encode import BIT_GENERATORS, PLAIN, Encoded


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
        if not classes.is_plain(type(present)):
            return
        number = value["#"]
        kind, class_name, attributes = self._encoded.nodes[number]
        if kind != "object" or classes.own_class(class_name) is not type(present):
            raise ValueError(f"expected the memory of {classes.name_of(type(present))} for {name}, found another")
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
        if not isinstance(present, classes.KEPT):
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
    found = classes.own_class(name)
    if kind == "params":
        if not classes.is_params(found):
            raise ValueError(f"expected parameters, found {name!r}")
        return found.model_construct()
    if not classes.is_plain(found):
        raise ValueError(f"expected a plain class, found {name!r}")
    return object.__new__(found)


def _record(decoder: _Decoder, fields: list[Any]) -> Any:
    kind = classes.own_class(fields[0])
    if not classes.is_record(kind):
        raise ValueError(f"expected a named tuple, found {fields[0]!r}")
    return tuple.__new__(kind, decoder.all(fields[1]))


def _enum(fields: list[Any]) -> Any:
    kind = classes.own_class(fields[0])
    if not classes.is_enum(kind):
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
    "name": lambda d, fields, present: classes.own(fields[0]),
    "enum": lambda d, fields, present: _enum(fields),
    "array": lambda d, fields, present: d.array(fields),
    "scalar": lambda d, fields, present: d.array(fields)[()],
    "generator": lambda d, fields, present: d.generator(fields),
    "kept": lambda d, fields, present: d.kept(fields, present),
}
