"""``planview edit``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from calib.errors import InputError
from calib.text import read_text
from planview.commands.options import Flag, JsonFlag
from planview.output.finished import edit_run, read_steps, undo_edits
from planview.output.progress import PlainConsole
from planview.trajectories.regions import region_of

_Many = Annotated[Sequence[str], Parameter(negative="")]


@Parameter(name="*")
@dataclass(frozen=True)
class EditOptions:
    """What is done, in the order of these options; --list keeps the order of its lines, and comes first."""

    list: Path | None = None
    """File with an edit per line: "join 3 7", "split 5 120", "delete 9", "delete 9 100 200", "rename 4 12",
    "shorter 1.0", "join-gaps 2.0 0.6", "region POLYGON ((...))", "ignore POLYGON ((...))"; # begins a comment."""
    join: _Many = ()
    """A:B makes track B part of track A."""
    split: _Many = ()
    """ID@FRAME gives a track a new id from the frame on."""
    delete: _Many = ()
    """ID deletes a track, ID@FIRST:LAST its rows of these frames."""
    rename: _Many = ()
    """ID:NEW gives a track another id."""
    region: str | None = None
    """Well-known text, or a file with it: rows outside are deleted."""
    ignore: str | None = None
    """Well-known text, or a file with it: rows inside are deleted."""
    join_gaps: str | None = None
    """SECONDS:METRES joins tracks that begin within this time and distance of another one's end, nearest first."""
    shorter: float | None = None
    """Delete tracks that were confirmed for less, in seconds."""
    undo: Flag = False
    """Take the last call back."""
    undo_all: Flag = False
    """Take all calls back: tracks.csv is what it was."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def edit(out: Path, *, options: EditOptions | None = None) -> None:
    """Join, split, delete and rename tracks of a finished run, one by one or by rule; every edit can be taken back.

    edits.json says what was done, and tracks_before.csv keeps the tracks without any edit. Counts are not made again:
    planview count does.

    Example: planview edit out --join 3:7 --split 5@120 --delete 9

    Example by rule: planview edit out --join-gaps 2:0.6 --shorter 1 --ignore "POLYGON ((0 0, 2 0, 2 1, 0 1))"

    Example: planview edit out --undo

    Parameters
    ----------
    out
        Folder of a finished run.
    """
    options = options or EditOptions()
    lines = _lines(options)
    if options.undo + options.undo_all + bool(lines) > 1:
        raise InputError("expected edits, --undo or --undo-all, found several of these")
    if options.undo or options.undo_all:
        result = undo_edits(out, len(read_steps(out)) if options.undo_all else 1)
    elif lines:
        result = edit_run(out, lines)
    else:
        raise InputError("expected at least one edit (--join, --delete, ...; planview edit --help), found none")
    figures = {
        "steps": len(result.steps),
        "rows_before": len(result.before),
        "rows": len(result.after),
        "people_before": len(set(result.before.track_id.tolist())),
        "people": len(set(result.after.track_id.tolist())),
    }
    if options.json_output:
        print(json.dumps(figures))
        return
    PlainConsole(stderr=True, soft_wrap=True, highlight=False).print(
        f"{out / 'tracks.csv'}: {figures['people_before']} tracks became {figures['people']}, "
        f"{figures['rows_before']} rows {figures['rows']} ({figures['steps']} calls of edit to undo)"
    )


def _lines(options: EditOptions) -> list[str]:
    """The options as lines of ``planview.offline.edit``."""
    lines = [] if options.list is None else _listed(options.list)
    for kind in ("join", "split", "delete", "rename"):
        lines += [f"{kind} {edit.replace(':', ' ').replace('@', ' ')}" for edit in getattr(options, kind)]
    for kind, text in (("region", options.region), ("ignore", options.ignore)):
        lines += [f"{kind} {region_of(text, f'--{kind}').wkt}"] if text is not None else []
    lines += [f"join-gaps {options.join_gaps.replace(':', ' ')}"] if options.join_gaps is not None else []
    return lines + ([f"shorter {options.shorter:g}"] if options.shorter is not None else [])


def _listed(path: Path) -> list[str]:
    lines = (line.partition("#")[0].strip() for line in read_text(path, "a list of edits").splitlines())
    return [line for line in lines if line]
