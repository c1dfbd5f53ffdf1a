"""Which classes a checkpoint may hold: those of this project, found by name among what is loaded, and nothing else."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from enum import Enum
from types import FunctionType
from typing import Any, Generic, Protocol

from calib.params import Params

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
