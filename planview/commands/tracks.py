"""``planview edit``, ``refine`` and ``export``: tracks changed, and written for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from planview.api import tracks as api
from planview.commands.options import say
from planview.commands.shell import JSON, QUIET, Call, command
from planview.output.finished import scores_of_refinement


@command(api.edit, own=JSON)
def edit(call: Call) -> None:
    """Example: planview edit out --join 3:7 --split 5@120 --delete 9

    Example by rule: planview edit out --join-gaps 2:0.6 --shorter 1 --ignore "POLYGON ((0 0, 2 0, 2 1, 0 1))"

    Example: planview edit out --undo
    """
    found = call()
    if not call.prints_json(found.to_json()):
        say(found)


@command(api.refine, own=JSON)
def refine(call: Call) -> None:
    """Example: planview refine out"""
    found = call()
    if call.prints_json(found.to_json()):
        return
    say(found)
    scores = scores_of_refinement(call["run"])
    if scores:
        say(f"{scores}\nplanview edit {call['run']} --undo takes the refinement back")


FILE = Annotated[Path | None, Parameter(allow_leading_hyphen=True)]


@command(api.export, options=["to"], types={"out": FILE}, own=QUIET)
def export(call: Call) -> None:
    """Example: planview export out --to pedpy --out tracks.txt

    Example of one room: planview export out --to csv --region "POLYGON ((0 0, 4 0, 4 3, 0 3, 0 0))"

    Example of a stream: planview export out --to jsonl --out - | head

    Example of the scene, in metres on the axes of the tracks: planview export out --cloud scene.ply
    """
    found = call()
    if found.value != Path("-"):
        say(found)
