"""``planview doctor``."""

from __future__ import annotations

import json
import math
from pathlib import Path

from rich.table import Table

from calib.errors import InputError, WorkError
from calib.length import parse_length
from planview.checks.check import Check
from planview.checks.examine import Diagnosis, examine, write_pictures
from planview.commands.options import JsonFlag
from planview.engine.config import load_config
from planview.engine.setup import floor_search
from planview.output.progress import PlainConsole


def doctor(
    recording: Path,
    *,
    calibration: Path | None = None,
    person_height: str | None = None,
    frames: int = 60,
    out: Path | None = None,
    config: Path | None = None,
    json_output: JsonFlag = False,
) -> None:
    """Check a recording and its calibration before trusting results; exit status 1 when a check fails.

    Example: planview doctor recording --person-height 1.78m --out pictures

    Parameters
    ----------
    recording
        Folder (or side-by-side video) of the recording.
    calibration
        Calibration file or folder, instead of the one beside the recording.
    person_height
        Height of a person who walks through, e.g. 1.78m: checks baseline and units.
    frames
        Consecutive frames to look at for movement, besides those in which a run measures its floor.
    out
        Folder for pictures: rectified rows, disparity, floor, exposure.
    config
        TOML file with the parameters of the run to come: analysis.setup_frames and tables rectify, sgbm, range, floor.
    json_output
        Print one JSON object.
    """
    if not 4 <= frames <= 2000:
        raise InputError(f"--frames: expected 4 to 2000, found {frames}")
    known = None if person_height is None else _height(person_height)
    diagnosis = examine(
        recording, calibration, frames=frames, person_height_m=known, search=floor_search(load_config(config))
    )
    if json_output:
        print(json.dumps(diagnosis.to_json(), allow_nan=False))
    else:
        PlainConsole(markup=True).print(table(diagnosis))
    if out is not None and diagnosis.evidence is not None:
        for path in write_pictures(diagnosis.evidence, out):
            PlainConsole(stderr=True).print(f"wrote {path}", highlight=False)
    failed = [check for check in diagnosis.checks if not check.ok]
    if failed:
        raise WorkError(
            f"{recording}: {len(failed)} of {len(diagnosis.checks)} checks failed: "
            + "; ".join(f"{c.name} ({c.note})" for c in failed)
        )


def table(diagnosis: Diagnosis) -> Table:
    """The checks as a table for people."""
    result = Table(title="planview doctor: " + ("passed" if diagnosis.ok else "refused"))
    result.add_column("")
    result.add_column("check")
    result.add_column("value", justify="right")
    result.add_column("limit", justify="right")
    result.add_column("meaning")
    for check in diagnosis.checks:
        mark = "[green]ok[/]" if check.ok else "[bold red]NO[/]"
        result.add_row(mark, check.name, value_text(check), limit_text(check), check.note)
    return result


def value_text(check: Check) -> str:
    """Value with unit; a dash when it could not be measured."""
    return f"{check.value:.3g} {check.unit}".strip() if math.isfinite(check.value) else "-"


def limit_text(check: Check) -> str:
    """The bound in words."""
    if isinstance(check.limit, tuple):
        return f"{check.limit[0]:.3g} to {check.limit[1]:.3g}"
    return "" if check.limit is None else f"{check.rule} {check.limit:.3g}"


def _height(text: str) -> float:
    bare = text.strip().replace(".", "", 1).isdigit()
    height = parse_length(f"{text}m" if bare else text, "--person-height")
    if not 0.5 <= height <= 2.5:
        raise InputError(f"--person-height: expected 0.5 to 2.5 m, found {height:g} m")
    return height
