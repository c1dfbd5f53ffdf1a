"""Identity of a run, and checkpoints: where an interrupted run resumes.

A checkpoint holds plain values (``calib.carried``) as JSON and arrays, no code and no classes.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from fnmatch import translate
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import planview
from calib.errors import InputError
from calib.io import PART, reason, refuse_missing, whole_file
from calib.types import AnyArray
from planview.engine.engine import Engine
from planview.output.folder import LOCK_NAME, PRODUCTS, HoldsResultsError, RunInfo, products_in, read_run_info, writing
from planview.output.tables import is_as_marked
from stereo.readers.images import SUFFIXES


class UnidentifiedError(InputError):
    """A part of a run cannot be identified, so that the run cannot be resumed."""


def part_name(part: object) -> str:
    """A file, or the class of a part that the user made (of a function its name), with its ``identity`` if any."""
    if isinstance(part, str | Path):
        return os.fspath(part)
    name = str(getattr(part, "__name__", type(part).__name__))
    identity = getattr(part, "identity", "")
    return f"{name} {identity}" if identity else name


def refuse_unidentified(engine: Engine) -> None:
    """Raise UnidentifiedError for parts that the user made without an ``identity``, and a recording without files."""
    for role, part in engine.own_parts.items():
        if not getattr(part, "identity", ""):
            raise UnidentifiedError(
                f"the {role} {part_name(part)} has no attribute 'identity', a text that changes whenever its results "
                "would: a run cannot be resumed without it"
            )
    if not engine.recording.files:
        raise UnidentifiedError(f"{engine.recording.path}: a recording without files cannot be resumed")


def known_identity(info: RunInfo) -> dict[str, dict[str, Any]]:
    """The parts of a run's identity that run.json holds."""
    values = info.model_dump(mode="json")
    camera = values["rig"]
    for one in [camera, *camera["sensors"]] if camera else []:
        del one["calibration"]  # a copy elsewhere is the same
    if values["floor"]:
        del values["floor"]["source"]
    return {
        "configuration": values["config"],
        "part": values["own_parts"],
        "recording": {"fps": info.fps, "size_px": values["size_px"], "camera": camera, "floor": values["floor"]},
        "settings": {"tracker": info.tracker, "first_frame": info.first_frame},
    }


def difference(found: Mapping[str, Any], expected: Mapping[str, Any]) -> str:
    """The first part in which two identities differ, in words; empty when they are the same."""
    for part in ("version", "configuration", "part", "recording", "settings"):
        a = found.get(part, {})
        b = expected.get(part, {})
        names = [name for name in sorted({*a, *b}) if a.get(name) != b.get(name)]
        if names:
            return f"another {part} ({', '.join(names[:4])})"
    return ""


@cache
def code_version() -> str:
    """Version and digest of all code: the same tracks are promised by the same code only."""
    digest = hashlib.sha256()
    root = Path(planview.__file__).resolve().parent.parent
    files = [path for package in ("calib", "stereo", "planview") for path in (root / package).rglob("*.py")]
    for path in sorted(files):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{library_versions().get('planview', 'source')}-{digest.hexdigest()[:16]}"


def library_versions() -> dict[str, str]:
    """Versions of Python, planview and the libraries that matter, as far as they are installed."""
    versions = {"python": platform.python_version()}
    for name in ("planview", "numpy", "opencv-python-headless", "scipy", "open3d", "numba"):
        with suppress(PackageNotFoundError):  # OpenCV comes under several names
            versions[name] = version(name)
    return versions


_NO_CONTENT = re.compile("|".join(map(translate, ("truth.csv", "gt.txt", ".*", LOCK_NAME, *PRODUCTS))))
IMAGES_SAMPLED = 64
BLOCKS_SAMPLED = 16
BLOCK_BYTES = 64 * 1024
WHOLE_BYTES = 256 * 1024
"""Largest file that is read whole for a digest of a recording."""


def content_key(path: Path, files: Sequence[Path] | None = None) -> str:
    """Digest of a recording: names, sizes and sampled content of its files, or where none are given of all at a path,
    without truth, hidden files, and results of runs and studies.

    Of a large file 16 blocks count, and at most 64 images: a change that keeps every size and lies between all samples
    is not noticed. Raises InputError: no such file, or it cannot be read.
    """
    try:
        if files is None:
            files = sorted(_files_in(path))
        images = [file for file in files if file.suffix.lower() in SUFFIXES]
        step = max(1, math.ceil(len(images) / IMAGES_SAMPLED))
        left_out = set(images) - set(images[::step])
        contents = []
        for file in files:
            sample = "" if file in left_out else _sample_digest(file)
            contents.append([os.path.relpath(file, path), file.stat().st_size, sample])
        return key_of(contents)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason(error)})") from error


def key_of(*parts: object) -> str:
    """32 hexadecimal digits for JSON values, and for arrays and dataclasses of these."""
    return hashlib.sha256(json.dumps(parts, default=_contents, sort_keys=True).encode()).hexdigest()[:32]


def _contents(value: Any) -> object:
    """The digest of an array and the fields of a dataclass; all else in words."""
    if isinstance(value, np.ndarray):
        return [value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()]
    if is_dataclass(value):
        return [type(value).__name__, *(getattr(value, field.name) for field in fields(value))]
    return repr(value)


def _files_in(path: Path) -> Iterator[Path]:
    """A file, or the files of a folder, in which links may lead back: each real folder counts once."""
    if path.is_file():
        yield path
    refuse_missing(path)
    visited: set[str] = set()
    for parent, folders, names in os.walk(path, followlinks=True):
        place = os.path.realpath(parent)
        if place in visited:
            folders.clear()
            continue
        visited.add(place)
        folders[:] = sorted(name for name in folders if not _holds_results(Path(parent, name)))
        for name in names:
            if not _NO_CONTENT.match(name) and Path(parent, name).is_file():
                yield Path(parent, name)


def _holds_results(folder: Path) -> bool:
    """A hidden folder, or one of a run or a study."""
    return folder.name.startswith(".") or (folder / "run.json").is_file() or (folder / "study.json").is_file()


def _sample_digest(path: Path) -> str:
    """Digest of a small file, or of evenly spread blocks of a larger one, the first and the last among them."""
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        if size <= WHOLE_BYTES:
            digest.update(file.read())
        else:
            for block in range(BLOCKS_SAMPLED):
                file.seek((size - BLOCK_BYTES) * block // (BLOCKS_SAMPLED - 1))
                digest.update(file.read(BLOCK_BYTES))
    return digest.hexdigest()


CHECKPOINT = "checkpoint.npz"


class Checkpoint(NamedTuple):
    """The identity that the resumed run must share, the size of every table and the positions of logs, and the state of
    the engine, the counts and the totals."""

    identity: dict[str, Any]
    written: dict[str, Any]
    state: dict[str, Any]


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint in the place of the one before. Raises WorkError: it cannot be written, and that is kept."""
    arrays: dict[str, Any] = {}

    def name_of(array: AnyArray) -> dict[str, str]:
        name = f"array{len(arrays)}"
        arrays[name] = array
        return {"<array>": name}

    document = json.dumps(checkpoint, default=name_of)
    path = folder / CHECKPOINT
    with writing(path), whole_file(path) as part, part.open("wb") as file:
        np.savez(file, document=np.frombuffer(document.encode(), dtype=np.uint8), **arrays)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint, whose archive holds checksums; raises what numpy does with one that is damaged."""
    with np.load(path, allow_pickle=False) as file:

        def array_or_object(value: dict[str, Any]) -> Any:
            return file[value["<array>"]] if "<array>" in value else value

        return Checkpoint(*json.loads(file["document"].tobytes(), object_hook=array_or_object))


def remove_checkpoint(folder: Path) -> None:
    """A finished run needs none, nor the parts of its maps between them."""
    for path in [folder / CHECKPOINT, folder / (CHECKPOINT + PART), *folder.glob("maps-[0-9]*.h5")]:
        path.unlink(missing_ok=True)


def checkpoint_of(folder: Path, identity: dict[str, Any]) -> Checkpoint | None:
    """The checkpoint in a folder; None, with a warning, where the run starts from the first frame, since it was
    interrupted before its first checkpoint, or this is damaged, or a table was changed since.

    Args:
        identity: of the run to resume.
    Raises:
        HoldsResultsError: the checkpoint, or what is in the folder, is of another run.
    """
    path = folder / CHECKPOINT
    if path.is_file():
        checkpoint = _usable_checkpoint(path, identity)
        if checkpoint is not None:
            return checkpoint
    products = products_in(folder)
    if not all(product.name.endswith(PART) for product in products):
        refuse_another_run(folder, identity)
    if products:
        warnings.warn(f"{folder}: no checkpoint to resume from; the run starts again", stacklevel=2)
    return None


def _usable_checkpoint(path: Path, identity: dict[str, Any]) -> Checkpoint | None:
    """A checkpoint, unless it is damaged or a table was changed since. Raises HoldsResultsError: of another run."""
    try:
        checkpoint = read_checkpoint(path)
    except Exception as error:  # the library raises whatever a damaged file provokes
        warnings.warn(f"{path}: the checkpoint is damaged ({error})", stacklevel=3)
        return None
    other = difference(checkpoint.identity, identity)
    if other:
        raise HoldsResultsError(f"{path}: cannot resume: the checkpoint is of {other}")
    for name, mark in checkpoint.written["tables"].items():
        if not is_as_marked(path.with_name(name), *mark):
            warnings.warn(f"{path.with_name(name)}: changed since {path.name} was written", stacklevel=3)
            return None
    return checkpoint


def refuse_another_run(folder: Path, identity: dict[str, Any]) -> None:
    """Raise HoldsResultsError where the run.json of a folder describes another run."""
    file = folder / "run.json"
    begun = known_identity(read_run_info(file) if file.is_file() else RunInfo())
    expected = {part: {name: identity[part].get(name) for name in begun[part]} for part in begun}
    other = difference(begun, expected | {"part": identity["part"]})
    if other:
        raise HoldsResultsError(f"{folder}: cannot resume: it holds a run with {other}")
