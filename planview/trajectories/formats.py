"""Trajectories read in any layout, found with a recording, and exported for other programs."""

from __future__ import annotations

import codecs
import gzip
import re
import warnings
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Literal, NamedTuple

import numpy as np

from calib.errors import InputError, WorkError
from calib.io import entries, expecting, read_text, reason, require_file, whole_file
from planview.trajectories import layouts, rows
from planview.trajectories.boxes import named_columns, read_motchallenge, write_motchallenge
from planview.trajectories.clock import Clock, at_times
from planview.trajectories.file import TrajectoryFile, measure_rate, parse_rate, surrounding_area
from planview.trajectories.hdf5 import SIGNATURE
from planview.trajectories.identities import judge_ids, split_paths
from planview.trajectories.table import (
    Trajectories,
    doubt,
    frame_times,
    read_tracks,
    read_truth,
    write_table,
)

BINARY = {
    SIGNATURE: layouts.read_ped_data_archive,
    b"SQLite format 3\x00": layouts.read_jupedsim,
    b"PAR1": layouts.read_parquet,
}
"""Readers by the first bytes of a file."""
_FIRST_LINE = 10_000
MAX_UNPACKED_BYTES = 1 << 31
ExportName = Literal["pedpy", "ped-data-archive", "jupedsim", "motchallenge", "parquet", "csv", "jsonl"]
_TRUTH_FILES = ("truth.csv", "gt.txt", "gt/gt.txt")
_TABLES = (".csv", ".txt", ".h5", ".hdf5", ".sqlite", ".parquet", ".jsonl")


def load_truth(path: Path, tracks: Trajectories | None = None) -> Trajectories:
    """Truth in our layout (with a header), as PETS/MOTChallenge rows or in any other layout of ``load_file``; rows with
    times and no frames have those of the ``tracks``. Raises InputError: unreadable or none of these."""
    file = load_file(path, truth=True)
    if tracks and file.is_timed:
        frames = np.arange(tracks.frame.min(), tracks.frame.max() + 1)
        return at_times(file.table, frames, Clock(tracks).at(frames))
    return file.table


def load_tracks(path: Path) -> Trajectories:
    """Tracks in any layout of ``load_file``. Raises InputError: unreadable or none of these."""
    return load_file(path).table


def load_file(path: Path, *, truth: bool = False) -> TrajectoryFile:
    """Trajectories of any layout: our own, MOTChallenge and PETS, rows whose columns a line names (PeTrack, PedPy,
    Vadere, Pathfinder, crowdit, Viswalk) or none, Ped Data Archive, JuPedSim, Parquet, JSON lines.

    Rows without times get them from the frame rate, where the file gives one; ground truth is read as such with
    ``truth``. Warns of what was assumed, left out or cannot be. Raises InputError: unreadable or none of these.
    """
    file = _load(path, truth)
    if file.fps is not None and not np.isfinite(file.table.timestamp_s).any():
        file = replace(file, table=replace(file.table, timestamp_s=file.table.frame / file.fps))
    if len(file.table) and not np.isfinite([*file.table.box_px.T, file.table.x_m]).any():
        raise InputError(f"{path}: expected people with a place (x_m, y_m) or a box, found neither")
    table, notes = judge_ids(file.table)
    file = replace(file, table=table)
    for sentence in filter(None, (file.note, *notes, doubt(table))):
        warnings.warn(f"{path}: {sentence}", stacklevel=2)
    return file


def _load(path: Path, truth: bool) -> TrajectoryFile:
    require_file(path, "trajectories")
    with expecting(path, "trajectories", OSError), path.open("rb") as file:
        start = file.read(_FIRST_LINE)
    if start.startswith(b"\x1f\x8b"):
        return _unpack(path, truth)
    if start.startswith(b"version ") and path.suffix == ".trc":
        raise InputError(f"{path}: expected trajectories in metres, found pixels of PeTrack: export its .txt")
    for magic, reader in BINARY.items():
        if start.startswith(magic):
            return reader(path)
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(start)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected text in UTF-8, found another encoding, such as UTF-16 of Excel") from error
    line = text.split("\n")[0]
    if line.startswith("["):
        raise InputError(f"{path}: expected a table or JSON lines, found a JSON list: write an object for each frame")
    if line.startswith("{"):
        return layouts.read_jsonl(path)
    if named_columns(line) or not start:
        return read_motchallenge(path, truth=truth)
    cells = re.split(r"[\s,;]+", line.strip())
    are_numbers = re.fullmatch(r"[-+.\deE]+", cells[0]) is not None
    is_ours = {"frame", "id", "x_m", "y_m"} <= {name.strip('"') for name in cells}
    if not is_ours and (line.startswith("#") or (are_numbers and len(cells) < 6) or rows.columns_of(text)):
        return rows.read_rows(path, text)
    if are_numbers:
        return read_motchallenge(path, truth=truth)
    return TrajectoryFile(read_truth(path) if truth else read_tracks(path))


def _unpack(path: Path, truth: bool) -> TrajectoryFile:
    """Trajectories in a file that gzip compressed."""
    with TemporaryDirectory() as folder:
        inner = Path(folder) / path.stem
        try:
            with gzip.open(path) as packed, inner.open("wb") as out:
                while (part := packed.read(1 << 20)) and out.tell() < MAX_UNPACKED_BYTES:
                    out.write(part)
            return _load(inner, truth)
        except (OSError, EOFError, zlib.error) as error:
            raise InputError(f"{path}: expected trajectories, found a damaged archive ({reason(error)})") from error
        except InputError as error:
            raise InputError(str(error).replace(str(inner), str(path))) from error


class ExportFormat(NamedTuple):
    """A format to write.

    Attributes:
        suffix: its usual ending.
        keeps_state: whether rows have their state; else it holds confirmed rows.
        needs_floor: whether rows need a position on the floor.
        is_of_paths: whether an id stands for one walk, so that each track has its own.
    """

    suffix: str
    write: Callable[[Path, TrajectoryFile], None]
    keeps_state: bool
    needs_floor: bool = True
    is_of_paths: bool = False


def _write_text(write: Callable[[IO[str], Trajectories], None], path: Path, file: TrajectoryFile) -> None:
    with path.open("w", encoding="utf-8") as out:
        write(out, file.table)


FORMATS: dict[ExportName, ExportFormat] = {
    "pedpy": ExportFormat(".txt", rows.write_petrack, False, is_of_paths=True),
    "ped-data-archive": ExportFormat(".h5", layouts.write_ped_data_archive, False, is_of_paths=True),
    "jupedsim": ExportFormat(".sqlite", layouts.write_jupedsim, False, is_of_paths=True),
    "motchallenge": ExportFormat(".txt", write_motchallenge, False, needs_floor=False),
    "parquet": ExportFormat(".parquet", layouts.write_parquet, True),
    "csv": ExportFormat(".csv", partial(_write_text, write_table), True),
    "jsonl": ExportFormat(".jsonl", partial(_write_text, layouts.stream_jsonl), True),
}


def write_file(path: Path, file: TrajectoryFile, name: ExportName, unit: Literal["m", "cm"] = "m") -> None:
    """Write a prepared export, in the unit that pedpy alone has. Raises WorkError: the file cannot be written; an
    earlier one is kept. InputError: a package is missing."""
    write = partial(rows.write_petrack, unit=unit) if name == "pedpy" else FORMATS[name].write
    try:
        with whole_file(path) as part:
            write(part, file)
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)})") from error


def prepare_export(
    file: TrajectoryFile, name: ExportName, *, fps: float | None = None, area: str | None = None, lost: bool = False
) -> TrajectoryFile:
    """The content of an export of a file: of a format without states the confirmed rows with a floor position or, where
    it has boxes, a box. Where an id stands for one walk, a track that follows the end of another has its own. Raises
    InputError: no frame rate anywhere, or no row with a floor position.

    Args:
        fps: in place of the file's own; where neither is known the rate that the timestamps have. Rows of a file
            without times get them from it.
        area: in place of the file's own; where neither is known the rectangle around all positions.
        lost: rows that were only predicted count as confirmed.
    """
    rate = fps or file.fps or measure_rate(file.table) or 1.0 / Clock(file.table).frame_s
    table = file.table
    if not np.isfinite(table.timestamp_s).any():
        table = replace(table, timestamp_s=table.frame / rate)
    if FORMATS[name].is_of_paths:
        table, note = split_paths(table)
        if note:
            warnings.warn(note, stacklevel=2)
    if not FORMATS[name].keeps_state:
        confirmed = (table.state == "confirmed") | (lost & (table.state == "lost"))
        usable = np.isfinite(table.x_m) & np.isfinite(table.y_m)
        if not FORMATS[name].needs_floor:
            usable |= np.isfinite(table.box_px).all(axis=1)
        if len(table) and not usable.any():
            raise InputError("expected trajectories with floor positions, found none")
        table = table.where(confirmed & usable)
    frames, times = frame_times(table)
    if not FORMATS[name].keeps_state and len(frames) > 1:
        off_s = np.ptp(times - frames / rate)
        if off_s > 1.0 / rate:
            text = f"{name} holds no times but a rate: at {rate:g} frames per second they are up to {off_s:.2g} s off"
            warnings.warn(text, stacklevel=2)
    return TrajectoryFile(table, rate, area or file.walkable_wkt or surrounding_area(table))


class FilePair(NamedTuple):
    """Tracks and truth of one recording; ``name`` is empty where only one was loaded."""

    name: str
    tracks: Path
    truth: Path


def tracks_file(path: Path) -> Path:
    """The file itself, or ``tracks.csv`` of the folder of a run."""
    return path / "tracks.csv" if path.is_dir() else path


def sequence_rate(truth: Path) -> float | None:
    """Frames per second in the seqinfo.ini of a MOTChallenge sequence, next to its truth or a folder above; None
    without one. Raises InputError: no rate in it."""
    rate = _seqinfo(truth).get("framerate")
    return parse_rate(truth, rate) if rate else None


def sequence_size(truth: Path) -> tuple[int, int] | None:
    """(width, height) of the images [px] in the seqinfo.ini of a sequence; None where it does not give them."""
    values = _seqinfo(truth)
    width = values.get("imwidth", "")
    height = values.get("imheight", "")
    return (int(width), int(height)) if width.isdecimal() and height.isdecimal() else None


def _seqinfo(truth: Path) -> dict[str, str]:
    """The values in the seqinfo.ini of a truth by their keys in lower case; none without it."""
    for folder in truth.parents[:2]:
        file = folder / "seqinfo.ini"
        if file.is_file():
            lines = re.findall(r"(?m)^\s*(\w+)\s*=\s*(.*?)\s*$", read_text(file, "seqinfo.ini"))
            return {key.lower(): value for key, value in lines}
    return {}


def truth_file(folder: Path) -> Path | None:
    """The truth in the folder of a recording; None where there is none."""
    return _first_file(folder, _TRUTH_FILES)


def _first_file(folder: Path, names: tuple[str, ...]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_file()), None)


def file_pairs(tracks: Path, truth: Path) -> list[FilePair]:
    """One pair for two files (or folders of one run and one recording), else the pairs of two folders by name.

    A name is that of a file without its ending, or of a folder with ``tracks.csv``, or with ``truth.csv``, ``gt.txt``
    or ``gt/gt.txt``; tracks may also lie in a folder ``data`` (MOTChallenge results). Tracks without truth are left
    out. Raises InputError: a truth without tracks, or no truth at all.
    """
    single = truth_file(truth) or truth
    if not single.is_dir():
        return [FilePair("", tracks_file(tracks), single)]
    truths = _files_by_name(truth, _TRUTH_FILES)
    if not truths:
        raise InputError(f"{truth}: expected truth.csv, gt.txt or folders with them, found none")
    results = tracks / "data" if (tracks / "data").is_dir() else tracks
    tables = _files_by_name(results, ("tracks.csv",))
    pairs = []
    for name, file in truths.items():
        if name not in tables:
            raise InputError(f"{tracks}: expected tracks for {name!r} of {truth}, found {', '.join(tables) or 'none'}")
        pairs.append(FilePair(name, tables[name], file))
    return pairs


def _files_by_name(folder: Path, inside: tuple[str, ...]) -> dict[str, Path]:
    """The tables of a folder, and the first of some files in each folder in it."""
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder, since the truth is one, found none")
    files = {}
    for entry in entries(folder):
        file = _first_file(entry, inside) if entry.is_dir() else entry
        if file is not None and (entry.is_dir() or entry.suffix in _TABLES):
            files[entry.name if entry.is_dir() else entry.stem] = file
    return files
