"""Which file of tracks belongs to which file of truth."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from calib.errors import InputError

_TRUTH_FILES = ("truth.csv", "gt.txt", "gt/gt.txt")
_TABLES = (".csv", ".txt", ".h5", ".hdf5", ".sqlite", ".parquet", ".jsonl")


class FilePair(NamedTuple):
    """Tracks and truth of one recording; ``name`` is empty where only one was asked for."""

    name: str
    tracks: Path
    truth: Path


def tracks_file(path: Path) -> Path:
    """The file itself, or ``tracks.csv`` of the folder of a run."""
    return path / "tracks.csv" if path.is_dir() else path


def truth_file(folder: Path) -> Path | None:
    """The truth in the folder of a recording; None where there is none."""
    return next((folder / name for name in _TRUTH_FILES if (folder / name).is_file()), None)


def file_pairs(tracks: Path, truth: Path) -> list[FilePair]:
    """One pair for two files (or folders of one run and one recording), else the pairs of two folders by name.

    A name is that of a file without its ending, or of a folder with ``tracks.csv``, or with ``truth.csv``, ``gt.txt``
    or ``gt/gt.txt``; tracks may also lie in a folder ``data`` (MOTChallenge results). Tracks without truth are left
    out.

    Raises:
        InputError: a truth without tracks, or no truth at all.
    """
    own_truth = truth_file(truth) or truth
    if not own_truth.is_dir():
        return [FilePair("", tracks_file(tracks), own_truth)]
    truths = _by_name(truth, _TRUTH_FILES)
    found = _by_name(tracks / "data" if (tracks / "data").is_dir() else tracks, ("tracks.csv",))
    if not truths:
        raise InputError(f"{truth}: expected truth.csv, gt.txt or folders with them, found none")
    missing = [name for name in truths if name not in found]
    if missing:
        raise InputError(f"{tracks}: expected tracks for {missing[0]!r} of {truth}, found {', '.join(found) or 'none'}")
    return [FilePair(name, found[name], path) for name, path in truths.items()]


def _by_name(folder: Path, inside: tuple[str, ...]) -> dict[str, Path]:
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder, since the truth is one, found none")
    files: dict[str, Path] = {}
    for entry in sorted(folder.iterdir()):
        if entry.is_file() and entry.suffix in _TABLES:
            files[entry.stem] = entry
        elif entry.is_dir():
            first = next((entry / name for name in inside if (entry / name).is_file()), None)
            if first is not None:
                files[entry.name] = first
    return files
