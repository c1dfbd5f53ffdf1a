"""Trajectories in our own layout or in that of another program, told by the file's content."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.io import reason, require_file
from planview.trajectories.file import TrajectoryFile, timed_by_rate
from planview.trajectories.jsonl import read_jsonl
from planview.trajectories.jupedsim import read_jupedsim
from planview.trajectories.motchallenge import read_motchallenge
from planview.trajectories.parquet import read_parquet
from planview.trajectories.ped_data_archive import read_ped_data_archive
from planview.trajectories.petrack import read_petrack
from planview.trajectories.rows import read_numbers, sorted_rows
from planview.trajectories.table import Trajectories, positions_table, read_tracks, read_truth

BINARY = {
    b"\x89HDF\r\n\x1a\n": read_ped_data_archive,
    b"SQLite format 3\x00": read_jupedsim,
    b"PAR1": read_parquet,
}
"""Readers by the first bytes of a file."""
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_FIRST_LINE = 10_000


def load_truth(path: Path) -> Trajectories:
    """Truth in our layout (with a header), as PETS/MOTChallenge rows or in any other layout of ``load_file``.

    Raises:
        InputError: unreadable or none of these.
    """
    return load_file(path, truth=True).table


def load_tracks(path: Path, *, boxes: bool = True) -> Trajectories:
    """Tracks in any layout of ``load_file``.

    Args:
        boxes: boxes and velocities are needed; long files in our layout are read in half the time without.
    Raises:
        InputError: unreadable or none of these.
    """
    return load_file(path, boxes=boxes).table


def load_file(path: Path, *, truth: bool = False, boxes: bool = True) -> TrajectoryFile:
    """Trajectories of any layout: our own, MOTChallenge and PETS, PeTrack and PedPy, laboratory rows without comments,
    Ped Data Archive, JuPedSim, Parquet, JSON lines.

    Rows without times get them from the frame rate, where the file gives one.

    Args:
        truth: the file is ground truth.
        boxes: see ``load_tracks``.
    Raises:
        InputError: unreadable or none of these.
    """
    require_file(path, "trajectories")
    try:
        with path.open("rb") as file:
            start = file.read(_FIRST_LINE)
    except OSError as error:
        raise InputError(f"{path}: expected trajectories, found {reason(error)}") from error
    binary = next((reader for magic, reader in BINARY.items() if start.startswith(magic)), None)
    return timed_by_rate(binary(path) if binary else _load_text(path, start.split(b"\n")[0], truth, boxes))


def _load_text(path: Path, first: bytes, truth: bool, boxes: bool) -> TrajectoryFile:
    try:
        line = first.removeprefix(_BYTE_ORDER_MARK).decode("utf-8", "ignore" if len(first) == _FIRST_LINE else "strict")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected trajectories, found {error}") from error
    if line.startswith("#"):
        return read_petrack(path)
    if line.startswith("{"):
        return read_jsonl(path)
    if not line.strip() or not _is_number(line.replace(",", " ").split()[0]):
        return TrajectoryFile(read_truth(path) if truth else read_tracks(path, boxes=boxes))
    return TrajectoryFile(read_motchallenge(path, truth=truth) if "," in line else read_laboratory(path))


def read_laboratory(path: Path, fps: float = 16.0) -> Trajectories:
    """Head positions of laboratory experiments (Juelich) without comments: id, frame, x cm, y cm, z cm.

    Raises:
        InputError: a row of another length, or values that are not numbers.
    """
    table = read_numbers(path, None, "rows of id frame x_cm y_cm z_cm")
    if table.shape[1] != 5:
        raise InputError(f"{path}: expected 5 columns (id frame x_cm y_cm z_cm), found {table.shape[1]}")
    table = sorted_rows(path, table, frame=1, track_id=0)
    track_id, frame = table[:, :2].astype(np.int64).T
    return positions_table(frame, track_id, table[:, 2:4] / 100, table[:, 4] / 100, timestamp_s=frame / fps)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
