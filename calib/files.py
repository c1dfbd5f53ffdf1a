"""Files that are whole or not there: written beside their place, synced, and renamed into it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PART = ".part"
"""Ending of a file that is being written; what is found under it later is what a killed program left."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """The place to write a file to, which becomes ``path`` in one step when the block ends without an error.

    Its folder is made if need be.
    After an error nothing is left of it, and an earlier file at ``path`` is as it was. Links are followed; a device or
    a pipe, which cannot be replaced, is written directly.

    Raises:
        OSError: the file cannot be written, synced or renamed.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        yield target
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(target.name + PART)
    try:
        yield part
        sync(part)
        os.replace(part, target)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    sync_folder(target.parent)


def write_whole(path: Path, content: str | bytes) -> None:
    """Replace a file by text (UTF-8) or bytes in one step (see ``whole_file``)."""
    with whole_file(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


def sync(path: Path) -> None:
    """Bring a file's content to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Bring a folder's names to the disk, where the system can."""
    with suppress(OSError):
        sync(folder)
