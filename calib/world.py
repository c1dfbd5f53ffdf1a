"""Where rectified cameras are in the world: ``world.toml`` of one rig, ``rigs.toml`` of several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.io import load_toml, parse_toml, quoted, reason, write_whole
from calib.pose import SE3
from calib.rig import Floor

MAX_HEIGHT_M = 100.0
"""A camera higher than this above the floor means wrong units."""


def save_world(floor: Floor, path: Path) -> None:
    """Write ``world.toml``; floats keep all their digits, what is unknown is left out."""
    lines = [
        "# planview world: p_world = rotation @ p_left + translation_m; Z up, floor at Z = 0,",
        "# p_left in the rectified left camera frame (x right, y down, z forward)",
        f"# camera {floor.height_m:.3f} m above the floor, tilt {math.degrees(floor.tilt_rad):.2f} degrees from"
        f" straight down, roll {math.degrees(floor.roll_rad):.2f} degrees",
        "[world_SE3_left]",
        *floor.world_SE3_left.toml(),
        "",
        "[floor]",
    ]
    lines += [
        f"{key} = {float(getattr(floor, key))!r}"
        for key in ("inlier_fraction", "residual_m")
        if math.isfinite(getattr(floor, key))
    ]
    if floor.covariance is not None:
        lines += ["# of height [m], tilt [rad], roll [rad]", f"covariance = {floor.covariance.tolist()!r}"]
    if floor.extent_m is not None:
        lines += ["# seen floor: x_min, y_min, x_max, y_max", f"extent_m = {[float(v) for v in floor.extent_m]!r}"]
    write_whole(path, "\n".join(lines) + "\n")


def load_world(path: Path) -> Floor:
    """Read ``world.toml``: a table ``world_SE3_left`` with ``rotation`` and ``translation_m``, or a 4x4 matrix. Raises
    InputError: unreadable, keys missing, or values that cannot be a camera above a floor."""
    try:
        data = load_toml(path, "a world.toml")
        pose = data["world_SE3_left"]
        table = data.get("floor", {})
        covariance = table.get("covariance")
        extent = table.get("extent_m")
        x_min, y_min, x_max, y_max = (float(v) for v in extent or (0, 0, 0, 0))
        floor = Floor(
            SE3.from_table(pose) if isinstance(pose, dict) else SE3.from_matrix(pose),
            float(table.get("inlier_fraction", math.nan)),
            float(table.get("residual_m", math.nan)),
            None if covariance is None else np.array(covariance, dtype=np.float64).reshape(3, 3),
            None if extent is None else (x_min, y_min, x_max, y_max),
        )
    except KeyError as error:
        raise InputError(f"{path}: expected a world.toml with the key {error}, found none") from error
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: expected a world.toml, found {error}") from error
    if not 0.0 < floor.height_m <= MAX_HEIGHT_M:
        raise InputError(
            f"{path}: expected a camera 0-{MAX_HEIGHT_M:g} m above the floor, found {floor.height_m:g} m (wrong units?)"
        )
    return floor


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
            f"folder = {quoted(entry.folder)}",
            f"start_s = {entry.start_s!r}",
            "[head.world_SE3_left]",
            *entry.world_SE3_left.toml(),
        ]
    write_whole(path, "\n".join(lines) + "\n")


def load_rigs(path: Path) -> tuple[RigEntry, ...]:
    """Read ``rigs.toml``. Raises InputError: unreadable, keys missing, or heads that cannot be: none, two of one
    folder, a folder outside of the file's own, a pose below the floor."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: expected a list of heads, found {path.stat().st_size} bytes")
        data = parse_toml(path.read_text(encoding="utf-8"))
        entries = tuple(_entry(table) for table in data["head"])
    except KeyError as error:
        raise InputError(f"{path}: expected a rigs.toml with the key {error}, found none") from error
    except (OSError, UnicodeDecodeError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: expected a rigs.toml, found {reason(error)}") from error
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
    return entries


def _entry(table: dict[str, Any]) -> RigEntry:
    start_s = float(table.get("start_s", 0.0))
    if not math.isfinite(start_s):
        raise ValueError(f"start_s = {start_s}")
    return RigEntry(str(table["folder"]), SE3.from_table(table["world_SE3_left"]), start_s)
