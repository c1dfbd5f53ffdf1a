"""``planview calibrate``: its commands, with examples, and what they print beyond the results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from cyclopts import Parameter

from planview.api import calibrate_pair as pair
from planview.api import calibrate_pose as pose
from planview.commands.options import say
from planview.commands.shell import JSON, QUIET, Call, command


@command(pair.align, own=JSON | QUIET)
def calibrate_align(call: Call) -> None:
    """Example:
    planview calibrate align hall/north hall/south --out hall/rigs.toml
    planview run hall --out out
    """
    if not call.says().files:
        say("no rigs.toml written: --out FILE keeps the result")


@command(pair.board, options=["square"], own=JSON | QUIET)
def calibrate_board(call: Call) -> None:
    """Example: planview calibrate board photos/ --square 24.23mm --out rig.toml"""
    call.says()


@command(pair.convert, own=JSON)
def calibrate_convert(call: Call) -> None:
    """Example: planview calibrate convert intrinsics.yml rig.toml --size 640x480 --unit 24.23mm"""
    call.says()


@command(pair.ui)
def calibrate_ui(call: Call) -> None:
    """Example: planview calibrate ui street.mp4 --out calibration"""
    call()


POINTS = Annotated[Sequence[str], Parameter(consume_multiple=True, negative="")]


@command(pose.floor, types={"points": POINTS}, own=JSON | QUIET)
def calibrate_floor(call: Call) -> None:
    """Example: planview calibrate floor my_recording --out floor/world.toml

    Example, for every later run on the recording: planview calibrate floor my_recording --save

    Example, floor given by hand: planview calibrate floor my_recording --points 120,400 500,420 320,250
    """
    found = call.says()
    if found.value.doubt:
        say(f"is that the floor? {found.value.doubt} (--points gives another floor)")
    if found.to_json()["world"] is None:
        say("no world.toml written: --save keeps this floor in the recording, --out FILE elsewhere")


@command(pose.human, own=JSON | QUIET)
def calibrate_human(call: Call) -> None:
    """Example: planview calibrate human samples.csv --image-size 640x480 --lens normal-wide --out camera.toml

    Example, from people who walk by: planview calibrate human street.mp4 --auto --lens normal
    """
    call.says()
