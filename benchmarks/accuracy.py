"""Accuracy on rendered recordings with exact truth: render (once), track, score."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.passes import BenchTracker, bench_engine
from calib.errors import InputError, WorkError
from calib.io import reason
from planview.engine.config import Config
from planview.engine.engine import Engine, FrameResult
from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.output.folder import prepare_folder
from planview.output.run import RunOptions
from planview.output.run import run as run_engine
from planview.synthetic.assets import SCENES
from planview.synthetic.random_scenes.suite import varied
from planview.synthetic.render import RENDERER_VERSION, SceneRenderer
from planview.synthetic.scene import Scene, load_scene
from planview.synthetic.write import write_recording
from planview.trajectories.table import Trajectories, TrajectoryCollector, read_truth

LIMITS = {"significant_errors": 1, "position_error_m": 0.10, "height_error_m": 0.06}
"""What all scenes together must keep (the paper: one significant error in ten minutes, 18 cm)."""

Tell = Callable[[str], None]


@dataclass(frozen=True)
class RenderOptions:
    """How scenes are rendered: where they are kept, factor on the image size, at most so many frames."""

    cache: Path
    scale: float = 1.0
    frames: int | None = None


@dataclass(frozen=True)
class SceneScore:
    """A scene's scores.

    Attributes:
        name, seed: which recording.
        evaluation: from ``evaluate_tracks``.
        folder: where tracks.csv and run.json are; None when they were not kept.
    """

    name: str
    seed: int
    evaluation: Evaluation
    folder: Path | None

    def to_json(self) -> dict[str, Any]:
        return {
            "scene": self.name,
            "seed": self.seed,
            "out": str(self.folder) if self.folder else None,
            **self.evaluation.to_json(),
        }


@dataclass(frozen=True)
class Totals:
    """All recordings together; errors are pooled over matches, MOTA over truth rows.

    Attributes:
        truth_rows: that count.
        significant: number of significant errors by kind and in total.
        ok: whether all limits are kept.
    """

    truth_rows: int
    mota: float
    position_error_m: float
    position_std_m: float
    height_error_m: float
    significant: dict[str, int]
    ok: bool


def scene_files(names: Sequence[str] = (), folder: Path = SCENES) -> list[Path]:
    """Scene files by name; every stereo scene of the folder when none is named.

    Raises:
        InputError: no such scene.
    """
    known = {path.stem: path for path in sorted(folder.glob("*.toml"))}
    for name in names:
        if name not in known:
            raise InputError(f"--scene: expected one of {', '.join(known) or 'none'} in {folder}, found {name!r}")
    return [known[name] for name in names or known]


def cache_folder() -> Path:
    """Where rendered recordings are kept: $XDG_CACHE_HOME or ~/.cache, below planview/scenes."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "planview" / "scenes"


def rendered(scene: Scene, name: str, options: RenderOptions, tell: Tell) -> Path:
    """The recording of a scene, rendered unless the cache has it.

    The key is a hash of everything in the scene, the renderer's version and the size; a recording appears in the cache
    only when it is whole.

    Raises:
        WorkError: the cache cannot be written.
    """
    without = {"capture"} if scene.capture is None else None
    text = f"{scene.model_dump_json(exclude=without)} {RENDERER_VERSION} {options.scale} {options.frames}"
    cache = options.cache
    folder = cache / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    if folder.is_dir():
        return folder
    tell(f"rendering {name}")
    try:
        cache.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{name}-", dir=cache))
    except OSError as error:
        raise WorkError(f"{cache}: the cache cannot be written: {reason(error)}") from error
    try:
        write_recording(SceneRenderer(scene, options.scale), part, frames=options.frames, storage="jpg")
        if not folder.is_dir():
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def score_scene(
    path: Path,
    seed: int,
    options: RenderOptions,
    out: Path | None,
    config: Config,
    tell: Tell,
    tracker: BenchTracker = "template",
) -> SceneScore:
    """Render, track and score one scene.

    Args:
        path: a stereo scene.
        seed: 0 for the scene itself, else a variation (``planview.synthetic.random_scenes.suite``).
        options: of rendering.
        out: folder that gets a folder with the run; None to keep nothing.
        config: of the pipeline.
        tell: takes messages of progress.
    Raises:
        InputError: the scene is refused, or has a single camera.
    """
    scene = load_scene(path)
    if scene.rig is None:
        raise InputError(f"{path}: expected a scene with a [rig], found a single camera")
    name = path.stem if seed == 0 else f"{path.stem}-{seed}"
    recording = rendered(varied(scene, seed), name, options, tell)
    tell(f"tracking {name}")
    folder = out / name if out else None
    tracks = tracked(bench_engine(recording, tracker, config), folder, tracker)
    return SceneScore(path.stem, seed, evaluate_tracks(tracks, read_truth(recording / "truth.csv")), folder)


def tracked(engine: Engine, folder: Path | None, tracker: BenchTracker) -> Trajectories:
    """All tracks of a recording; the run is kept in a folder unless that is None."""
    tracks = TrajectoryCollector()

    def collect(result: FrameResult) -> None:
        tracks.add(result.frame, result.timestamp_s, result.tracks)

    if folder is None:
        for result in engine:
            collect(result)
    else:
        prepare_folder(folder, overwrite=True)
        run_engine(engine, folder, RunOptions(tracker=tracker), watch=collect)
    return tracks.trajectories()


def totals(scores: Sequence[SceneScore]) -> Totals:
    """All recordings together."""
    every = [score.evaluation for score in scores]
    rows = sum(e.truth_rows for e in every)
    wrong = sum(e.clear.misses + e.clear.false_positives + e.clear.switches for e in every)
    position = np.concatenate([e.position_error_m for e in every] or [np.empty(0)])
    height = np.concatenate([e.height_error_m for e in every] or [np.empty(0)])
    kinds = [str(error.kind) for e in every for error in e.significant]
    significant = {"total": len(kinds)} | {kind: kinds.count(kind) for kind in sorted(set(kinds))}
    mean = float(position.mean()) if len(position) else float("nan")
    tall = float(height.mean()) if len(height) else float("nan")
    ok = (
        len(kinds) <= LIMITS["significant_errors"]
        and not mean > LIMITS["position_error_m"]
        and not tall > LIMITS["height_error_m"]
    )
    spread = float(position.std()) if len(position) else float("nan")
    return Totals(rows, 1 - wrong / rows if rows else float("nan"), mean, spread, tall, significant, ok)
