"""What a run and the run that goes on after it must share, so that their tracks are those of one run."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import planview
from planview.engine.engine import Engine
from planview.output.checkpoint.encode import encode

LIBRARIES = ("numpy", "opencv-python-headless", "scipy", "numba")
SMALL_BYTES = 256 * 1024
"""Files up to this size (calibrations, timestamps) are compared by their content, larger ones by name and size: frames
are too many to be read twice (our choice)."""


def identity_of(engine: Engine, settings: dict[str, Any], folder: Path) -> dict[str, Any]:
    """What decides the tracks of a run: code, configuration, recording and settings, as JSON.

    Args:
        settings: of the run, besides the configuration.
        folder: of its results, which may lie in the recording's.
    """
    recording = engine.recording
    camera, floor = engine.camera_info(), engine.floor_info()
    return {
        "version": {"planview": _code(), "python": platform.python_version()} | _libraries(),
        "configuration": engine.config.model_dump(mode="json"),
        "recording": {
            "files": _content(recording.path, folder),
            "frames": recording.n_frames,
            "fps": recording.fps,
            "camera": camera and camera.model_dump(mode="json"),
            "floor": floor and floor.model_dump(mode="json"),
        },
        "settings": settings,
    }


def difference(found: dict[str, Any], expected: dict[str, Any]) -> str:
    """The first part in which two identities differ, in words; empty when they are the same."""
    for part in ("version", "configuration", "recording", "settings"):
        a, b = found.get(part, {}), expected.get(part, {})
        names = [name for name in sorted({*a, *b}) if a.get(name) != b.get(name)]
        if names:
            return f"another {part} ({', '.join(names[:4])})"
    return ""


@cache
def _code() -> str:
    """Version and digest of all code: the same tracks are promised by the same code only."""
    digest = hashlib.sha256()
    root = Path(planview.__file__).resolve().parent.parent
    for path in sorted(path for package in ("calib", "stereo", "planview") for path in (root / package).rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{version('planview')} ({digest.hexdigest()[:12]})"


def _libraries() -> dict[str, str]:
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ""
    return found


def digest_of(values: Mapping[str, object]) -> str:
    """Digest of objects that a checkpoint can hold."""
    encoded = encode(values)
    digest = hashlib.sha256(json.dumps([encoded.roots, encoded.nodes]).encode())
    for block in encoded.blocks:
        digest.update(block.tobytes())
    return digest.hexdigest()[:16]


def _content(path: Path, results: Path) -> str:
    """Digest of the names and sizes of a recording's files, and of what small files hold; results are none of these."""
    digest = hashlib.sha256()
    for file in [path] if path.is_file() else sorted(_files(path, results.resolve())):
        size = file.stat().st_size
        name = Path(file.name) if path.is_file() else file.relative_to(path)
        digest.update(os.fsencode(name) + b"\0%d\0" % size)
        if size <= SMALL_BYTES and file.suffix.lower() in _TEXT_SUFFIXES:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _files(folder: Path, results: Path) -> Iterator[Path]:
    """All files below a folder, but no results of runs."""
    if folder.resolve() == results or (folder / "run.json").is_file() or not folder.is_dir():
        return
    for path in folder.iterdir():
        if path.is_dir():
            yield from _files(path, results)
        elif path.is_file():
            yield path


_TEXT_SUFFIXES = frozenset({".csv", ".toml", ".yml", ".yaml", ".json", ".txt", ".conf", ".xml"})
