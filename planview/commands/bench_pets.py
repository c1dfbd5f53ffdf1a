"""``planview bench pets``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from calib.errors import InputError
from planview.bench.pets import PetsScores, ellipse_particle_on_pets, human_model_on_pets


def bench_pets(
    folder: Path,
    *,
    camera: Path,
    tracker: Literal["both", "human-model", "ellipse-particle"] = "both",
    frames: int | None = None,
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Score the single-camera trackers on PETS S2-L1 view 1.

    Example: planview bench pets ../shared/data/pets09-s2l1-view001 --camera camera.toml

    Parameters
    ----------
    folder
        Folder with view001.mp4 and gt.txt.
    camera
        camera.toml, e.g. from planview calibrate human with tests/data/pets_people.json.
    tracker
        Which tracker to score.
    frames
        At most so many frames.
    json_output
        Print one JSON object on stdout.
    """
    if frames is not None and frames < 1:
        raise InputError(f"--frames: expected at least 1, found {frames}")
    runs = {"human-model": human_model_on_pets, "ellipse-particle": ellipse_particle_on_pets}
    console = Console(stderr=True)
    scores = []
    for name, run in runs.items():
        if tracker in ("both", name):
            with console.status(f"{name} on {folder}"):
                scores.append(run(folder, camera, frames))
    if json_output:
        print(json.dumps({s.tracker: _json(s) for s in scores}))
    else:
        console.print(_table(scores))


def _json(scores: PetsScores) -> dict[str, Any]:
    floor = scores.floor.to_json() if scores.floor is not None else None
    return {"frames": scores.frames, "boxes": scores.boxes.to_json(), "floor": floor}


def _table(scores: list[PetsScores]) -> Table:
    table = Table("tracker", "protocol", "truth rows", "MOTA", "IDF1", "HOTA", "switches", "misses", "false")
    for score in scores:
        for name, result in (("boxes, IoU 0.5", score.boxes), ("floor, 1 m", score.floor)):
            if result is not None:
                row = result.to_json()
                figures = [f"{row[key]:.3f}" if row[key] is not None else "-" for key in ("mota", "idf1", "hota")]
                counts = [str(row[key]) for key in ("switches", "misses", "false_positives")]
                table.add_row(score.tracker, name, str(row["truth_rows"]), *figures, *counts)
    return table
