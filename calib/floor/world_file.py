"""``world.toml``: where the rectified left camera is in the world."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.files import write_whole
from calib.pose import SE3
from calib.rig import Floor
from calib.text import load_toml

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
        f"rotation = {floor.world_SE3_left.rotation.tolist()!r}",
        f"translation_m = {floor.world_SE3_left.translation.tolist()!r}",
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
    """Read ``world.toml``: a table ``world_SE3_left`` with ``rotation`` and ``translation_m``, or a 4x4 matrix.

    Raises:
        InputError: unreadable, keys missing, or values that cannot be a camera above a floor.
    """
    try:
        data = load_toml(path, "a world.toml")
        pose = _pose(data["world_SE3_left"])
        floor = _floor(pose, data.get("floor", {}))
    except KeyError as error:
        raise InputError(f"{path}: expected a world.toml with the key {error}, found none") from error
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: expected a world.toml, found {error}") from error
    if not 0.0 < floor.height_m <= MAX_HEIGHT_M:
        raise InputError(
            f"{path}: expected a camera 0-{MAX_HEIGHT_M:g} m above the floor, found {floor.height_m:g} m (wrong units?)"
        )
    return floor


def _pose(value: Any) -> SE3:
    if isinstance(value, dict):
        return SE3(
            np.array(value["rotation"], dtype=np.float64),
            np.array(value["translation_m"], dtype=np.float64),
        )
    return SE3.from_matrix(value)


def _floor(pose: SE3, table: dict[str, Any]) -> Floor:
    covariance = table.get("covariance")
    extent = table.get("extent_m")
    return Floor(
        pose,
        float(table.get("inlier_fraction", math.nan)),
        float(table.get("residual_m", math.nan)),
        None if covariance is None else np.array(covariance, dtype=np.float64).reshape(3, 3),
        None if extent is None else _four(extent),
    )


def _four(values: Any) -> tuple[float, float, float, float]:
    x_min, y_min, x_max, y_max = (float(v) for v in values)
    return x_min, y_min, x_max, y_max
