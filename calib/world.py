"""Poses of rectified cameras in the world: ``world.toml`` of one rig, ``rigs.toml`` of several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.io import expecting_table, load_toml, toml_string, write_whole
from calib.pose import SE3
from calib.rig import Floor

MAX_AWAY_M = 1e4
"""Farther from the origin, float32 keeps less than a millimetre."""


def refuse_strange_pose(pose: SE3) -> None:
    """Refuse (ValueError) a camera that is not above a floor, or too far from its origin."""
    x, y, height_m = (float(v) for v in pose.translation)
    if not 0.01 <= height_m <= 100.0:
        raise ValueError(f"expected a camera 0.01-100 m above the floor, found {height_m:g} m (wrong units?)")
    if max(abs(x), abs(y)) > MAX_AWAY_M:
        raise ValueError(f"expected a camera within {MAX_AWAY_M:g} m of the origin, found it at ({x:g}, {y:g}) m")


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
    shares = {"inlier_fraction": floor.inlier_fraction, "residual_m": floor.residual_m}
    lines += [f"{key} = {float(value)!r}" for key, value in shares.items() if math.isfinite(value)]
    if floor.covariance is not None:
        lines += ["# of height [m], tilt [rad], roll [rad]", f"covariance = {floor.covariance.tolist()!r}"]
    if floor.extent_m is not None:
        lines += ["# seen floor: x_min, y_min, x_max, y_max", f"extent_m = {[float(v) for v in floor.extent_m]!r}"]
    write_whole(path, "\n".join(lines) + "\n")


def load_world(path: Path) -> Floor:
    """Read ``world.toml``: a table ``world_SE3_left`` with ``rotation`` and ``translation_m``, or a 4x4 matrix. Raises
    InputError: unreadable, keys missing, or values that cannot be a camera above a floor."""
    with expecting_table(path, "a world.toml"):
        data = load_toml(path, "a world.toml")
        table = data.get("floor", {})
        pose = data["world_SE3_left"]
        covariance = table.get("covariance")
        extent = None
        if "extent_m" in table:
            x_min, y_min, x_max, y_max = (float(v) for v in table["extent_m"])
            extent = x_min, y_min, x_max, y_max
            if not (-math.inf < x_min < x_max < math.inf and -math.inf < y_min < y_max < math.inf):
                raise ValueError(f"an extent_m of {table['extent_m']!r:.80}")
        floor = Floor(
            SE3.from_table(pose) if isinstance(pose, dict) else SE3.from_matrix(pose),
            float(table.get("inlier_fraction", math.nan)),
            float(table.get("residual_m", math.nan)),
            None if covariance is None else np.array(covariance, dtype=np.float64).reshape(3, 3),
            extent,
        )
        refuse_strange_pose(floor.world_SE3_left)
        return floor


RIGS_FILE = "rigs.toml"


@dataclass(frozen=True, eq=False)
class RigEntry:
    """One sensor: the folder of its own recording, relative to that of ``rigs.toml``; pose of the rectified
    left camera in the common world; time of its first frame [s] on the clock of the first sensor, which starts at 0."""

    folder: str
    world_SE3_left: SE3
    start_s: float = 0.0


def save_rigs(entries: Sequence[RigEntry], path: Path, comment: str = "") -> None:
    """Write ``rigs.toml`` in one step; floats keep all their digits."""
    lines = [
        "# planview sensors: p_world = rotation @ p_left + translation_m; Z up, floor at Z = 0,",
        "# p_left in the rectified left camera frame (x right, y down, z forward);",
        "# start_s is when the sensor's first frame was taken, on the clock of the first sensor",
        *(f"# {line}" for line in comment.splitlines()),
    ]
    for entry in entries:
        lines += ["", "[[sensor]]", f"folder = {toml_string(entry.folder)}", f"start_s = {entry.start_s!r}"]
        lines += ["[sensor.world_SE3_left]", *entry.world_SE3_left.toml()]
    write_whole(path, "\n".join(lines) + "\n")


def load_rigs(path: Path) -> tuple[RigEntry, ...]:
    """Read ``rigs.toml``. Raises InputError: unreadable, keys missing, or sensors that cannot be: none, two of one
    folder, a folder outside of the file's own, a pose below the floor."""
    with expecting_table(path, "a rigs.toml"):
        rigs = load_toml(path, "a rigs.toml")
        listed = "head" if "head" in rigs else "sensor"  # older files have heads
        entries = tuple(_entry(table) for table in rigs[listed])
    if not 1 <= len(entries) <= 32:  # more in one world are a mistake
        raise InputError(f"{path}: expected 1 to 32 sensors, found {len(entries)}")
    inside = path.parent.resolve()
    folders = [(inside / entry.folder).resolve() for entry in entries]
    if len(set(folders)) < len(folders):
        raise InputError(f"{path}: expected every sensor's folder once, found {[e.folder for e in entries]}")
    for entry, folder in zip(entries, folders, strict=True):
        if not folder.is_relative_to(inside):
            raise InputError(f"{path}: expected sensors inside {path.parent}, found {entry.folder!r}")
        try:
            refuse_strange_pose(entry.world_SE3_left)
        except ValueError as error:
            raise InputError(f"{path}: {entry.folder}: {error}") from error
    return entries


def _entry(table: dict[str, Any]) -> RigEntry:
    start_s = float(table.get("start_s", 0.0))
    if not math.isfinite(start_s):
        raise ValueError(f"start_s = {start_s}")
    return RigEntry(str(table["folder"]), SE3.from_table(table["world_SE3_left"]), start_s)
