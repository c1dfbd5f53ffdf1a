"""A calibration file as text, and what the caller supplies about the rig."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from calib.errors import InputError
from calib.rig import StereoRig
from calib.text import MAX_BYTES, reason, require_file

Size = tuple[int, int]


@dataclass(frozen=True)
class Source:
    """A file and its text."""

    path: Path
    text: str


@dataclass(frozen=True)
class Choice:
    """What the caller supplies and a file may lack.

    Attributes:
        size: (width, height) of the recording's images [px]; selects or supplies the resolution.
        cameras: names of the left and right camera in a file that holds more than two.
        unit_m: length of the file's unit of translation [m]; None takes the format's own.
        rectified: whether the images are, where a file holds both calibrations; None tells it by their size.
    """

    size: Size | None = None
    cameras: tuple[str, str] | None = None
    unit_m: float | None = None
    rectified: bool | None = None

    def unit(self, default_m: float = 1.0) -> float:
        """Metres per unit of the file."""
        return default_m if self.unit_m is None else self.unit_m


@dataclass(frozen=True)
class Format:
    """How one tool writes a rig.

    Attributes:
        key: short name for the command line.
        name: as messages show it.
        part: what a text holds in this format: "whole" (a rig), "left" or "right" (a half), or None (not this format).
        read: a rig from a whole, or from its left and right half; raises ValueError for bad content.
        write: writes a rig, returns the files; raises ValueError when the format cannot hold it.
        suffix: of the file it writes; empty: it writes a folder.
    """

    key: str
    name: str
    part: Callable[[Source], str | None]
    read: Callable[[Sequence[Source], Choice], StereoRig]
    write: Callable[[StereoRig, Path], list[Path]]
    suffix: str


def read_source(path: Path) -> Source:
    """Read a text file.

    Raises:
        InputError: unreadable, too large, or not text.
    """
    require_file(path, "a calibration file")
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
        if len(raw) > MAX_BYTES:
            raise InputError(f"{path}: expected a calibration file, found more than {MAX_BYTES} bytes")
        text = raw.decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: expected a readable calibration file, found {reason(error)}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected a calibration as text, found binary data at byte {error.start}") from error
    return Source(path, text.replace("\r\n", "\n"))


def side_of(name: str) -> str | None:
    """Which camera a file or folder name refers to: "left", "right", or None when it names neither or both."""
    words = set(re.split(r"[^a-z0-9]+", name.lower()))
    left = bool(words & {"l", "cam0", "camera0"}) or "left" in name.lower()
    right = bool(words & {"r", "cam1", "camera1"}) or "right" in name.lower()
    if left == right:
        return None
    return "left" if left else "right"
