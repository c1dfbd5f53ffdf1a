"""``planview run --resume``: checkpoint files, and from where an interrupted run goes on."""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import re
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from fnmatch import translate
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import joblib
import numpy as np
from pydantic import BaseModel, Field, ValidationError

import planview
from calib.errors import InputError, WorkError
from calib.io import PART, reason, whole_file
from calib.params import first_problem
from calib.types import U8
from planview.output.folder import LOCK_NAME, PRODUCTS, products_in, read_run_info
from planview.output.memory import Encoded
from planview.output.tables import FilePosition, holds


def difference(found: dict[str, Any], expected: dict[str, Any]) -> str:
    """The first part in which two identities differ, in words; empty when they are the same."""
    for part in ("version", "configuration", "recording", "settings"):
        a, b = found.get(part, {}), expected.get(part, {})
        names = [name for name in sorted({*a, *b}) if a.get(name) != b.get(name)]
        if names:
            return f"another {part} ({', '.join(names[:4])})"
    return ""


@cache
def code_version() -> str:
    """Version and digest of all code: the same tracks are promised by the same code only."""
    digest = hashlib.sha256()
    root = Path(planview.__file__).resolve().parent.parent
    for path in sorted(path for package in ("calib", "stereo", "planview") for path in (root / package).rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{library_versions().get('planview', 'source')}-{digest.hexdigest()[:16]}"


def library_versions() -> dict[str, str]:
    """Of Python, planview and the libraries that matter, as far as they are installed."""
    found = {"python": platform.python_version()}
    for name in ("planview", "numpy", "opencv-python-headless", "scipy", "open3d", "numba"):
        with suppress(PackageNotFoundError):  # OpenCV comes under several names
            found[name] = version(name)
    return found


def calibration_key(recording: Any) -> str:
    """Digest of what a recording was opened with, besides its images: cameras and times of every rig, by number."""
    parts = []
    for one in getattr(recording, "rigs", [None]):
        opened = recording if one is None else one.recording
        rig = getattr(opened, "rig", None)
        known = [getattr(opened, name, None) for name in ("camera", "sensor", "times_s")]
        parts.append([rig and replace(rig, source=""), *known, getattr(one, "start_s", 0.0)])
    return str(joblib.hash(parts))


_IMAGES = frozenset((".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp", ".bin", ".raw"))
_NO_CONTENT = re.compile("|".join(map(translate, ("truth.csv", "gt.txt", ".*", LOCK_NAME, *PRODUCTS))))
_TEXTS = frozenset((
    "", ".csv", ".toml", ".yml", ".yaml", ".json", ".txt", ".conf", ".xml", ".md", ".rst", ".html", ".pdf", ".log",
))  # fmt: skip


def content_key(path: Path, *, texts: bool = True) -> str:
    """Of a recording's file or folder: names, sizes and sampled content, not its place or times.

    Truth, hidden files and results of runs and studies are left out: they do not change what is tracked. Of a large
    file 16 blocks count, of a folder's images at most 64: a change that keeps every size and lies between all samples
    is not noticed.

    Args:
        texts: with calibrations, times and other files of text in a folder.
    Raises:
        InputError: no such file, or it cannot be read.
    """
    try:
        if path.is_file():
            return key_of(_sampled(path))
        if not path.is_dir():
            raise InputError(f"{path}: expected a recording, found no such file or folder")
        files = sorted(_content(path), key=lambda file: file.relative_to(path).as_posix())
        files = [file for file in files if texts or file.suffix.lower() not in _TEXTS]
        images = [file for file in files if file.suffix.lower() in _IMAGES]
        sampled = set(files) - set(images) | set(images[:: -(-len(images) // 64) or 1])
        return key_of(
            [
                [
                    os.fsencode(file.relative_to(path)).hex(),
                    file.stat().st_size,
                    _sampled(file) if file in sampled else "",
                ]
                for file in files
            ]
        )
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason(error)})") from error


def key_of(*parts: object) -> str:
    """32 hexadecimal digits for JSON values."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]


def _content(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder, followlinks=True):
        folders[:] = [
            name for name in folders
            if not name.startswith(".") and not any(Path(parent, name, f).is_file() for f in ("run.json", "study.json"))
        ]  # fmt: skip
        for name in names:
            if not _NO_CONTENT.match(name) and Path(parent, name).is_file():
                yield Path(parent, name)


def _sampled(path: Path, whole_bytes: int = 256 * 1024, block_bytes: int = 64 * 1024) -> str:
    """Digest of a small file, or of evenly spread blocks of a larger one, the first and the last among them."""
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        for block in range(16) if size > whole_bytes else (0,):
            file.seek((size - block_bytes) * block // 15 if block else 0)
            digest.update(file.read(block_bytes if size > whole_bytes else whole_bytes))
    return digest.hexdigest()


LATEST, PREVIOUS = "checkpoint.npz", "checkpoint.previous.npz"
DIGEST_BYTES = 32
"""After the archive its digest, so that nothing is taken from a file that was changed."""


_Size = Annotated[int, Field(ge=0, lt=2**63)]


class _Written(BaseModel, strict=True):
    """Position in every table (``FilePosition``) and log."""

    tables: dict[Annotated[str, Field(pattern=r"^\w+\.csv$")], tuple[_Size, _Size]]
    logs: dict[str, dict[str, _Size]]


class _Document(BaseModel, strict=True):
    """What a checkpoint holds besides memory."""

    format: Literal[2]
    """Changes when an older reader would misunderstand the file."""
    identity: dict[str, dict[str, Any]]
    written: _Written
    roots: dict[str, Any]
    nodes: list[list[Any]]


class Checkpoint(NamedTuple):
    """What a checkpoint file holds.

    Attributes:
        identity: of the run, which a run that goes on must share (``planview.output.resume``).
        written: position in every output file, by name.
        memory: of the engine, the counts and the progress.
    """

    identity: dict[str, Any]
    written: dict[str, Any]
    memory: Encoded


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Write the latest checkpoint; the one before becomes the previous one.

    Raises:
        WorkError: the disk is full or the file cannot be written; earlier checkpoints are kept.
    """
    document = {
        "format": 2, "identity": checkpoint.identity, "written": checkpoint.written,
        "roots": checkpoint.memory.roots, "nodes": checkpoint.memory.nodes,
    }  # fmt: skip
    text = np.frombuffer(json.dumps(document).encode(), dtype=np.uint8)
    blocks: dict[str, Any] = {f"block{n}": block for n, block in enumerate(checkpoint.memory.blocks)}
    path = folder / LATEST
    archive = io.BytesIO()
    np.savez(archive, document=text, **blocks)
    data = archive.getvalue()
    try:
        with whole_file(path) as part:
            part.write_bytes(data + _digest(data))
            if path.exists():
                os.replace(path, folder / PREVIOUS)
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)})") from error


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises:
        ValueError: damaged, cut short, or of another format.
    """
    try:
        data = path.read_bytes()
        data, digest = data[:-DIGEST_BYTES], data[-DIGEST_BYTES:]
        if _digest(data) != digest:
            raise ValueError("not as it was written")
        with zipfile.ZipFile(
            io.BytesIO(data)
        ) as archive:  # blocks are stored as they are: none is larger than the file
            if sum(info.file_size for info in archive.infolist()) > len(data):
                raise ValueError("blocks larger than the file")
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            document = _Document.model_validate_json(file["document"].tobytes())
            blocks: list[U8] = [file[f"block{n}"] for n in range(len(file.files) - 1)]
        memory = Encoded(document.roots, document.nodes, blocks)
        return Checkpoint(document.identity, document.written.model_dump(), memory)
    except ValidationError as error:
        raise ValueError(first_problem(error)) from error
    except (OSError, KeyError, TypeError, AttributeError, EOFError, RecursionError, zipfile.BadZipFile) as error:
        raise ValueError(" ".join(str(error).split()) or type(error).__name__) from error


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES).digest()


def checkpoints_in(folder: Path) -> Iterator[Path]:
    """The checkpoints of a folder, the latest first."""
    return (folder / name for name in (LATEST, PREVIOUS) if (folder / name).is_file())


def remove_checkpoints(folder: Path) -> None:
    """A finished run needs none, nor the parts of its maps between them."""
    for path in [*checkpoints_in(folder), folder / (LATEST + PART), *folder.glob("maps-[0-9]*.h5")]:
        path.unlink(missing_ok=True)


def checkpoint_of(folder: Path, identity: dict[str, Any], tell: Callable[[str], None]) -> Checkpoint | None:
    """The last checkpoint in a folder that can be gone on from; None where a run begins anew.

    A damaged checkpoint, or one whose tables were changed, gives way to the one before it. A run that was interrupted
    before its first checkpoint begins anew.

    Args:
        identity: of the run that is to go on.
        tell: takes sentences about what could not be used.
    Raises:
        InputError: the checkpoint is another run's, or the folder holds results of another run.
    """
    for path in checkpoints_in(folder):
        try:
            checkpoint = read_checkpoint(path)
        except ValueError as error:
            tell(f"{path}: the checkpoint is damaged ({error}); the one before is tried")
            continue
        other = difference(checkpoint.identity, identity)
        if other:
            raise InputError(
                f"{path}: expected a checkpoint of this run, found one of {other}; add "
                "--overwrite instead of --resume begins again"
            )
        tables = checkpoint.written["tables"].items()
        changed = [name for name, at in tables if not holds(folder / name, FilePosition(*at))]
        if not changed:
            return checkpoint
        tell(f"{folder / changed[0]}: changed since {path.name} was written; the checkpoint before is tried")
    _refuse_other_run(folder, identity)
    if products_in(folder):
        tell(f"{folder}: holds no checkpoint to go on from; the run begins anew")
    return None


def _refuse_other_run(folder: Path, identity: dict[str, Any]) -> None:
    """What lies in a folder without a checkpoint is replaced only where it is this run's beginning."""
    if all(path.name.endswith(PART) for path in products_in(folder)):
        return
    path = folder / "run.json"
    info = read_run_info(path) if path.is_file() else None
    config = {} if info is None else {name: table for name, table in info.config.items() if name != "run"}
    if info is None or config != identity["configuration"] or info.tracker != identity["settings"]["tracker"]:
        raise InputError(f"{folder}: expected the beginning of this run, found another; --overwrite replaces it")
