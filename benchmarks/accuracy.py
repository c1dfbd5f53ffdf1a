"""Accuracy on the committed scenes, with exact truth: render (once), track, score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from benchmarks.options import BenchOptions, Rendering, json_text, progress, rendered, scene_files
from benchmarks.passes import SceneScore, bench_engine, print_scores, scores_json, together
from calib.errors import InputError
from planview.engine.config import Config
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.script import run
from planview.synthetic.assets import SCENES
from planview.synthetic.scene import load_scene
from planview.trajectories.table import read_truth

LIMITS = {"significant_errors": 1, "position_error_m": 0.10, "height_error_m": 0.06}
"""What all scenes together must keep (Harville 2002: one significant error in ten minutes, 18 cm)."""


def score_scene(path: Path, rendering: Rendering, out: Path | None, config: Config, tracker: str) -> SceneScore:
    """Render, track and score a stereo scene; ``out`` gets a folder with the run. Raises InputError: the scene is
    refused, or has a single camera."""
    scene = load_scene(path)
    if scene.rig is None:
        raise InputError(f"{path}: expected a scene with a [rig], found a single camera")
    name = path.stem
    recording = rendered(scene, name, rendering)
    progress(f"tracking {name}")
    folder = out / name if out else None
    tracks = run(bench_engine(recording, tracker, config), folder, overwrite=True)
    n_frames = rendering.frames or scene.n_frames
    evaluation = evaluate_tracks(tracks, read_truth(recording / "truth.csv"))
    return SceneScore(name, 0, evaluation, recording, n_frames, n_frames / scene.fps, folder)


@Parameter(name="*")
@dataclass(frozen=True)
class AccuracyOptions(BenchOptions):
    """What is rendered, tracked and scored."""

    scene: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these scenes, by name."""
    tracker: str = "joint"
    """Tracker that follows people: one of planview run, or peaks, the baseline of height peaks."""
    frames: int | None = None
    """Only the first frames of every scene."""
    scale: float = 1.0
    """Factor on the image size."""
    scenes: Path = SCENES
    """Folder with scenes."""
    out: Path | None = None
    """Folder that keeps the runs (tracks.csv, run.json); nothing is kept by default."""


def accuracy(*, options: AccuracyOptions | None = None) -> None:
    """Render every committed scene, track it and score it.

    Example: python -m benchmarks accuracy --scene crossing --scene group
    """
    o = options or AccuracyOptions()
    if (o.frames is not None and o.frames < 1) or not 0.05 <= o.scale <= 4:
        raise InputError(f"expected --frames from 1, --scale 0.05 to 4, found {o.frames}, {o.scale:g}")
    settings, rendering = o.settings(), Rendering(o.cache_folder, o.scale, o.frames)
    scores = [score_scene(path, rendering, o.out, settings, o.tracker) for path in scene_files(o.scene, o.scenes)]
    totals = together(scores).to_json()
    ok = (
        totals["significant_errors"]["total"] <= LIMITS["significant_errors"]
        and (totals["position_error_mean_m"] or 0.0) <= LIMITS["position_error_m"]
        and (totals["height_error_mean_m"] or 0.0) <= LIMITS["height_error_m"]
    )
    if o.json_output:
        print(json_text(scores_json(scores) | {"limits": LIMITS, "ok": ok}), end="")
        return
    print_scores("scene", scores)
    print(f"limits: {LIMITS}: {'kept' if ok else 'not kept'}")
