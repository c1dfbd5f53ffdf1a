"""Numbers out of parsed files, with messages that name what was expected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.camera import Camera, LensModel
from calib.pose import SE3
from calib.types import F64


def table(value: Any, name: str) -> Mapping[str, Any]:
    """A mapping, or ValueError."""
    if not isinstance(value, Mapping):
        raise ValueError(f"expected {name} to be a table, found {_shown(value)}")
    return value


def entry(values: Mapping[str, Any], *names: str) -> Any:
    """The first of the names that is present, or ValueError."""
    for name in names:
        if name in values:
            return values[name]
    raise ValueError(f"expected the key {' or '.join(names)}, found none")


def number(value: Any, name: str) -> float:
    """A finite number; YAML leaves ``1e-5`` a string, so numeric strings count."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected a number for {name}, found {_shown(value)}")
    try:
        result = float(value)
    except (ValueError, OverflowError):
        raise ValueError(f"expected a number for {name}, found {_shown(value)}") from None
    if not np.isfinite(result):
        raise ValueError(f"expected finite numbers in {name}, found {_shown(value)}")
    return result


def whole(value: Any, name: str) -> int:
    """A positive whole number below 100 000 (a size in pixels)."""
    result = number(value, name)
    if result != int(result) or not 1 <= result <= 100_000:
        raise ValueError(f"expected a whole number of pixels for {name}, found {_shown(value)}")
    return int(result)


def numbers(value: Any, name: str, count: int | tuple[int, ...]) -> F64:
    """A flat array of finite numbers from a list, a list of rows, a ``data`` table or text separated by blanks."""
    if isinstance(value, Mapping):
        value = entry(value, "data")
    if isinstance(value, str):
        value = value.replace(",", " ").replace(";", " ").split()
    if not isinstance(value, list | tuple):
        raise ValueError(f"expected a list of numbers for {name}, found {_shown(value)}")
    allowed = (count,) if isinstance(count, int) else count
    flat: list[Any] = []
    for item in value:
        flat.extend(item if isinstance(item, list | tuple) else [item])
        if len(flat) > max(allowed):
            break
    if len(flat) not in allowed:
        raise ValueError(f"expected {' or '.join(map(str, allowed))} numbers for {name}, found {len(flat)} or more")
    return np.array([number(item, name) for item in flat])


def camera(
    size: tuple[int, int], matrix: F64, distortion: F64, model: LensModel | None = None, name: str = "camera"
) -> Camera:
    """A camera from K (9 values, row-major) or (fx, fy, cx, cy) and coefficients.

    Args:
        model: None takes Brown or rational by the number of coefficients.
    """
    if len(matrix) == 9:
        k = matrix.reshape(3, 3)
        if abs(k[2, 2] - 1.0) > 1e-6 or np.abs(k[[1, 2, 2], [0, 0, 1]]).max() > 1e-6:
            raise ValueError(f"expected a camera matrix [fx 0 cx; 0 fy cy; 0 0 1] for {name}, found {matrix.tolist()}")
        if abs(k[0, 1]) > 1e-3 * abs(k[0, 0]):
            raise ValueError(f"expected no skew in the camera matrix of {name}, found {k[0, 1]:g}")
        matrix = k[[0, 1, 0, 1], [0, 1, 2, 2]]
    if model is None:
        model = "brown" if len(distortion) <= 5 else "rational"
    fx, fy, cx, cy = (float(v) for v in matrix)
    return Camera(*size, fx, fy, cx, cy, model, tuple(float(v) for v in distortion))


def transform(rotation: F64, translation: F64, name: str = "rotation") -> SE3:
    """A pose from 9 and 3 values; rounding in the file (up to 1e-3) is removed by the nearest rotation."""
    matrix = rotation.reshape(3, 3)
    u, _, vt = np.linalg.svd(matrix)
    nearest = u @ vt
    if np.abs(nearest - matrix).max() > 1e-3 or np.linalg.det(nearest) < 0:
        raise ValueError(f"expected {name} to be a rotation matrix (orthonormal, determinant +1)")
    # A matrix that is a rotation to the last digits is kept as it is: reading what was written changes nothing.
    exact = np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-12
    return SE3(matrix if exact else nearest, translation)


def rigid(value: Any, name: str, unit_m: float) -> SE3:
    """A pose from a 4x4 (or 3x4) matrix, flat or nested."""
    flat = numbers(value, name, (12, 16))
    if len(flat) == 16 and np.abs(flat[12:] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise ValueError(f"expected {name} to end with the row 0 0 0 1, found {flat[12:].tolist()}")
    m = flat[:12].reshape(3, 4)
    return transform(m[:, :3].ravel(), m[:, 3] * unit_m, name)


def held(name: str, one: Camera, counts: Mapping[str, int]) -> tuple[LensModel, list[float]]:
    """The lens as a format holds it, if it does so exactly.

    Args:
        name: the format, for the message.
        counts: number of coefficients it holds, by lens model.
    Returns:
        The model and that many coefficients; a rational lens without its denominator is a Brown lens.
    Raises:
        ValueError: the format has no such lens.
    """
    values = np.trim_zeros(one.coefficients, "b")
    model: LensModel = "brown" if one.model == "rational" and len(values) <= 5 else one.model
    if model == "brown" and len(values) > counts.get("brown", -1) and "rational" in counts:
        model = "rational"
    if len(values) > counts.get(model, -1):
        holds = ", ".join(f"{n} {m} coefficients" for m, n in counts.items())
        raise ValueError(f"the {name} format holds {holds}, not this {one.model} lens with {len(values)} of them")
    return model, [*(float(v) for v in values), *[0.0] * (counts[model] - len(values))]


def _shown(value: Any) -> str:
    text = repr(value) if isinstance(value, str | int | float | bool | type(None)) else type(value).__name__
    return text if len(text) <= 40 else text[:37] + "..."
