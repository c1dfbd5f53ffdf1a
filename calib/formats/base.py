"""Parts that formats share: the calibration file as text, numbers out of parsed files, YAML and XML without dangers."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import yaml

from calib.camera import Camera, LensModel
from calib.errors import InputError
from calib.io import expecting, read_text, require_file
from calib.pose import SE3
from calib.rig import StereoRig, parse_rig, rig_text
from calib.types import F64

Size = tuple[int, int]


class Source(NamedTuple):
    """A file and its text."""

    path: Path
    text: str


class Choice(NamedTuple):
    """Values that the caller supplies and a file may lack: arguments of ``calib.formats.load_rig``."""

    size: Size | None = None
    cameras: tuple[str, str] | None = None
    unit_m: float | None = None
    rectified: bool | None = None

    def unit(self, default_m: float = 1.0) -> float:
        """Metres per unit of the file."""
        return default_m if self.unit_m is None else self.unit_m


Keys = tuple[tuple[str, re.Pattern[str]], ...]
"""Keys that a format needs, as messages call them, each with the pattern that finds it in a text."""


def lacking_keys(keys: Keys, text: str) -> list[str]:
    """Names of the keys that a text does not hold."""
    return [name for name, pattern in keys if not pattern.search(text)]


def whole_with(*sets: Keys) -> Callable[[Source], str | None]:
    """``Format.part`` of a format of one file, which holds every key of one of the sets."""

    def part(source: Source) -> str | None:
        for keys in sets:
            if not lacking_keys(keys, source.text):
                return "whole"
        return None

    return part


def lines_with(**patterns: str) -> Keys:
    """Keys by patterns of the lines that hold them."""
    return tuple((name, re.compile(pattern, re.MULTILINE)) for name, pattern in patterns.items())


class Format(NamedTuple):
    """The format in which one tool writes a rig.

    Attributes:
        key, name: short, and as messages show it.
        sets: the keys that make a rig, or a half of one; of several sets any.
        part: what a text holds in this format: "whole" (a rig), "left" or "right" (a half), or None (not this format).
        read: a rig from a whole, or from its left and right half; raises ValueError for bad content.
        texts: the text of each file that a rig is written to; raises ValueError when the format cannot hold it. None:
            the format is only read.
        suffix: of the file it writes; empty: it writes a folder.
    """

    key: str
    name: str
    sets: tuple[Keys, ...]
    part: Callable[[Source], str | None]
    read: Callable[[Sequence[Source], Choice], StereoRig]
    texts: Callable[[StereoRig, Path], Mapping[Path, str]] | None = None
    suffix: str = ""

    def missing(self, source: Source) -> tuple[int, list[str]]:
        """Number of keys of a set that a text holds, and those that it lacks: of the set that it holds most of."""
        nearest: tuple[int, list[str]] = (-1, [])
        for keys in self.sets:
            lacking = lacking_keys(keys, source.text)
            count = len(keys) - len(lacking)
            if (count, -len(lacking)) > (nearest[0], -len(nearest[1])):
                nearest = (count, lacking)
        return nearest


_ARRAYS = {".npy": "an array of NumPy", ".mat": "arrays of MATLAB", ".pkl": "Python objects"}


def arrays_text(path: Path) -> str | None:
    """Description of a file of arrays that no format reads, and the way out; None of another file."""
    kind = _ARRAYS.get(path.suffix.lower())
    if kind is None:
        return None
    way_out = "write K1, D1, K2, D2, R, T and image_size as lists into a .json file, or save a rig.toml"
    return f"{kind} ({path.name}): {way_out}"


def _arrays_as_text(path: Path) -> str:
    """The small arrays of a NumPy archive as JSON. Raises InputError: no archive of numbers."""
    require_file(path, "a calibration file")
    # NumPy raises whatever a damaged file provokes.
    with expecting(path, "arrays of NumPy", Exception), np.load(path, allow_pickle=False) as archive:
        lists = {}
        for name in archive.files:
            if archive.zip.getinfo(f"{name}.npy").file_size < 4096:
                lists[name] = archive[name].tolist()
        return json.dumps(lists)


def read_source(path: Path) -> Source:
    """Read a text file, or the arrays of NumPy. Raises InputError: unreadable, too large, or not text."""
    if path.suffix.lower() == ".npz":
        return Source(path, _arrays_as_text(path))
    arrays = arrays_text(path) if path.is_file() else None
    if arrays:
        raise InputError(f"{path}: expected a calibration file as text, found {arrays}")
    return Source(path, read_text(path, "a calibration file"))


def is_tsai(source: Source) -> bool:
    """True for a text that holds one camera in Tsai's model."""
    return "<Geometry" in source.text and "<Extrinsic" in source.text


def side_of(name: str) -> str | None:
    """Side that a file or folder name refers to: "left", "right", or None when it names neither or both."""
    lower = name.lower()
    words = set(re.split(r"[^a-z0-9]+", lower))
    is_left = "left" in lower or bool(words & {"l", "cam0", "camera0"})
    is_right = "right" in lower or bool(words & {"r", "cam1", "camera1"})
    if is_left == is_right:
        return None
    return "left" if is_left else "right"


def table(value: Any, name: str) -> Mapping[str, Any]:
    """A mapping, or ValueError."""
    if not isinstance(value, Mapping):
        raise ValueError(f"expected {name} to be a table, found {_value_text(value)}")
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
        raise ValueError(f"expected a number for {name}, found {_value_text(value)}")
    try:
        result = float(value)
    except (ValueError, OverflowError):
        raise ValueError(f"expected a number for {name}, found {_value_text(value)}") from None
    if not np.isfinite(result):
        raise ValueError(f"expected finite numbers in {name}, found {_value_text(value)}")
    return result


def whole(value: Any, name: str) -> int:
    """A positive whole number below 100 000 (a size in pixels)."""
    result = number(value, name)
    if result != int(result) or not 1 <= result <= 100_000:
        raise ValueError(f"expected a whole number of pixels for {name}, found {_value_text(value)}")
    return int(result)


def size_of(value: Any, name: str) -> Size:
    """(width, height) [px] from two numbers in any form that ``numbers`` takes."""
    width, height = numbers(value, name, 2).tolist()
    return whole(width, name), whole(height, name)


def lens_of(values: Mapping[str, Any], models: Mapping[str, LensModel], name: str) -> LensModel:
    """Value of ``models`` for the distortion_model of a camera, or ValueError."""
    lens = str(entry(values, "distortion_model"))
    if lens not in models:
        raise ValueError(f"expected a distortion_model of {', '.join(models)} in {name}, found {lens!r}")
    return models[lens]


def numbers(value: Any, name: str, count: int | tuple[int, ...]) -> F64:
    """A flat array of finite numbers from a list, a list of rows, a ``data`` table or text separated by blanks."""
    if isinstance(value, Mapping):
        value = entry(value, "data")
    if isinstance(value, str):
        value = value.replace(",", " ").replace(";", " ").split()
    if not isinstance(value, list | tuple):
        raise ValueError(f"expected a list of numbers for {name}, found {_value_text(value)}")
    allowed = (count,) if isinstance(count, int) else count
    flat: list[Any] = []
    for item in value:
        flat.extend(item if isinstance(item, list | tuple) else [item])
        if len(flat) > max(allowed):
            break  # a list without end is not walked to its end
    if len(flat) not in allowed:
        raise ValueError(f"expected {' or '.join(map(str, allowed))} numbers for {name}, found {len(flat)} or more")
    return np.array([number(item, name) for item in flat])


def number_at(values: Mapping[str, Any], *names: str) -> float:
    """The ``number`` at the first of the names that is present."""
    return number(entry(values, *names), names[0])


def whole_at(values: Mapping[str, Any], *names: str) -> int:
    """The ``whole`` number at the first of the names that is present."""
    return whole(entry(values, *names), names[0])


def numbers_at(values: Mapping[str, Any], count: int | tuple[int, ...], *names: str) -> F64:
    """The ``numbers`` at the first of the names that is present."""
    return numbers(entry(values, *names), names[0], count)


def camera(
    size: tuple[int, int], matrix: F64, distortion: F64, model: LensModel | None = None, name: str = "camera"
) -> Camera:
    """A camera from K (9 values, row-major) or (fx, fy, cx, cy) and coefficients; None: by their number."""
    if len(matrix) == 9:
        k = matrix.reshape(3, 3)
        column = np.abs(k[:2, 2])
        row = np.abs(k[2, :2])
        form = f"expected a camera matrix [fx 0 cx; 0 fy cy; 0 0 1] for {name}"
        if column.max() < 1e-6 < row.min():
            raise ValueError(f"{form}, found it transposed")
        if abs(k[2, 2] - 1.0) > 1e-6 or abs(k[1, 0]) > 1e-6 or row.max() > 1e-6:
            raise ValueError(f"{form}, found {matrix.tolist()}")
        if abs(k[0, 1]) > 1e-3 * abs(k[0, 0]):
            raise ValueError(f"expected no skew in the camera matrix of {name}, found {k[0, 1]:g}")
        matrix = k[[0, 1, 0, 1], [0, 1, 2, 2]]
    if model is None:
        model = "brown" if len(distortion) <= 5 else "rational"
    fx, fy, cx, cy = matrix.tolist()
    return Camera(*size, fx, fy, cx, cy, model, tuple(distortion.tolist()))


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
    last_row = flat[12:]
    if len(last_row) and np.abs(last_row - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise ValueError(f"expected {name} to end with the row 0 0 0 1, found {last_row.tolist()}")
    matrix = flat[:12].reshape(3, 4)
    return transform(matrix[:, :3].ravel(), matrix[:, 3] * unit_m, name)


def join_cameras(left: tuple[Camera, SE3], right: tuple[Camera, SE3], source: str) -> StereoRig:
    """The rig of two cameras, each with its camera_SE3_common of a frame that both share."""
    left_camera, left_SE3_common = left
    right_camera, right_SE3_common = right
    return StereoRig(left_camera, right_camera, right_SE3_common @ left_SE3_common.inverse(), source)


def camera_from_projection(size: Size, value: Any, name: str, unit_m: float) -> tuple[Camera, SE3]:
    """The camera of a (3, 4) projection P = K [I | t] of rectified images, and its pose."""
    p = numbers(value, name, 12).reshape(3, 4)
    shift = np.asarray(np.linalg.solve(p[:, :3], p[:, 3]) * unit_m)
    return camera(size, p[:, :3].ravel(), np.empty(0), "brown", name), SE3(np.eye(3), shift)


def exact_lens(name: str, camera: Camera, counts: Mapping[str, int]) -> tuple[LensModel, list[float]]:
    """The lens as a format with ``counts`` coefficients by model holds it exactly, or ValueError."""
    values = np.trim_zeros(camera.coefficients, "b").tolist()
    model = camera.model
    if model == "rational" and len(values) <= 5:
        model = "brown"
    if model == "brown" and len(values) > counts.get("brown", -1) and "rational" in counts:
        model = "rational"
    missing = counts.get(model, -1) - len(values)
    if missing < 0:
        holds = ", ".join(f"{count} {lens} coefficients" for lens, count in counts.items())
        raise ValueError(f"the {name} format holds {holds}, not this {camera.model} lens with {len(values)} of them")
    return model, values + [0.0] * missing


def _value_text(value: Any) -> str:
    is_plain = value is None or isinstance(value, str | int | float)
    text = repr(value) if is_plain else type(value).__name__
    return text if len(text) <= 40 else text[:37] + "..."


def parse_json(text: str) -> Any:
    """The value of a JSON text. Raises ValueError: not JSON, or nesting without end."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("expected JSON, found nesting without end") from None


def parse_xml(text: str) -> ElementTree.Element:
    """The root element. Raises ValueError: not XML, or a document type (entities can expand without end)."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("expected XML without a document type, found one")
    try:
        return ElementTree.fromstring(text)
    # An encoding without a decoder gives LookupError; nesting without end RecursionError.
    except (ElementTree.ParseError, LookupError, RecursionError, ValueError) as error:
        raise ValueError(f"expected XML, found {error}") from error


_HEADER = re.compile(r"\A%YAML[ :][0-9.]+[^\n]*\n", re.MULTILINE)
MAX_CHARACTERS = 100_000
"""A calibration in YAML has a few thousand; the parser takes a second for 100,000."""
_OPENCV_TAG = re.compile(r"!!opencv-[a-z-]+")


class _PlainLoader(yaml.SafeLoader):
    """Values only, without references, by which a small file can stand for gigabytes."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """One value; those inside it are composed by the same method."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("a reference (*name)")
        return super().compose_node(parent, index)


def parse_yaml(text: str) -> Mapping[str, Any]:
    """A YAML mapping; OpenCV's ``%YAML:1.0`` header (any style) and its tags are taken off first. Raises ValueError:
    not YAML, or no mapping at the top."""
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"expected YAML of up to {MAX_CHARACTERS} characters, found {len(text)}")
    try:
        plain = _OPENCV_TAG.sub("", _HEADER.sub("", text.lstrip()))
        # Of several documents (ros2 topic echo prints one per message) the first.
        data = next(yaml.load_all(plain, _PlainLoader), None)
    except yaml.YAMLError as error:
        raise ValueError(f"expected YAML, found {' '.join(str(error).split())}") from error
    # PyYAML's own constructors leak these on odd scalars such as "!!bool x" or a day 99, and on deep nesting.
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"expected YAML, found a value that cannot be read ({type(error).__name__})") from error
    if not isinstance(data, Mapping):
        raise ValueError("expected YAML with keys at the top")
    return data


def yaml_text(values: Mapping[str, Any]) -> str:
    """YAML with every list on a line of its own; floats keep all their digits."""
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=10_000)


NATIVE = Format(
    "rig",
    "planview rig.toml",
    (lines_with(left=r"^\s*\[left\]", right=r"^\s*\[right\]", right_SE3_left=r"^\s*\[right_SE3_left\]"),),
    whole_with(lines_with(rig=r"\A# planview stereo rig|^\s*\[right_SE3_left\]")),
    lambda sources, choice: parse_rig(sources[0].text, sources[0].path.name),
    lambda rig, path: {path: rig_text(rig)},
    ".toml",
)
