"""One run per output folder: a lock file that names the process that writes there."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from calib.errors import InputError, WorkError
from calib.io import reason

LOCK_NAME = "run.lock"
_held: set[Path] = set()
"""Folders that this process holds: a run inside a command that holds its folder goes on."""


@contextmanager
def folder_lock(folder: Path) -> Iterator[str]:
    """Hold a folder, made if need be, until the block ends.

    The system's lock on ``run.lock`` ends with its process, so that a lock that a killed process left is known for
    what it is; the process and host written in the file are for people, and tell a lock of another machine, where the
    system's lock does not reach.

    Yields:
        A sentence about the stale lock that was taken over, empty when there was none.
    Raises:
        InputError: another process, or one on another host, holds the folder.
        WorkError: the lock file cannot be written.
    """
    place = folder.resolve()
    if place in _held:
        yield ""
        return
    try:
        place.mkdir(parents=True, exist_ok=True)
        descriptor, told = _taken(place / LOCK_NAME)
    except OSError as error:
        raise WorkError(f"{folder}: cannot be written ({reason(error)})") from error
    _held.add(place)
    try:
        yield told
    finally:
        _held.discard(place)
        with suppress(OSError):
            (place / LOCK_NAME).unlink()
        os.close(descriptor)


def check_unlocked(folder: Path) -> None:
    """Refuse a folder that another process holds; a stale lock is left as it is (same errors as ``folder_lock``)."""
    path = folder.resolve() / LOCK_NAME
    if path.parent in _held or not path.exists():
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        _lock(descriptor, path)
        _refuse_foreign(path, _owner(descriptor))
    finally:
        os.close(descriptor)


def _taken(path: Path) -> tuple[int, str]:
    """The descriptor of the file, locked and written, and a sentence about whose it was."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _lock(descriptor, path)
            told = _refuse_foreign(path, _owner(descriptor))
            if _is_in_place(descriptor, path):
                _write_owner(descriptor)
                return descriptor, told
        except BaseException:
            os.close(descriptor)
            raise
        # Its owner removed the file between our opening and locking it.
        os.close(descriptor)


def _lock(descriptor: int, path: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP):
            raise WorkError(f"{path}: the file system cannot lock files ({reason(error)})") from error
        who = _text(_owner(descriptor))
        raise InputError(f"{path.parent}: {who} is writing into it; wait for it or choose another folder") from error


def _refuse_foreign(path: Path, owner: dict[str, object]) -> str:
    if not owner:
        return ""
    if owner.get("host") != socket.gethostname():
        raise InputError(
            f"{path.parent}: {_text(owner)} is writing into it; if it is not running any more, delete {path}"
        )
    return f"{path.parent}: {_text(owner)} left its lock without finishing; taken over"


def _is_in_place(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _owner(descriptor: int) -> dict[str, object]:
    """Who wrote the file; empty for a new one."""
    text = os.pread(descriptor, 4096, 0)
    try:
        owner = json.loads(text) if text else {}
    except ValueError:
        owner = {}
    return owner if isinstance(owner, dict) else {}


def _write_owner(descriptor: int) -> None:
    moment = datetime.now(UTC).astimezone().isoformat(timespec="seconds")
    owner = {"pid": os.getpid(), "host": socket.gethostname(), "since": moment}
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(owner).encode() + b"\n", 0)


def _text(owner: dict[str, object]) -> str:
    if not owner:
        return "another process"
    return f"process {owner.get('pid')} on {owner.get('host')} (since {owner.get('since')})"
