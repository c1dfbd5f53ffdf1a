"""Calibrations as other tools write them: one file per format, recognised by content."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
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

Found = tuple[Format, tuple[Source, ...]]


def find_rig(path: Path) -> Found:
    """The calibration at a file or in a folder. Raises InputError: none there, half of a pair, or several."""
    if path.is_dir():
        return _in_folder(path)
    source = read_source(path)
    found = _recognise(source)
    if found is None and is_tsai(source):
        raise InputError(f"{path}: expected a stereo calibration, found a single camera (Tsai)")
    if found is None:
        known = ", ".join(f.name for f in FORMATS)
        raise InputError(f"{path}: expected a calibration ({known}), found none of these formats{_nearest(source)}")
    form, part = found
    if part == "whole":
        return form, (source,)
    # EuRoC keeps each half in a folder of its own.
    around = [path.parent]
    if path.parent.name.lower() in {"cam0", "cam1", "left", "right"}:
        around.append(path.parent.parent)
    files = {p.resolve(): p for folder in around for p in _files(folder)}
    files.pop(path.resolve(), None)
    other = "right" if part == "left" else "left"
    mates = [m for m in _readable(files.values()) if form.part(m) == other and _plain(m.path) == _plain(path)]
    if len(mates) != 1:
        missing = ", ".join(form.missing(source)[1])
        raise InputError(
            f"{path}: expected its other half {f'with {missing} ' if missing else ''}next to it ({form.name}), "
            f"found {len(mates) or 'no'} file that fits"
        )
    return form, ((source, mates[0]) if part == "left" else (mates[0], source))


def _recognise(source: Source) -> tuple[Format, str] | None:
    """The format that a text has, by most keys of those that it may have."""
    found = [(form, part) for form in FORMATS if (part := form.part(source))]
    return max(found, key=lambda one: one[0].missing(source)[0], default=None)


def _nearest(source: Source) -> str:
    """What the format of which a text holds most keys also needs; empty where it holds none of any."""
    form = max(FORMATS, key=lambda form: form.missing(source)[0])
    held, missing = form.missing(source)
    lacks = ", ".join(missing) or "left or right in the file's name"
    return f"; for {form.name} it lacks {lacks}" if held else ""


def _files(folder: Path) -> Iterator[Path]:
    """Small files of the folder and of its usual camera folders."""
    for place in filter(Path.is_dir, (folder, *(folder / name for name in _NESTED))):
        for path in entries(place):
            if path.suffix.lower() in _SUFFIXES and path.is_file() and path.stat().st_size <= MAX_BYTES:
                yield path


def _readable(paths: Iterable[Path]) -> Iterator[Source]:
    for path in paths:
        with suppress(InputError):  # folders hold more than calibrations; a file that is not text is none
            yield read_source(path)


def _plain(path: Path) -> str:
    """The name without what may differ between two halves, a word such as left/right."""
    name = f"{path.parent.name}/{path.name}".lower()
    for first, second in _PAIRS:
        name = name.replace(first, "*").replace(second, "*")
    return name


def _in_folder(folder: Path) -> Found:
    rigs: list[Found] = []
    halves: list[tuple[Format, str, Source]] = []
    lacking: dict[Path, str] = {}
    for source in _readable(_files(folder)):
        match _recognise(source):
            case (form, "whole"):
                rigs.append((form, (source,)))
            case (form, part):
                halves.append((form, part, source))
            case None:
                lacking[source.path] = _nearest(source)
    # Halves of one format pair by name, or as the only two that there are.
    for form in dict.fromkeys(form for form, _, _ in halves):
        lefts, rights = ([s for f, part, s in halves if (f, part) == (form, one)] for one in ("left", "right"))
        only = len(lefts) == len(rights) == 1
        rigs += [(form, (a, b)) for a in lefts for b in rights if only or _plain(a.path) == _plain(b.path)]
    rigs = [rig for rig in rigs if rig[0] is NATIVE] or rigs
    if len(rigs) == 1:
        return rigs[0]
    if not rigs:
        seen = [
            f"{file.name} is {'not of a known format' + lacking.get(file, '') if file.stat().st_size else 'empty'}"
            for file in _files(folder)
            if file.suffix.lower() not in (".csv", ".txt") and file.name != "world.toml"
        ]
        what = next(filter(None, map(arrays_text, entries(folder))), "none" + f" ({', '.join(seen[:3])})" * bool(seen))
        what = f"only half of a pair ({halves[0][2].path.name})" if halves else what
        what = closed_text(_files(folder)) or what
        raise InputError(f"{folder}: expected a stereo calibration in it, found {what}", remedy="calibration")
    names = ", ".join("+".join(s.path.name for s in sources) for _, sources in rigs[:4])
    raise InputError(f"{folder}: expected one calibration in it, found {len(rigs)} ({names}): name the file")


FORMATS: tuple[Format, ...] = (NATIVE, OPENCV, DEPTHAI, KALIBR, ROS, ZED, KITTI, EUROC, MIDDLEBURY)
WRITTEN: tuple[Format, ...] = tuple(form for form in FORMATS if form.texts is not None)
"""Those that ``write_rig`` writes; the others are only read."""

__all__ = ["FORMATS", "WRITTEN", "calibration_files", "fitted", "load_rig", "refuse_strange_camera", "write_rig"]


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
    found, sources = find_rig(path)
    name = "+".join(str(source.path) for source in sources)
    try:
        rig = found.read(sources, choice)
        refuse_strange_camera(rig.left, "left")
        refuse_strange_camera(rig.right, "right")
    except (ValueError, TypeError, LookupError, OverflowError) as error:
        text = " ".join(str(error).split())
        detail = text if text.startswith("expected") else f"expected a calibration, found {text}"
        raise InputError(f"{name} ({found.name}): {detail}") from error
    return fitted((rig.swapped() if swap else rig).check(name), name, size)


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
    keys = ", ".join(f.key for f in WRITTEN)
    suffix = path.suffix.lower()
    matches = (f for f in WRITTEN if (f.key == format_key if format_key else suffix and f.suffix == suffix))
    if (chosen := next(matches, None)) is None or chosen.texts is None:
        problem = f"the name of a format ({keys}), because none has the suffix of {path.name!r}"
        raise InputError(f"{path}: expected {f'a format of {keys}, found {format_key!r}' if format_key else problem}")
    try:
        texts = chosen.texts(rig, path)
        if kept := {file.resolve() for file in texts} & {file.resolve() for file in keep}:
            raise InputError(f"{path}: expected another place than the calibration read, found it at {kept.pop()}")
        for file, text in texts.items():
            write_whole(file, text)
        return list(texts)
    except ValueError as error:
        raise InputError(f"{path}: expected a rig that {chosen.name} can hold, but {error}") from error
    except OSError as error:
        raise InputError(f"{path}: expected a place to write to, found {reason(error)}") from error


def refuse_strange_camera(one: Camera, side: str) -> None:
    """Refuse (ValueError) numbers of another image size or unit, and a lens that shows no picture."""
    # Beyond these multiples of the image width a focal length is in other units (fisheye of 200 deg: 0.2).
    if not 0.1 <= one.fx / one.width <= 30.0 or not 0.5 <= one.fx / one.fy <= 2.0:
        raise ValueError(
            f"expected a {side} focal length in pixels of {one.width}x{one.height}, found fx={one.fx:g} fy={one.fy:g}"
        )
    off = max(abs(one.cx / one.width - 0.5), abs(one.cy / one.height - 0.5)) - 0.5
    # Share of the image by which a principal point may lie outside of it; crops rarely go further.
    if off > 0.25:
        raise ValueError(
            f"expected a {side} principal point inside the image of {one.width}x{one.height}, "
            f"found ({one.cx:.1f}, {one.cy:.1f})"
        )
    u, v = (grid.ravel() for grid in np.meshgrid(*(np.linspace(0.25, 0.75, 5) * length for length in one.size)))
    straight = np.hypot((u - one.cx) / one.fx, (v - one.cy) / one.fy)
    with np.errstate(all="ignore"):
        distorted = np.linalg.norm(one.unproject(np.column_stack([u, v]))[:, :2], axis=1)
    # Rays through the middle half of an image lie within this factor of where they were without distortion; a fisheye
    # of 200 deg has 2.4.
    most = 10.0
    if not ((distorted <= most * straight + 1e-3) & (straight <= most * distorted + 1e-3)).all():
        shown = ", ".join(f"{k:g}" for k in one.distortion)
        raise ValueError(f"expected a {side} lens that shows the middle of its image, found distortion ({shown})")


def fitted(rig: StereoRig, name: str, size: tuple[int, int] | None) -> StereoRig:
    """The rig for images of a size [px], which must have its aspect. Raises InputError: another aspect, or cameras of
    two sizes; ``name`` is that of the calibration."""
    own = size_text(rig.left.size)
    other = size_text(rig.right.size)
    if own != other:
        raise InputError(f"{name}: expected two cameras of one image size, found {own} and {other}")
    if size is None or size == rig.left.size:
        return rig
    refuse_other_aspect(name, rig.left.size, size)
    return replace(rig.scaled(*size), source=f"{rig.source} (scaled from {own} to {size_text(size)})")


def refuse_other_aspect(name: str, own: tuple[int, int], size: tuple[int, int]) -> None:
    """Refuse (InputError) a calibration of images of another aspect than theirs [px]."""
    if size[0] * own[1] != size[1] * own[0]:
        turned = size[0] * own[0] == size[1] * own[1]
        why = "they are turned by 90 degrees, perhaps by their EXIF orientation" if turned else "another aspect"
        expected = f"expected a calibration for images of {size_text(size)}, found one for {size_text(own)}"
        raise InputError(f"{name}: {expected} ({why})")
