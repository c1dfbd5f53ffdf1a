"""What commands say: sentences with options in place of Python's arguments."""

from __future__ import annotations

import re
from collections.abc import Mapping

from calib.errors import InputError, WorkError
from calib.formats.one_camera import LensOnlyError


def typed(error: InputError | WorkError, options: Mapping[str, str]) -> str:
    """The sentence of an error with options in place of Python's arguments, and with the command that writes a
    camera.toml, or the trackers of one camera, where these are needed."""

    def option(argument: str) -> str:
        name = argument.partition("=")[0]  # of a switch with its value
        return options.get(name, f"--{name.replace('_', '-')}")

    sentence = re.sub(r"^(\w+)=: ", lambda argument: f"{option(argument[1])}: ", error.sentence(option))
    if error.remedy == "camera" or isinstance(error, LensOnlyError):
        focal = f" --focal {error.focal_px:.0f}" if isinstance(error, LensOnlyError) else ""
        sentence += f" (planview calibrate human VIDEO --auto{focal} --out camera.toml writes one)"
    if error.remedy == "calibration":
        sentence += (
            " FILE with one (of planview, OpenCV, Kalibr, ROS, ZED or DepthAI); or planview calibrate board PHOTOS "
            "--square 24mm --out rig.toml makes one from photos of a chessboard in both cameras; or track one camera: "
            "planview calibrate human VIDEO --auto --out camera.toml, then planview run VIDEO --tracker human-model "
            "--calibration camera.toml --out out"
        )
    if error.remedy == "tracker":
        sentence += " ellipse-particle, or --tracker human-model and --calibration camera.toml"
    return sentence


def say(text: object) -> None:
    """Print a message to standard error, its lines as they are."""
    from planview.commands.console import PlainConsole  # of rich, which some commands do without

    PlainConsole(stderr=True, soft_wrap=True, highlight=False).print(str(text))
