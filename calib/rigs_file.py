"""``rigs.toml``: the heads of one recording, where they are in its common world, and when each began."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.files import write_whole
from calib.pose import SE3
from calib.text import parse_toml, reason

RIGS_FILE = "rigs.toml"
MAX_HEADS = 32
"""More heads than this in one world are a mistake (our choice)."""
MAX_BYTES = 1_000_000
"""A larger file is no list of heads."""


@dataclass(frozen=True, eq=False)
class RigEntry:
    """One head of a recording.

    Attributes:
        folder: its own recording, relative to the folder of ``rigs.toml``.
        world_SE3_left: pose of the rectified left camera in the common world.
        start_s: when the head's first frame was taken, on the clock of the first head, whose first frame is at 0 [s].
    """

    folder: str
    world_SE3_left: SE3
    start_s: float = 0.0


def save_rigs(entries: Sequence[RigEntry], path: Path, comment: str = "") -> None:
    """Write ``rigs.toml`` in one step; floats keep all their digits."""
    lines = [
        "# planview heads: p_world = rotation @ p_left + translation_m; Z up, floor at Z = 0,",
        "# p_left in the rectified left camera frame (x right, y down, z forward);",
        "# start_s is when the head's first frame was taken, on the clock of the first head",
        *(f"# {line}" for line in comment.splitlines()),
    ]
    for entry in entries:
        lines += [
            "",
            "[[head]]",
            f"folder = {_quoted(entry.folder)}",
            f"start_s = {entry.start_s!r}",
            "[head.world_SE3_left]",
            f"rotation = {entry.world_SE3_left.rotation.tolist()!r}",
            f"translation_m = {entry.world_SE3_left.translation.tolist()!r}",
        ]
    write_whole(path, "\n".join(lines) + "\n")


def load_rigs(path: Path) -> tuple[RigEntry, ...]:
    """Read ``rigs.toml``.

    Raises:
        InputError: unreadable, keys missing, or heads that cannot be: none, two of one folder, a folder outside of the
            file's own, a pose below the floor.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: expected a list of heads, found {path.stat().st_size} bytes")
        data = parse_toml(path.read_text(encoding="utf-8"))
        entries = tuple(_entry(table) for table in data["head"])
    except KeyError as error:
        raise InputError(f"{path}: expected a rigs.toml with the key {error}, found none") from error
    except (OSError, UnicodeDecodeError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: expected a rigs.toml, found {reason(error)}") from error
    _check(path, entries)
    return entries


def _entry(table: dict[str, Any]) -> RigEntry:
    pose = table["world_SE3_left"]
    start_s = float(table.get("start_s", 0.0))
    if not math.isfinite(start_s):
        raise ValueError(f"start_s = {start_s}")
    rotation, translation = (np.array(pose[key], dtype=np.float64) for key in ("rotation", "translation_m"))
    return RigEntry(str(table["folder"]), SE3(rotation, translation), start_s)


def _check(path: Path, entries: Sequence[RigEntry]) -> None:
    if not 1 <= len(entries) <= MAX_HEADS:
        raise InputError(f"{path}: expected 1 to {MAX_HEADS} heads, found {len(entries)}")
    inside = path.parent.resolve()
    folders = [(inside / entry.folder).resolve() for entry in entries]
    if len(set(folders)) < len(folders):
        raise InputError(f"{path}: expected every head's folder once, found {[e.folder for e in entries]}")
    for entry, folder in zip(entries, folders, strict=True):
        if not folder.is_relative_to(inside):
            raise InputError(f"{path}: expected heads inside {path.parent}, found {entry.folder!r}")
        height_m = float(entry.world_SE3_left.translation[2])
        if not 0.0 < height_m <= 100.0:
            raise InputError(f"{path}: {entry.folder}: expected a camera 0-100 m above the floor, found {height_m:g} m")


def _quoted(text: str) -> str:
    escaped = "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text)
    return f'"{escaped}"'
