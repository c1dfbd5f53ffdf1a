"""``planview report``, ``plot``, ``render`` and ``view``: a run shown to people."""

from __future__ import annotations

from planview.api import results as api
from planview.api import view as viewer
from planview.commands.options import say
from planview.commands.shell import QUIET, Call, command


@command(api.report)
def report(call: Call) -> None:
    """Example: planview report out

    Example of two runs and what differs between them: planview report out/narrow out/wide
    """
    found = call()
    for page in found.files:
        say(page)
    if found.values:
        print(found)


@command(api.plot)
def plot(call: Call) -> None:
    """Example: planview plot out

    Example with the true paths, as vector graphics: planview plot out --truth recording/truth.csv --out paths.svg

    Example of the mean density of people over a picture of the floor: planview plot out --what density

    Example of two runs over each other: planview plot out/narrow out/wide --out both.png
    """
    call()
    say(api.plot_file(*call["runs"], out=call["out"]))


@command(api.render, own=QUIET)
def render(call: Call) -> None:
    """Example: planview render out --out out.webm

    Example of a picture: planview render out --frame 120 --out still.png
    """
    say(call())


@command(viewer.view)
def view(call: Call) -> None:
    """Example: planview view out

    Example on a machine without a display, then on yours, with a browser:
        planview view out --web
        ssh -L 9090:127.0.0.1:9090 -L 9876:127.0.0.1:9876 MACHINE
    """
    call()
