"""Options that commands share, and what their values mean."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from cyclopts import Parameter
from pydantic import ValidationError

from calib.errors import InputError
from calib.formats.one_camera import LensOnlyError
from calib.params import Params, first_problem
from stereo.readers import OpenOptions

Flag = Annotated[bool, Parameter(negative="")]
"""A switch that is off unless it is given; there is no --no-... of it."""
JsonFlag = Annotated[bool, Parameter(name="--json", negative="", help="Print one JSON object to standard output.")]

Topics = Annotated[
    str | None, Parameter(help="Topics of a bag, LEFT,RIGHT or IMAGE,DEPTH, where they are not clear from their names.")
]
FrameRate = Annotated[float | None, Parameter(help="Frames per second, where times are missing or wrong.")]
Settings = Annotated[Path | None, Parameter(help="TOML file with parameters of a run, a table per stage.")]
OneSetting = Annotated[
    Sequence[str],
    Parameter(
        name="--set", negative="",
        help="One parameter, e.g. --set foreground.learning_rate=0.002; can be repeated.",
    ),
]  # fmt: skip
Region = Annotated[
    str | None, Parameter(help="Polygon in well-known text [m], or a file with it: rows outside are left out.")
]
Ignored = Annotated[
    str | None, Parameter(help="Polygon in well-known text [m], or a file with it: rows inside are left out.")
]

_OPTIONS = {"camera": "calibration", "refined": "refine", "overrides": "set", "match_on='boxes'": "boxes"}
"""Options that are not called as the arguments of the Python functions are."""


def typed(error: InputError) -> str:
    """The sentence of an error with options in place of Python's arguments, and with the command that writes a
    camera.toml, or the trackers of one camera, where these are needed."""
    sentence = error.sentence(lambda argument: f"--{_OPTIONS.get(argument, argument).replace('_', '-')}")
    if error.remedy == "camera" or isinstance(error, LensOnlyError):
        focal = f" --focal {error.focal_px:.0f}" if isinstance(error, LensOnlyError) else ""
        sentence += f" (planview calibrate human VIDEO --auto{focal} --out camera.toml writes one)"
    if error.remedy == "tracker":
        sentence += " ellipse-particle, or --tracker human-model and --calibration camera.toml"
    return sentence


_Table = TypeVar("_Table", bound=Params)


def checked(table: type[_Table], **values: Any) -> _Table:
    """A parameter table from options. Raises InputError: a value out of its range, by name."""
    try:
        return table(**values)
    except ValidationError as error:
        raise InputError(first_problem(error)) from error


def in_range(option: str, value: float, least: float, most: float, unit: str = "") -> None:
    """Raises InputError: a number of an option out of its range."""
    if not least <= value <= most:
        raise InputError(f"{option}: expected {least:g} to {most:g}{unit}, found {value:g}")


def open_options(
    calibration: Path | None = None, fps: float | None = None, topics: str | None = None, right: Path | None = None
) -> OpenOptions:
    """Options of the command line as a reader takes them."""
    return OpenOptions(calibration, fps, topics or (), right)


def say(text: object) -> None:
    """Print a message to standard error, its lines as they are."""
    from planview.output.progress import PlainConsole  # of rich, which some commands do without

    PlainConsole(stderr=True, soft_wrap=True, highlight=False).print(str(text))


def plural(count: int, noun: str) -> str:
    """ "1 run", "2 runs"."""
    return f"{count} {noun}{'s' * (count != 1)}"


def frame_span(text: str) -> tuple[int, int]:
    """First and last frame of "FIRST:LAST", or of "N" for the first N frames. Raises InputError: anything else."""
    first, colon, last = text.partition(":")
    try:
        span = (int(first or 0), int(last)) if colon else (0, int(text) - 1)
    except ValueError:
        raise InputError(f"--frames: expected FIRST:LAST or N, e.g. 0:399 or 400, found {text!r}") from None
    if not 0 <= span[0] <= span[1]:
        raise InputError(f"--frames: expected FIRST:LAST with FIRST not after LAST, found {text!r}")
    return span
