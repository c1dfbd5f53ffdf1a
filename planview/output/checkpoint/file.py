"""Checkpoint files: the memory of a run, whole or not there, the last two kept."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calib.errors import WorkError
from calib.io import whole_file
from calib.types import U8
from planview.output.checkpoint.encode import Encoded

LATEST, PREVIOUS = "checkpoint.npz", "checkpoint.previous.npz"
FORMAT = 1
"""Changes when an older reader would misunderstand the file."""


class Checkpoint(NamedTuple):
    """What a checkpoint file holds.

    Attributes:
        identity: of the run, which a run that goes on must share (``planview.output.checkpoint.identity``).
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
        "format": FORMAT, "identity": checkpoint.identity, "written": checkpoint.written,
        "roots": checkpoint.memory.roots, "nodes": checkpoint.memory.nodes,
    }  # fmt: skip
    text = np.frombuffer(json.dumps(document).encode(), dtype=np.uint8)
    blocks: dict[str, Any] = {f"block{n}": block for n, block in enumerate(checkpoint.memory.blocks)}
    path = folder / LATEST
    try:
        with whole_file(path) as part:
            with part.open("wb") as file:
                np.savez(file, document=text, **blocks)
            if path.exists():
                os.replace(path, folder / PREVIOUS)
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({error.strerror})") from error


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises:
        ValueError: damaged, cut short, or of another format.
    """
    try:
        _refuse_swollen(path)
        with np.load(path, allow_pickle=False) as file:
            document = json.loads(file["document"].tobytes())
            blocks: list[U8] = [file[f"block{n}"] for n in range(len(file.files) - 1)]
        if document["format"] != FORMAT:
            raise ValueError(f"format {document['format']}, not {FORMAT}")
        memory = Encoded(document["roots"], document["nodes"], blocks)
        return Checkpoint(document["identity"], document["written"], memory)
    except (OSError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(" ".join(str(error).split()) or type(error).__name__) from error


def _refuse_swollen(path: Path) -> None:
    """Blocks are stored as they are: none is larger than the file."""
    with zipfile.ZipFile(path) as file:
        if sum(info.file_size for info in file.infolist()) > path.stat().st_size:
            raise ValueError("blocks larger than the file")


def checkpoints_in(folder: Path) -> Iterator[Path]:
    """The checkpoints of a folder, the latest first."""
    return (folder / name for name in (LATEST, PREVIOUS) if (folder / name).is_file())


def remove_checkpoints(folder: Path) -> None:
    """A finished run needs none."""
    for path in checkpoints_in(folder):
        path.unlink(missing_ok=True)
