"""State that is carried from frame to frame, as plain values: what JSON holds, and arrays."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import fields
from types import NoneType
from typing import Any, ClassVar

import numpy as np

Records = tuple[type[Any], ...]
_GROUPS: dict[str, Callable[[Any], Any]] = {
    "tuple": tuple, "set": set, "dict": dict, "deque": lambda held: deque(held[1:], held[0]),
}  # fmt: skip


class Carried:
    """An object whose state can be saved and restored, so that an interrupted run resumes."""

    CARRIED: ClassVar[tuple[str, ...]] = ()
    """Names of the attributes that are carried from frame to frame; empty for all of them."""
    RECORDS: ClassVar[Records] = ()
    """Dataclasses and named tuples among what is carried."""

    def reset(self) -> None:
        """Forget what is carried, where that is of use."""

    def state(self) -> dict[str, Any]:
        """A copy of the attributes by name, as plain values."""
        held = vars(self)
        known = dict[int, int]()
        return {name: plain(held[name], self.RECORDS, known) for name in self.CARRIED or held}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a copy of the state of an object with the same parameters."""
        held = vars(self)
        known = list[Any]()
        for name, value in state.items():
            if isinstance(held[name], Carried):
                held[name].set_state(value)
            else:
                held[name] = restore(value, self.RECORDS, known)


def plain(value: Any, records: Records = (), known: dict[int, int] | None = None) -> Any:
    """A copy of a value: arrays, and what JSON holds, all else as ``{kind: content}``. Raises TypeError: a value of
    another class than ``records``; ``known``: numbers of the records so far, by their id."""
    known = {} if known is None else known
    kind = type(value)
    if kind in (NoneType, bool, int, float, str):
        return value
    if isinstance(value, Carried):
        return value.state()
    if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        return np.array(value)
    if kind in (list, tuple, set, dict):
        each = [plain(held, records, known) for held in (value.items() if kind is dict else value)]
        return each if kind is list else {kind.__name__: each}
    if kind is deque:
        return {"deque": plain([value.maxlen, *value], records, known)}
    if kind is np.random.Generator:
        return {"generator": plain(value.bit_generator.state)}
    if kind not in records:
        raise TypeError(f"a checkpoint cannot hold a value of class {kind.__module__}.{kind.__qualname__}")
    if id(value) in known:
        return {"same": known[id(value)]}
    names = getattr(kind, "_fields", None) or [field.name for field in fields(value)]
    content = {name: plain(getattr(value, name), records, known) for name in names}
    known[id(value)] = len(known)
    return {kind.__name__: content}


def restore(value: Any, records: Records = (), known: list[Any] | None = None) -> Any:
    """A copy of the value that ``plain`` took; ``known``: the records so far."""
    known = [] if known is None else known
    if isinstance(value, list):
        return [restore(held, records, known) for held in value]
    if not isinstance(value, dict):
        return np.array(value)[()] if isinstance(value, np.ndarray) else value
    ((kind, content),) = value.items()
    if kind == "same":
        return known[content]
    if kind in _GROUPS:
        return _GROUPS[kind](restore(content, records, known))
    if kind == "generator":
        generator = np.random.default_rng()
        generator.bit_generator.state = restore(content)
        return generator
    (record,) = (one for one in records if one.__name__ == kind)
    known.append(record(**{name: restore(held, records, known) for name, held in content.items()}))
    return known[-1]
