"""Folders with ``rigs.toml``: told from other recordings, and not opened as a single one."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from calib.rigs_file import RIGS_FILE, load_rigs
from stereo.readers.reader import Layout, OpenOptions, Reader


def rigs_file(path: Path) -> Path:
    """The ``rigs.toml`` that a path names: itself, or the one in the folder."""
    return path if path.name == RIGS_FILE else path / RIGS_FILE


def is_heads(path: Path) -> bool:
    """Whether a path is a recording of several heads: a folder with ``rigs.toml``, or that file."""
    return rigs_file(path).is_file()


def _find(path: Path, _options: OpenOptions) -> Layout:
    file = rigs_file(path)
    folders = ", ".join(str(file.parent / entry.folder) for entry in load_rigs(file))
    raise InputError(
        f"{path}: expected one stereo pair, found a recording of several heads, which planview run tracks whole: "
        f"give one of {folders}"
    )


READER = Reader("heads", "several heads", "rigs.toml beside the folders of several heads", is_heads, _find)
