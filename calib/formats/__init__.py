"""Calibrations as other tools write them: one file per format, recognised by content."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats.base import NATIVE, Choice, Format, Source, arrays_text, is_tsai, read_source
from calib.formats.devices import DEPTHAI, KITTI, MIDDLEBURY, ZED
from calib.formats.opencv import FORMAT as OPENCV
from calib.formats.ros import EUROC, KALIBR, ROS
from calib.io import MAX_BYTES, closed_text, entries, reason, size_text, write_whole
from calib.rig import StereoRig

_SUFFIXES = {".toml", ".yml", ".yaml", ".xml", ".json", ".conf", ".txt", ".cfg", ".ini", ".calib", ".npz", ""}
_PAIRS = (("left", "right"), ("intrinsic", "extrinsic"), ("cam0", "cam1"), ("_l", "_r"))
_NESTED = ("cam0", "cam1", "left", "right", "mav0/cam0", "mav0/cam1")

RigFiles = tuple[Format, tuple[Source, ...]]
"""A format, and the file of a whole rig or those of its left and right half."""


def find_rig(path: Path) -> RigFiles:
    """The calibration at a file or in a folder. Raises InputError: none there, half of a pair, or several."""
    if path.is_dir():
        return _find_in_folder(path)
    source = read_source(path)
    match = _recognise(source)
    if match is None:
        if is_tsai(source):
            raise InputError(f"{path}: expected a stereo calibration, found a single camera (Tsai)")
        names = ", ".join(form.name for form in FORMATS)
        raise InputError(f"{path}: expected a calibration ({names}), found none of these formats{_hint(source)}")
    form, part = match
    if part == "whole":
        return form, (source,)
    other_part = "right" if part == "left" else "left"
    mates = _find_mates(path, form, other_part)
    if len(mates) != 1:
        missing = ", ".join(form.missing(source)[1])
        lacking = f"with {missing} " if missing else ""
        raise InputError(
            f"{path}: expected its other half {lacking}next to it ({form.name}), "
            f"found {len(mates) or 'no'} file that fits"
        )
    return form, ((source, mates[0]) if part == "left" else (mates[0], source))


def _recognise(source: Source) -> tuple[Format, str] | None:
    """The format that a text has, by most keys of those that it may have, and the part of a rig that it holds."""
    parts = [(form, form.part(source)) for form in FORMATS]
    matches = [(form, part) for form, part in parts if part]
    return max(matches, key=lambda match: match[0].missing(source)[0], default=None)


def _hint(source: Source) -> str:
    """Keys that the format of which a text holds most also needs; empty where it holds none of any."""
    form = max(FORMATS, key=lambda form: form.missing(source)[0])
    count, missing = form.missing(source)
    if not count:
        return ""
    lacking = ", ".join(missing) or "left or right in the file's name"
    return f"; for {form.name} it lacks {lacking}"


def _find_mates(path: Path, form: Format, part: str) -> list[Source]:
    """Files near one half of a rig that hold the other."""
    folder = path.parent
    # EuRoC keeps each half in a folder of its own.
    if folder.name.lower() in {"cam0", "cam1", "left", "right"}:
        folder = folder.parent
    sources = _read_texts(file for file in _files(folder) if not file.samefile(path))
    return [
        source for source in sources if form.part(source) == part and _common_name(source.path) == _common_name(path)
    ]


def _files(folder: Path) -> Iterator[Path]:
    """Small files of the folder and of its usual camera folders."""
    for place in (folder, *(folder / name for name in _NESTED)):
        if not place.is_dir():
            continue
        for path in entries(place):
            if path.suffix.lower() in _SUFFIXES and path.is_file() and path.stat().st_size <= MAX_BYTES:
                yield path


def _read_texts(paths: Iterable[Path]) -> Iterator[Source]:
    for path in paths:
        with suppress(InputError):  # folders hold more than calibrations; a file that is not text is none
            yield read_source(path)


def _common_name(path: Path) -> str:
    """The name without what may differ between two halves, a word such as left/right."""
    name = f"{path.parent.name}/{path.name}".lower()
    for left, right in _PAIRS:
        name = name.replace(left, "*").replace(right, "*")
    return name


def _find_in_folder(folder: Path) -> RigFiles:
    rigs: list[RigFiles] = []
    halves: dict[Format, dict[str, list[Source]]] = {}
    hints: dict[Path, str] = {}
    for source in _read_texts(_files(folder)):
        match _recognise(source):
            case (form, "whole"):
                rigs.append((form, (source,)))
            case (form, part):
                halves.setdefault(form, {"left": [], "right": []})[part].append(source)
            case None:
                hints[source.path] = _hint(source)
    for form, sides in halves.items():
        rigs += [(form, pair) for pair in _pair_halves(sides["left"], sides["right"])]
    rigs = [rig for rig in rigs if rig[0] is NATIVE] or rigs
    if len(rigs) == 1:
        return rigs[0]
    if rigs:
        names = ", ".join("+".join(source.path.name for source in sources) for _, sources in rigs[:4])
        raise InputError(f"{folder}: expected one calibration in it, found {len(rigs)} ({names}): name the file")
    contents = closed_text(_files(folder))
    if not contents and halves:
        half = next(source for sides in halves.values() for part in sides.values() for source in part)
        contents = f"only half of a pair ({half.path.name}{_hint(half)})"
    if not contents:
        contents = next(filter(None, map(arrays_text, entries(folder))), "") or _strange_files(folder, hints)
    raise InputError(f"{folder}: expected a stereo calibration in it, found {contents}", remedy="calibration")


def _pair_halves(lefts: Sequence[Source], rights: Sequence[Source]) -> Iterator[tuple[Source, Source]]:
    """Halves of one format that belong together by name, or as the only two that there are."""
    if len(lefts) == len(rights) == 1:
        yield lefts[0], rights[0]
        return
    for left in lefts:
        for right in rights:
            if _common_name(left.path) == _common_name(right.path):
                yield left, right


def _strange_files(folder: Path, hints: Mapping[Path, str]) -> str:
    """Description of a folder without a calibration: "none", and why its first files are none."""
    reasons = []
    for file in _files(folder):
        if re.fullmatch(r"(?!.*calib).*\.(csv|txt)|world\.toml", file.name, re.IGNORECASE):
            continue
        why = f"not of a known format{hints.get(file, '')}" if file.stat().st_size else "empty"
        reasons.append(f"{file.name} is {why}")
    return f"none ({', '.join(reasons[:3])})" if reasons else "none"


FORMATS: tuple[Format, ...] = (NATIVE, OPENCV, DEPTHAI, KALIBR, ROS, ZED, KITTI, EUROC, MIDDLEBURY)
WRITTEN: tuple[Format, ...] = tuple(form for form in FORMATS if form.texts is not None)
"""Formats that ``write_rig`` writes; the others are only read."""


def load_rig(
    path: Path,
    size: tuple[int, int] | None = None,
    *,
    cameras: tuple[str, str] | None = None,
    unit_m: float | None = None,
    swap: bool = False,
    rectified: bool | None = None,
) -> StereoRig:
    """Read a stereo calibration in any supported format, recognised by its content. Raises InputError: nothing readable
    there, not a stereo rig, or a rig for another image size.

    Args:
        path: a calibration file (of a pair, either half), or a folder that holds one calibration.
        size: (width, height) of the recording's images [px]: selects a resolution where the file holds several,
            supplies it where it holds none; a calibration of another size and the same aspect is scaled, which
            ``source`` then notes.
        cameras: names of the left and right camera (or sockets) where the file holds more than two.
        unit_m: length of the unit of the file's translations [m]; None: what the format prescribes.
        swap: the file calls the right camera left.
        rectified: whether the images are, where a file holds both calibrations; None decides by their size.
    """
    choice = Choice(size, cameras, unit_m, rectified)
    form, sources = find_rig(path)
    name = "+".join(str(source.path) for source in sources)
    try:
        rig = form.read(sources, choice)
        refuse_strange_camera(rig.left, "left")
        refuse_strange_camera(rig.right, "right")
    except (ValueError, TypeError, LookupError, OverflowError) as error:
        text = " ".join(str(error).split())
        detail = text if text.startswith("expected") else f"expected a calibration, found {text}"
        raise InputError(f"{name} ({form.name}): {detail}") from error
    if swap:
        rig = rig.swapped()
    return fit_rig(rig.check(name), name, size)


def calibration_files(path: Path) -> list[Path]:
    """The files that ``load_rig`` reads a calibration from (same errors)."""
    return [source.path for source in find_rig(path)[1]]


def write_rig(rig: StereoRig, path: Path, format_key: str | None = None, keep: Collection[Path] = ()) -> list[Path]:
    """Write a rig in a format, to a file, or to a folder for formats of two files, and return the files. Raises
    InputError: no such format, a format that cannot hold this rig exactly, a place that cannot be written, or a file to
    be kept.

    Args:
        format_key: ``Format.key``; None takes the first format that writes files of this suffix.
        keep: files that must not be written over.
    """
    form = _form_to_write(path, format_key)
    assert form.texts is not None
    try:
        texts = form.texts(rig, path)
        overwritten = {file.resolve() for file in texts} & {file.resolve() for file in keep}
        if overwritten:
            raise InputError(
                f"{path}: expected another place than the calibration read, found it at {overwritten.pop()}"
            )
        for file, text in texts.items():
            write_whole(file, text)
        return list(texts)
    except ValueError as error:
        raise InputError(f"{path}: expected a rig that {form.name} can hold, but {error}") from error
    except OSError as error:
        raise InputError(f"{path}: expected a place to write to, found {reason(error)}") from error


def _form_to_write(path: Path, key: str | None) -> Format:
    """The format of a key, or the first that writes files of this suffix."""
    suffix = path.suffix.lower()
    for form in WRITTEN:
        if form.key == key or (key is None and suffix and form.suffix == suffix):
            return form
    keys = ", ".join(form.key for form in WRITTEN)
    raise InputError(f"expected a format of {keys}, found {key or path.name!r}", argument="to")


def refuse_strange_camera(camera: Camera, side: str) -> None:
    """Refuse (ValueError) numbers of another image size or unit, and a lens that shows no picture."""
    size = size_text(camera.size)
    # Beyond these multiples of the image width a focal length is in other units (fisheye of 200 deg: 0.2).
    if not 0.1 <= camera.fx / camera.width <= 30.0 or not 0.5 <= camera.fx / camera.fy <= 2.0:
        actual = f"fx={camera.fx:g} fy={camera.fy:g}"
        raise ValueError(f"expected a {side} focal length in pixels of {size}, found {actual}")
    off_x = abs(camera.cx / camera.width - 0.5) - 0.5
    off_y = abs(camera.cy / camera.height - 0.5) - 0.5
    # Share of the image by which a principal point may lie outside of it; crops rarely go further.
    if max(off_x, off_y) > 0.25:
        actual = f"({camera.cx:.1f}, {camera.cy:.1f})"
        raise ValueError(f"expected a {side} principal point inside the image of {size}, found {actual}")
    across = np.linspace(0.25, 0.75, 5) * camera.width
    down = np.linspace(0.25, 0.75, 5) * camera.height
    u, v = (grid.ravel() for grid in np.meshgrid(across, down))
    straight = np.hypot((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    with np.errstate(all="ignore"):
        distorted = np.linalg.norm(camera.unproject(np.column_stack([u, v]))[:, :2], axis=1)
    # Rays through the middle half of an image lie within this factor of where they were without distortion; a fisheye
    # of 200 deg has 2.4.
    most = 10.0
    is_plausible = (distorted <= most * straight + 1e-3) & (straight <= most * distorted + 1e-3)
    if not is_plausible.all():
        shown = ", ".join(f"{k:g}" for k in camera.distortion)
        raise ValueError(f"expected a {side} lens that shows the middle of its image, found distortion ({shown})")


def fit_rig(rig: StereoRig, name: str, size: tuple[int, int] | None) -> StereoRig:
    """Scale a rig to images of a size [px], which must have its aspect. Raises InputError: another aspect, or cameras
    of two sizes; ``name`` is that of the calibration."""
    left = size_text(rig.left.size)
    right = size_text(rig.right.size)
    if left != right:
        raise InputError(f"{name}: expected two cameras of one image size, found {left} and {right}")
    if size is None or size == rig.left.size:
        return rig
    refuse_other_aspect(name, rig.left.size, size)
    return replace(rig.scaled(*size), source=f"{rig.source} (scaled from {left} to {size_text(size)})")


def refuse_other_aspect(name: str, calibrated: tuple[int, int], size: tuple[int, int]) -> None:
    """Refuse (InputError) a calibration for images of another aspect than theirs [px]."""
    if size[0] * calibrated[1] == size[1] * calibrated[0]:
        return
    is_turned = size[0] * calibrated[0] == size[1] * calibrated[1]
    why = "they are turned by 90 degrees, perhaps by their EXIF orientation" if is_turned else "another aspect"
    expected = f"expected a calibration for images of {size_text(size)}, found one for {size_text(calibrated)}"
    raise InputError(f"{name}: {expected} ({why})")
