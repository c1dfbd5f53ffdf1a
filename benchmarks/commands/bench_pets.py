"""``python -m benchmarks pets``."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from benchmarks.commands.options import JsonFlag
from benchmarks.pets import PetsScores, ellipse_particle_on_pets, human_model_on_pets
from calib.errors import InputError


@Parameter(name="*")
@dataclass(frozen=True)
class PetsOptions:
    """Which trackers are scored, and on how much."""

    camera: Path | None = None
    """camera.toml, e.g. from planview calibrate human with tests/data/pets_people.json; the ellipse-particle tracker
    needs none, but is scored on the floor with one."""
    tracker: Literal["both", "human-model", "ellipse-particle"] = "both"
    """Which tracker to score."""
    frames: int | None = None
    """At most so many frames."""
    seeds: int = 1
    """Run the ellipse-particle tracker with so many seeds, and give the spread of its scores."""
    cameras: int = 1
    """Run the human-model tracker with so many cameras within 0.5 degrees and 3 % of the given one, and give the range
    of its scores."""
    json_output: JsonFlag = False
    """Print one JSON object on stdout."""


def bench_pets(folder: Path, *, options: PetsOptions | None = None) -> None:
    """Score the single-camera trackers on PETS S2-L1 view 1.

    Example: python -m benchmarks pets ../shared/data/pets09-s2l1-view001 --camera camera.toml

    Example: python -m benchmarks pets ../shared/data/pets09-s2l1-view001 --tracker ellipse-particle --seeds 20

    Parameters
    ----------
    folder
        Folder with view001.mp4 and gt.txt.
    """
    options = options or PetsOptions()
    if options.frames is not None and options.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {options.frames}")
    if not 1 <= options.seeds <= 1000:
        raise InputError(f"--seeds: expected 1 to 1000, found {options.seeds}")
    if not 1 <= options.cameras <= 100:
        raise InputError(f"--cameras: expected 1 to 100, found {options.cameras}")
    if options.camera is None and options.tracker != "ellipse-particle":
        raise InputError("--camera: the human-model tracker needs a camera.toml (see planview calibrate human)")
    console = Console(stderr=True)
    scores = []
    if options.camera is not None and options.tracker != "ellipse-particle":
        with console.status(f"human-model on {folder}"):
            scores.append(human_model_on_pets(folder, options.camera, options.frames, cameras=options.cameras))
    if options.tracker != "human-model":
        with console.status(f"ellipse-particle on {folder}"):
            scores.append(ellipse_particle_on_pets(folder, options.camera, options.frames, seeds=options.seeds))
    if options.json_output:
        print(json.dumps({s.tracker: _json(s) for s in scores}))
        return
    console.print(_table(scores))
    for score in scores:
        console.print(f"{score.tracker}: {_errors(score)}", highlight=False)


def _errors(scores: PetsScores) -> str:
    """Tracking errors, and their spread over seeds, in a sentence."""
    e, spread = scores.errors, scores.spread
    text = f"{e.total} tracking errors ({e.false_tracks} false tracks, {e.losses} losses, {e.switches} switches)"
    if scores.cameras is not None:
        near = scores.cameras.to_json()
        listed = ", ".join(f"{mota:.3f}" for mota in near["mota"])
        return f"{text}; over {len(near['mota'])} cameras MOTA is {listed}: a range of {near['mota_range']:.3f}"
    if spread is None:
        return text
    s = spread.to_json()
    return (
        f"{text}; over {len(spread.mota)} seeds MOTA has a deviation of {s['mota_deviation']:.3f} and a range of "
        f"{s['mota_range']:.3f}, and there are {s['errors_mean']:.1f} errors ({min(spread.errors)} to "
        f"{max(spread.errors)})"
    )


def _json(scores: PetsScores) -> dict[str, Any]:
    floor = scores.floor.to_json() if scores.floor is not None else None
    errors = {**asdict(scores.errors), "total": scores.errors.total}
    spread = scores.spread.to_json() if scores.spread is not None else None
    cameras = scores.cameras.to_json() if scores.cameras is not None else None
    boxes = scores.boxes.to_json()
    return {
        "frames": scores.frames,
        "boxes": boxes,
        "floor": floor,
        "tracking_errors": errors,
        "seeds": spread,
        "cameras": cameras,
    }


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
