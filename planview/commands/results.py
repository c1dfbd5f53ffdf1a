"""``planview report``, ``plot``, ``render`` and ``view``: a run shown to people."""

from __future__ import annotations

from planview.api import results as api
from planview.api import view as viewer
from planview.commands.options import say
from planview.commands.shell import Call, command
from planview.output.progress import PlainConsole


@command(api.report)
def report(call: Call) -> None:
    reports = call()
    for file in reports.files:
        say(file)
    if len(reports.files) > 1:
        PlainConsole().print(reports)


@command(api.plot, names={"colour": ["--colour", "--color"]})
def plot(call: Call) -> None:
    call()
    say(api.plot_file(*call["runs"], out=call["out"]))


@command(api.render, names={"out": ["--out", "--video", "--png"]})
def render(call: Call) -> None:
    say(call())


@command(viewer.view)
def view(call: Call) -> None:
    call()
