"""The options that say how a recording is opened, shared by the commands that open one."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from stereo.readers import OpenOptions


def open_options(calibration: Path | None = None, fps: float | None = None, topics: str | None = None) -> OpenOptions:
    """Options of the command line as a reader takes them.

    Args:
        topics: two names with a comma between them.
    Raises:
        InputError: not two topics, or a rate that no camera has.
    """
    if fps is not None and not 0.01 <= fps <= 10_000:
        raise InputError(f"--fps: expected 0.01 to 10000 frames per second, found {fps:g}")
    names = tuple(name.strip() for name in topics.split(",")) if topics is not None else ()
    if topics is not None and (len(names) != 2 or not all(names) or names[0] == names[1]):
        raise InputError(f"--topics: expected two topics, LEFT,RIGHT or IMAGE,DEPTH, found {topics!r}")
    return OpenOptions(calibration, fps, names)
