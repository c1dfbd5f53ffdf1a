"""A disk that fills up."""

import errno
import os
from types import SimpleNamespace

import pytest


def report_free_mb(monkeypatch: pytest.MonkeyPatch, *free_mb: int) -> None:
    """Let the disk have so much room, from one question to the next."""
    room = iter(free_mb)
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=next(room) << 20))


def fill_disk_after(monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    """Let ``os.write`` write so many bytes more, in part if need be, and then report a full disk."""
    left, write = [room], os.write

    def limited(descriptor, data):
        if descriptor < 3:  # what pytest and the command print
            return write(descriptor, data)
        if left[0] == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        n = write(descriptor, data[: left[0]])
        left[0] -= n
        return n

    monkeypatch.setattr(os, "write", limited)
