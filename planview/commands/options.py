"""What commands say: sentences with options in place of Python's arguments."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable

from calib.errors import InputError, WorkError
from calib.formats.one_camera import NoCameraError

OPTIONS = {"overrides": "--set", "config": "--set", "everything": "--all", "file": "--list"}
"""Of arguments whose option is called otherwise; a configuration is wrong only by what --set adds to its file."""


def option_of(argument: str) -> str:
    """The option of an argument, or of a switch with its value."""
    name = argument.partition("=")[0]
    return OPTIONS.get(name, f"--{name.replace('_', '-')}")


def typed(error: InputError | WorkError) -> str:
    """The sentence of an error with options in place of Python's arguments, and with the command that writes a
    camera.toml, or the trackers of one camera, where these are needed."""
    sentence = re.sub(r"^(\w+)=: ", lambda argument: f"{option_of(argument[1])}: ", error.sentence(option_of))
    if isinstance(error, NoCameraError):
        focal = f" --focal {error.focal_px:.0f}" if error.focal_px else ""
        sentence += f" (planview calibrate human VIDEO --auto{focal} --out camera.toml writes one)"
    elif error.remedy == "calibration":
        sentence += (
            " FILE with one (of planview, OpenCV, Kalibr, ROS, ZED or DepthAI); or planview calibrate board PHOTOS "
            "--square 24mm --out rig.toml makes one from photos of a chessboard in both cameras; or track one camera: "
            "planview calibrate human VIDEO --auto --out camera.toml, then planview run VIDEO --tracker human-model "
            "--calibration camera.toml --out out"
        )
    if error.remedy == "tracker":
        sentence += " ellipse-particle, or --tracker human-model and --calibration camera.toml"
    return sentence


def usage_of(function: Callable[..., None], name: str) -> str:
    """The line with how a command is typed."""
    words = [f"Usage: planview {name.replace('_', ' ')}"]
    for one in inspect.signature(function).parameters.values():
        shown = one.name.upper()
        is_needed = one.default is one.empty
        if one.kind is one.VAR_POSITIONAL:
            words.append(f"{shown.removesuffix('S')} ...")
        elif one.kind is not one.KEYWORD_ONLY:
            words.append(shown if is_needed else f"[{shown}]")
        elif is_needed:
            words.append(f"{option_of(one.name)} VALUE")
    return " ".join([*words, "[OPTIONS]"])


def say(text: object) -> None:
    """Print a message to standard error, its lines as they are."""
    from planview.commands.console import PlainConsole  # of rich, which some commands do without

    PlainConsole(stderr=True, soft_wrap=True, highlight=False).print(str(text))
