"""Keys: what a result depends on, as a short text that is equal exactly when nothing of it changed."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import calib
import planview
import stereo
from calib.errors import InputError
from calib.io import reason

WHOLE_MAX = 256 * 1024
"""Files up to this size are hashed whole [bytes]."""
BLOCK = 64 * 1024
BLOCKS = 16
"""Of larger files so many blocks are hashed, evenly spread, the first and the last among them."""
FILES_MAX = 64
"""Of so many image files at most the content is hashed; of all others name and size."""
ENGINE_ROOMS = ("foreground", "maps", "trajectories", "tracking", "pipeline")
"""Rooms of planview whose code decides tracks."""
_IMAGES = frozenset((".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp", ".bin", ".raw"))
_TRUTH = frozenset(("truth.csv", "gt.txt"))
_BESIDE = frozenset((".yml", ".yaml", ".json", ".xml", ".conf"))
_TABLES = frozenset(("rig.toml", "world.toml", "camera.toml", "timestamps.csv"))
_OUTPUTS = ("run.json", "study.json")


def key_of(*parts: object) -> str:
    """32 hexadecimal digits for JSON values."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]


def content_key(path: Path) -> str:
    """Of a recording's file or folder: names, sizes and sampled content, not its place or times.

    Truth, hidden files and folders with results are left out: they do not change what is tracked. Small files count
    whole; of larger ones BLOCKS blocks, of folders with more than FILES_MAX images every n-th image. A change that
    keeps every size and lies between all samples is not noticed.

    Raises:
        InputError: no such file, or it cannot be read.
    """
    try:
        if path.is_file():
            return key_of(_file_digest(path))
        if not path.is_dir():
            raise InputError(f"{path}: expected a recording, found no such file or folder")
        files = sorted(_files(path), key=lambda file: file.relative_to(path).as_posix())
        images = [file for file in files if file.suffix.lower() in _IMAGES]
        hashed = set(files) - set(images) | set(images[:: max(1, -(-len(images) // FILES_MAX))])
        listed = [[*_name_and_size(file, path), _file_digest(file) if file in hashed else ""] for file in files]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason(error)})") from error
    return key_of(listed)


def files_beside(path: Path) -> list[Path]:
    """Files that may belong to a recording of a single file: calibrations, times and poses in its folder."""
    if path.is_dir():
        return []
    files = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    known = [file for file in files if file.suffix.lower() in _BESIDE or file.name in _TABLES]
    return [file for file in known if file.name not in (path.name, *_TRUTH) and file.is_file()]


@cache
def engine_version() -> str:
    """Version of the package and a digest of the code that decides tracks."""
    roots = [Path(package.__file__ or "").parent for package in (calib, stereo)]
    roots += [Path(planview.__file__ or "").parent / room for room in ENGINE_ROOMS]
    digest = hashlib.sha256()
    for root in roots:
        for file in sorted(root.rglob("*.py")):
            digest.update(file.relative_to(root.parent).as_posix().encode() + file.read_bytes())
    try:
        number = version("planview")
    except PackageNotFoundError:
        number = "source"
    return f"{number}-{digest.hexdigest()[:16]}"


def _files(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".") and not _is_output(Path(parent, name))]
        for name in names:
            if not name.startswith(".") and name not in _TRUTH and Path(parent, name).is_file():
                yield Path(parent, name)


def _is_output(folder: Path) -> bool:
    return any((folder / name).is_file() for name in _OUTPUTS)


def _name_and_size(file: Path, folder: Path) -> tuple[str, int]:
    return os.fsencode(file.relative_to(folder)).hex(), file.stat().st_size


def _file_digest(path: Path) -> str:
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        if size <= WHOLE_MAX:
            digest.update(file.read(WHOLE_MAX))
        else:
            for block in range(BLOCKS):
                file.seek((size - BLOCK) * block // (BLOCKS - 1))
                digest.update(file.read(BLOCK))
    return digest.hexdigest()
