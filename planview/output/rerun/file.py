"""The file of a rerun recording: bounded in size, and gone on with after a kill."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from calib.errors import InputError
from calib.io import PART, sync

RECORDED_BYTES_MAX = 2 * 2**30
"""What a run of any length takes of the disk (our choice: an hour that can be copied)."""
DOUBLED_MAX = 12
"""Images become rarer so many times at most: every 4096th is one in five minutes at 15 Hz (our choice)."""


class RrdFile:
    """``run.rrd``, and beside it what a resumed run has written so far.

    rerun cannot go on with a file, but reads one that was cut off after whole messages, and one in which more messages
    follow. So a resumed run writes a file of its own, which is appended in the end; the table of contents at the end of
    each is left out, since it would be wrong then.

    Args:
        path: of the whole.
        position: to go on from; what was written after it is dropped.
    Attributes:
        open_path: what the stream of this run is to be saved to.
    Raises:
        InputError: the files do not reach to the position.
    """

    def __init__(self, path: Path, position: Mapping[str, int] | None = None) -> None:
        self._path, self._rest = path, path.with_name(path.name + PART)
        self.open_path = path if position is None else self._rest
        if position is not None:
            self._cut_off(position["whole"], position["rest"])

    def size(self) -> int:
        """What is written [bytes]."""
        return sum(path.stat().st_size for path in {self._path, self.open_path} if path.is_file())

    def position(self) -> dict[str, int]:
        """Where the recording stands; everything up to there, which the stream has flushed, is brought to the disk."""
        sync(self.open_path)
        sizes = [path.stat().st_size for path in (self._path, self._rest) if path.is_file()]
        return dict(zip(("whole", "rest"), [*sizes, 0], strict=False))

    def close(self, size: int) -> None:
        """Make one file, after the stream has let go of it.

        Args:
            size: of the open file before its table of contents [bytes].
        """
        if self.open_path != self._path:
            self._append(size)
        sync(self._path)

    def _cut_off(self, whole: int, rest: int) -> None:
        found = self._path.stat().st_size if self._path.is_file() else 0
        more = self._rest.stat().st_size if self._rest.is_file() else 0
        if found < whole or (more < rest and found < whole + rest):
            raise InputError(f"{self._path}: expected {whole + rest} bytes before the checkpoint, found {found + more}")
        if more >= rest:
            os.truncate(self._path, whole)
            self._append(rest)
        else:  # it was appended before
            os.truncate(self._path, whole + rest)

    def _append(self, size: int) -> None:
        if self._rest.is_file():
            os.truncate(self._rest, size)
            with self._path.open("ab") as file, self._rest.open("rb") as more:
                shutil.copyfileobj(more, file)
            sync(self._path)
            self._rest.unlink()


def rarer(written: int, room: int = RECORDED_BYTES_MAX) -> int:
    """Of how many frames' images one is still written: twice as many for every half of the room left that is used.

    Args:
        written: size of the file so far [bytes].
        room: that it shall keep [bytes].
    """
    left = 1.0 - written / room
    return 1 << math.floor(-math.log2(max(left, 2.0**-DOUBLED_MAX)))


def quiet_environment() -> dict[str, str]:
    """Variables under which rerun's programs send no usage statistics: they send none where ``CI`` is set."""
    return {**{k: v for k, v in os.environ.items() if k != "FORCE_RERUN_ANALYTICS"}, "CI": "1"}
