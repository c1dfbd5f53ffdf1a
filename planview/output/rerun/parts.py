"""``run.rrd`` in parts, a new one when a run is taken up again and after so many frames, joined in the end."""

from __future__ import annotations

import math
import os
import subprocess
import sysconfig
from collections.abc import Callable, Mapping
from pathlib import Path

from calib.errors import InputError, WorkError
from calib.io import reason, sync, whole_file

JOINED_BYTES_MAX = 2**28
"""Parts that are larger together stay apart: rerun joins in memory, and takes thirteen times their size (our choice:
at most 3.5 GB)."""
RECORDED_BYTES_MAX = 2 * 2**30
"""What a run of any length takes of the disk (our choice: an hour that can be copied)."""
DOUBLED_MAX = 12
"""Images become rarer so many times at most: every 4096th is one in five minutes at 15 Hz (our choice)."""


class RrdParts:
    """The files that a rerun recording is written to.

    rerun cannot go on with a file. But a file that is cut off after whole messages can be read, and ``rerun rrd merge``
    makes one recording of several that share its id, as the viewer does with files that are opened together.

    Args:
        path: of the file that the parts become.
        position: to go on from; what was written after it is dropped.
    Attributes:
        joined: whether the last ``join`` made one file.
    Raises:
        InputError: the parts do not reach to the position.
    """

    def __init__(self, path: Path, position: Mapping[str, int] | None = None) -> None:
        self._path = path
        self._count = 1 if position is None else self._cut_off(position) + 1
        self.joined = False

    @property
    def open_path(self) -> Path:
        """The part being written."""
        return self._part(self._count)

    def turn(self, write_to: Callable[[Path], None]) -> None:
        """The part being written is complete; the next one begins.

        Args:
            write_to: closes the one and opens the other.
        """
        done = self.open_path
        self._count += 1
        write_to(self.open_path)
        sync(done)

    def position(self) -> dict[str, int]:
        """Where the recording stands; everything up to there is brought to the disk."""
        sync(self.open_path)
        return {"parts": self._count, "bytes": self.open_path.stat().st_size}

    def bytes_before(self) -> int:
        """Size of the parts that are complete [bytes]."""
        return sum(self._part(n).stat().st_size for n in range(1, self._count))

    def _cut_off(self, position: Mapping[str, int]) -> int:
        """Drop what was written after a position; returns the number of parts left."""
        last = position["parts"]
        if last == 1 and self._path.exists():
            self._path.replace(self._part(1))
        size = self._part(last).stat().st_size if self._part(last).is_file() else 0
        if size < position["bytes"]:
            found = f"expected {position['bytes']} bytes before the checkpoint, found {size}"
            raise InputError(f"{self._part(last)}: {found}")
        os.truncate(self._part(last), position["bytes"])
        self._path.unlink(missing_ok=True)
        for path in self._path.parent.glob(f"{self._path.stem}-[0-9]*.rrd"):
            if path not in [self._part(n) for n in range(1, last + 1)]:
                path.unlink()
        return last

    def join(self) -> None:
        """Make one file of the parts, where they are not too large for that.

        Raises:
            WorkError: they cannot be joined.
        """
        parts = [self._part(n) for n in range(1, self._count + 1)]
        if len(parts) == 1:
            sync(parts[0])
            parts[0].replace(self._path)
        elif sum(part.stat().st_size for part in parts) <= JOINED_BYTES_MAX:
            with whole_file(self._path) as whole:
                _merge(parts, whole)
        self.joined = self._path.is_file()

    def remove(self) -> None:
        """Remove the parts, if they were joined."""
        for n in range(1, self._count + 1):
            if self.joined:
                self._part(n).unlink(missing_ok=True)

    def _part(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.stem}-{number}{self._path.suffix}")


def rarer(written: int, room: int = RECORDED_BYTES_MAX) -> int:
    """Of how many frames' images one is still written: twice as many for every half of the room left that is used.

    Args:
        written: size of the parts so far [bytes].
        room: that they shall keep [bytes].
    """
    left = 1.0 - written / room
    return 1 << math.floor(-math.log2(max(left, 2.0**-DOUBLED_MAX)))


def _merge(parts: list[Path], target: Path) -> None:
    program = Path(sysconfig.get_path("scripts")) / "rerun"
    command: list[Path | str] = [program, "rrd", "merge", *parts, "-o", target]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=quiet_environment())
    except OSError as error:
        raise WorkError(f"{target}: the rerun program cannot be started ({reason(error)})") from error
    if done.returncode != 0:
        told = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise WorkError(f"{target}: the parts of the rerun recording cannot be joined ({told})")


def recorded_parts(folder: Path) -> list[Path]:
    """``run.rrd`` of a folder, else its parts in order where they were too large to be joined."""
    whole = folder / "run.rrd"
    numbered = {int(path.stem.partition("-")[2]): path for path in folder.glob("run-*.rrd") if path.stem[4:].isdigit()}
    return [whole] if whole.is_file() else [numbered[n] for n in sorted(numbered)]


def quiet_environment() -> dict[str, str]:
    """Variables under which rerun's programs send no usage statistics: they send none where ``CI`` is set."""
    return {**{k: v for k, v in os.environ.items() if k != "FORCE_RERUN_ANALYTICS"}, "CI": "1"}
