"""``planview edit``, ``refine`` and ``export``: tracks changed, and written for other programs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from planview.api import tracks as api
from planview.commands.options import plural, say
from planview.commands.shell import JSON, Call, command
from planview.output.finished import scores_of_refinement
from planview.output.progress import PlainConsole


@command(api.edit, names={"out": "RUN"}, own=JSON)
def edit(call: Call) -> None:
    result = call()
    if not call.prints_json(result._asdict()):
        say(
            f"{call['out'] / 'tracks.csv'}: people {result.people_before} -> {result.people}, "
            f"rows {result.rows_before:,} -> {result.rows:,}; {result.steps or 'nothing'} left to undo"
        )


@command(api.refine, names={"out": "RUN"}, own=JSON)
def refine(call: Call) -> None:
    refined = call()
    out = call["out"]
    counts = dict.fromkeys(("join", "smooth"), 0) | Counter(change.kind for change in refined.changes)
    if call.prints_json({"changes": counts, "rows": len(refined.tracks)}):
        return
    say(f"{out / 'tracks.csv'}: {plural(counts['join'], 'join')}, {plural(counts['smooth'], 'path')} smoothed")
    if scores := scores_of_refinement(out):
        say(f"{scores}\nplanview edit {out} --undo takes the refinement back")


@command(api.export, options=["to"], types={"out": Annotated[Path | None, Parameter(allow_leading_hyphen=True)]})
def export(call: Call) -> None:
    if call["cloud"]:
        with PlainConsole(stderr=True).status("opening the recording, finding the floor, matching"):
            result = call()
        say(f"{result.path}: {result.rows:,} points [m], origin on the floor below the camera, z up")
    elif (result := call()).path != Path("-"):
        say(f"{result.path}: {result.rows:,} rows of {result.people} people, {result.fps:g} frames per second")
