"""Arguments that several functions share, and what their values mean."""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pydantic import ValidationError

from calib.errors import InputError
from calib.io import parse_size
from calib.params import Params, first_problem
from planview.engine.config import Config, config_of, load_config
from planview.output.run_folder import RunFolder
from planview.trajectories.file import TrajectoryFile
from planview.trajectories.formats import load_file, tracks_file
from planview.trajectories.identities import judge_ids
from planview.trajectories.table import Trajectories
from stereo.readers import OpenOptions

if TYPE_CHECKING:
    from pandas import DataFrame

Frames = int | str | tuple[int, int]
"""The first N, "FIRST:LAST", or first and last frame; both are included."""
Settings = Config | Mapping[str, Any] | Path | str
"""Parameters of a run: all of them, tables or dotted names of those that differ, or a TOML file with these."""
_Table = TypeVar("_Table", bound=Params)


def path_of(path: Path | str | None) -> Path | None:
    """A path that may be text, or none."""
    return None if path is None else Path(path)


def frame_span(frames: Frames) -> tuple[int, int]:
    """First and last frame. Raises InputError: not a span of frames."""
    try:
        if isinstance(frames, tuple):
            first, last = map(int, frames)
        else:
            begin, colon, end = str(frames).partition(":")
            first = int(begin or 0) if colon else 0
            last = int(end) if colon else int(begin) - 1
        if 0 <= first <= last:
            return first, last
    except (TypeError, ValueError):
        pass
    raise InputError(f"expected FIRST:LAST, FIRST not after LAST, or N, e.g. 0:99, found {frames!r}", argument="frames")


def settings(config: Settings | None, base: Config | None = None) -> Config:
    """Parameters of a configuration over the base. Raises InputError: an unreadable file, an unknown name, or a value
    out of range, by name."""
    if config is None or isinstance(config, Path | str):
        return load_config(config, base=base)
    return config if isinstance(config, Config) else config_of(config, argument="config", base=base)


def size_of(size: tuple[int, int] | str | None, argument: str) -> tuple[int, int] | None:
    """Width and height, also of text such as 640x480. Raises InputError: other text."""
    return parse_size(size, f"{argument}=") if isinstance(size, str) else size


def opening(
    calibration: Path | str | None = None,
    fps: float | None = None,
    topics: str | Sequence[str] | None = None,
    right: Path | str | None = None,
) -> OpenOptions:
    """How a recording is opened, as readers take it."""
    return OpenOptions(path_of(calibration), fps, topics or (), path_of(right))


def checked(table: type[_Table], **values: Any) -> _Table:
    """A parameter table. Raises InputError: a value out of its range, by its argument, which has no unit."""
    try:
        return table(**values)
    except ValidationError as error:
        raise InputError(re.sub("^(.*?)(_m|_s)?: ", r"\1=: ", first_problem(error), count=1)) from error


def one_of(argument: str, value: object, choices: Iterable[str]) -> None:
    """Raises InputError: a value of an argument that is none of its choices."""
    names = tuple(choices)
    if value not in names:
        raise InputError(f"expected one of {', '.join(names)}, found {value!r}", argument=argument)


def in_range(argument: str, value: float, least: float, most: float, unit: str = "") -> None:
    """Raises InputError: a number of an argument out of its range."""
    if not least <= value <= most:
        raise InputError(f"expected {least:g} to {most:g}{unit}, found {value:g}", argument=argument)


def table_of(tracks: Trajectories | DataFrame) -> Trajectories:
    """Tracks that may be a table of pandas, judged as those of a file are. Raises InputError: not a table."""
    if not isinstance(tracks, Trajectories):
        if not hasattr(tracks, "columns"):
            expected = "expected a table (Trajectories or DataFrame), a file or a folder"
            raise InputError(f"{expected}, found {type(tracks).__name__}")
        tracks = Trajectories.from_dataframe(tracks)
    table, notes = judge_ids(tracks)
    for note in notes:
        warnings.warn(note, stacklevel=3)
    return table


class GivenTracks(NamedTuple):
    """Tracks as they were given: what they hold, their file, and the run that wrote them; None for a table."""

    file: TrajectoryFile
    path: Path | None = None
    run: RunFolder | None = None


def given_tracks(tracks: Trajectories | DataFrame | Path | str) -> GivenTracks:
    """Tracks from a table, a file or the folder of a run. Raises InputError: none of these."""
    if not isinstance(tracks, Path | str):
        return GivenTracks(TrajectoryFile(table_of(tracks)))
    path = tracks_file(Path(tracks))
    return GivenTracks(load_file(path), path, RunFolder.around(path))


@contextmanager
def log_errors_only(quiet: bool) -> Iterator[None]:
    """Keep warnings out of planview's loggers during the work, where it is to be ``quiet``."""
    logger = logging.getLogger("planview")
    before = logger.level
    if quiet:
        logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)
