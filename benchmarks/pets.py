"""The single-camera trackers on PETS S2-L1 view 1, with boxes and on the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple

import numpy as np
from cyclopts import Parameter

from benchmarks.options import JsonFlag, progress, report
from calib.errors import InputError
from calib.ground_camera import load_ground_camera, save_ground_camera
from planview.engine.config import Config
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.output.script import run
from planview.trajectories.formats import load_truth

SingleTracker = Literal["human-model", "ellipse-particle"]
FPS = 7.0
"""Nominal frame rate of the sequence."""
PRINTED_FIGURES = ("truth_rows", "mota", "idf1", "hota", "switches", "misses", "false_positives")


class PetsScores(NamedTuple):
    """Scores of one run of one tracker: with boxes at IoU 0.5, and on the floor with a gate of 1 m, after the rigid
    motion between the two world frames, where tracks have positions."""

    tracker: SingleTracker
    frames: int
    boxes: Evaluation
    floor: Evaluation | None

    def rows(self, whole: bool) -> list[dict[str, Any]]:
        """A row per protocol, with every figure or the most important ones."""
        rows = []
        for protocol, result in (("boxes, IoU 0.5", self.boxes), ("floor, 1 m", self.floor)):
            if result is not None:
                figures = result.to_json()
                named = {"tracker": self.tracker, "protocol": protocol, "tracked_frames": self.frames}
                rows.append(named | {name: figures[name] for name in (figures if whole else PRINTED_FIGURES)})
        return rows


def spread(runs: Sequence[PetsScores]) -> list[dict[str, Any]]:
    """Mean, deviation and range over several runs, a row per protocol."""
    rows = []
    for protocol, results in (("boxes", [one.boxes for one in runs]), ("floor", [one.floor for one in runs])):
        scored = [result for result in results if result is not None]
        mota = np.array([math.nan if result.clear.mota is None else result.clear.mota for result in scored])
        idf1 = np.array([math.nan if result.idf1 is None else result.idf1 for result in scored])
        if scored:
            figures = {"mota_mean": mota.mean(), "mota_deviation": mota.std(), "mota_range": np.ptp(mota)}
            figures |= {"idf1_mean": idf1.mean(), "idf1_deviation": idf1.std()}
            rows.append({"tracker": runs[0].tracker, "protocol": protocol, "runs": len(scored), **figures})
    return rows


def score_pets(
    tracker: SingleTracker, folder: Path, camera: Path | None, frames: int | None = None, seeds: int = 1
) -> list[PetsScores]:
    """Score runs of a tracker; without a camera.toml only boxes are scored.

    Args:
        seeds: number of runs, with seeds from 0 on. The human-model tracker draws no random numbers: its runs differ by
            1e-5 in the focal length of the camera.

    Raises:
        InputError: files that are missing or do not fit.
    """
    if camera is None or tracker == "ellipse-particle":
        return [_score(tracker, folder, camera, frames, seed) for seed in range(seeds)]
    with TemporaryDirectory() as place:
        like, nearby = load_ground_camera(camera), [Path(place) / f"{n}.toml" for n in range(seeds)]
        for n, path in enumerate(nearby):
            save_ground_camera(replace(like, focal_px=like.focal_px * (1.0 + 1e-5 * n)), path)
        return [_score(tracker, folder, path, frames, 0) for path in nearby]


def _score(tracker: SingleTracker, folder: Path, camera: Path | None, frames: int | None, seed: int) -> PetsScores:
    for name in ("gt.txt", "view001.mp4"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: expected a folder with {name} (PETS S2-L1 view 1), found none")
    truth = load_truth(folder / "gt.txt")
    tracked: list[int] = []
    tracks = run(
        folder / "view001.mp4", tracker=tracker, config=Config(seed=seed), camera=camera, frames=frames or 0,
        watch=lambda result: tracked.append(result.frame),
    )  # fmt: skip
    n = len(tracked)
    boxes = evaluate_tracks(tracks, truth, EvaluationParams(match_on="boxes", fps=FPS), (0, n - 1))
    on_floor = EvaluationParams(gate_m=1.0, align=True, fps=FPS)
    floor = None if camera is None else evaluate_tracks(tracks, truth, on_floor, (0, n - 1))
    return PetsScores(tracker, n, boxes, floor)


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
    """Only the first frames."""
    seeds: int = 1
    """Run the ellipse-particle tracker with this many seeds, the human-model tracker with this many cameras that are
    nearly alike, and print the spread of the scores."""
    json_output: JsonFlag = False
    """Print one JSON object on stdout."""


def pets(folder: Path, *, options: PetsOptions | None = None) -> None:
    """Score the single-camera trackers on PETS S2-L1 view 1.

    Example: python -m benchmarks pets ../shared/data/pets09-s2l1-view001 --camera camera.toml

    Example: python -m benchmarks pets ../shared/data/pets09-s2l1-view001 --tracker ellipse-particle --seeds 20

    Parameters
    ----------
    folder
        Folder with view001.mp4 and gt.txt.
    """
    o = options or PetsOptions()
    if (o.frames is not None and o.frames < 1) or not 1 <= o.seeds <= 1000:
        raise InputError(f"expected --frames from 1, --seeds 1 to 1000, found {o.frames}, {o.seeds}")
    if o.camera is None and o.tracker != "ellipse-particle":
        raise InputError("--camera: the human-model tracker needs a camera.toml (see planview calibrate human)")
    runs: list[list[PetsScores]] = []
    progress(f"tracking {folder}")
    if o.tracker != "ellipse-particle":
        runs.append(score_pets("human-model", folder, o.camera, o.frames, o.seeds))
    if o.tracker != "human-model":
        runs.append(score_pets("ellipse-particle", folder, o.camera, o.frames, seeds=o.seeds))
    report(
        o.json_output,
        scores=[row for first, *_ in runs for row in first.rows(whole=o.json_output)],
        spread=[row for some in runs if len(some) > 1 for row in spread(some)],
    )
