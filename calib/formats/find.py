"""Which files at a path make up one calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from calib.errors import InputError
from calib.formats.base import Format, Source, read_source
from calib.io import MAX_BYTES

_SUFFIXES = {".toml", ".yml", ".yaml", ".xml", ".json", ".conf", ".txt", ".cfg", ".ini", ".calib", ""}
_PAIRS = (("left", "right"), ("intrinsic", "extrinsic"), ("cam0", "cam1"), ("_l", "_r"))
_NESTED = ("cam0", "cam1", "left", "right", "mav0/cam0", "mav0/cam1")

Found = tuple[Format, tuple[Source, ...]]


def find_rig(path: Path, formats: Sequence[Format], is_single: Callable[[Source], bool]) -> Found:
    """The calibration at a file or in a folder.

    Args:
        is_single: recognises files that hold one camera, for a better message.
    Raises:
        InputError: none there, half of a pair, or several.
    """
    if path.is_dir():
        return _in_folder(path, formats)
    source = read_source(path)
    found = _recognise(source, formats)
    if found is None and is_single(source):
        raise InputError(f"{path}: expected a stereo calibration, found a single camera (Tsai)")
    if found is None:
        raise InputError(
            f"{path}: expected a calibration ({', '.join(f.name for f in formats)}), found none of these formats"
        )
    form, part = found
    if part == "whole":
        return form, (source,)
    mates = [mate for mate in _candidates(path, form) if _belongs(source, mate)]
    other = "right" if part == "left" else "left"
    mates = [mate for mate in mates if form.part(mate) == other]
    if len(mates) != 1:
        raise InputError(
            f"{path}: expected its other half beside it ({form.name}), found {len(mates) or 'no'} file that fits"
        )
    return form, ((source, mates[0]) if part == "left" else (mates[0], source))


def _recognise(source: Source, formats: Iterable[Format]) -> tuple[Format, str] | None:
    for form in formats:
        if part := form.part(source):
            return form, part
    return None


def _files(folder: Path) -> Iterator[Path]:
    """Small files of the folder and of its usual camera folders."""
    for place in (folder, *(folder / name for name in _NESTED)):
        if not place.is_dir():
            continue
        for path in sorted(place.iterdir()):
            if path.suffix.lower() in _SUFFIXES and path.is_file() and path.stat().st_size <= MAX_BYTES:
                yield path


def _readable(paths: Iterable[Path]) -> Iterator[Source]:
    for path in paths:
        try:
            yield read_source(path)
        except InputError:
            # Anything may lie beside a calibration; what is no text is none.
            continue


def _candidates(path: Path, form: Format) -> list[Source]:
    # EuRoC keeps each half in a folder of its own.
    around = [path.parent]
    if path.parent.name.lower() in {"cam0", "cam1", "left", "right"}:
        around.append(path.parent.parent)
    files = {p.resolve(): p for folder in around for p in _files(folder)}
    files.pop(path.resolve(), None)
    return [source for source in _readable(files.values()) if form.part(source)]


def _belongs(one: Source, other: Source) -> bool:
    """Do two names differ only by a word such as left/right?"""
    return _plain(one.path) == _plain(other.path)


def _plain(path: Path) -> str:
    name = f"{path.parent.name}/{path.name}".lower()
    for first, second in _PAIRS:
        name = name.replace(first, "*").replace(second, "*")
    return name


def _in_folder(folder: Path, formats: Sequence[Format]) -> Found:
    rigs: list[Found] = []
    halves: list[tuple[Format, str, Source]] = []
    for source in _readable(_files(folder)):
        match _recognise(source, formats):
            case (form, "whole"):
                rigs.append((form, (source,)))
            case (form, part):
                halves.append((form, part, source))
    rigs += _paired(halves)
    own = [rig for rig in rigs if rig[0].name == formats[0].name]
    rigs = own or rigs
    if len(rigs) == 1:
        return rigs[0]
    if not rigs:
        what = f"only half of a pair ({halves[0][2].path.name})" if halves else "none"
        raise InputError(f"{folder}: expected a stereo calibration in it, found {what}")
    names = ", ".join("+".join(s.path.name for s in sources) for _, sources in rigs[:4])
    raise InputError(f"{folder}: expected one calibration in it, found {len(rigs)} ({names}): name the file")


def _paired(halves: Sequence[tuple[Format, str, Source]]) -> list[Found]:
    """Match halves of one format: by name, or as the only two there are."""
    rigs: list[Found] = []
    for form in {form.name: form for form, _, _ in halves}.values():
        lefts = [s for f, part, s in halves if f.name == form.name and part == "left"]
        rights = [s for f, part, s in halves if f.name == form.name and part == "right"]
        if len(lefts) == len(rights) == 1:
            rigs.append((form, (lefts[0], rights[0])))
            continue
        rigs += [(form, (a, b)) for a in lefts for b in rights if _belongs(a, b)]
    return rigs
