"""The suite: scenes of a seed, rendered once, tracked and scored."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.members import draw_scene
from benchmarks.options import Report, benchmark, cache_folder, json_text, progress, rendered, scene_files
from benchmarks.passes import (
    Pass,
    SceneScore,
    error_notes,
    provenance,
    run_pass,
    score_table,
    scores_json,
    watched,
)
from calib.errors import WorkError
from calib.io import load_toml, write_whole
from planview.api.arguments import in_range
from planview.engine.config import Config, load_config
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.finished import refine_run
from planview.synthetic.assets import SCENES
from planview.synthetic.scene import Scene, load_scene
from planview.trajectories.table import Trajectories, read_tracks, read_truth

SUITE = SCENES / "suite"
Way = Literal["online", "refined"]
"""Tracks as they came, and those refined afterwards."""
JUDGING_SEED = 100
"""The engine is tuned on seeds below; seeds from here on judge it, each once."""
OVER_S = 10.0
"""Scenes may be this much longer together than the minutes of the target [s]."""


@dataclass(frozen=True)
class SuiteJob:
    """A scene of a seed to be rendered, tracked and scored.

    Attributes:
        cache: folder of rendered recordings and of runs over them.
        out: gets a copy of the run.
        refine: also score the refined tracks.
    """

    path: Path
    seed: int
    cache: Path
    out: Path | None
    config: Config
    tracker: str = "joint"
    refine: bool = False

    @property
    def name(self) -> str:
        """Scene and seed."""
        return f"{self.path.stem}-{self.seed}"


def choose_files(files: Sequence[Path], seed: int, minutes: float) -> list[Path]:
    """Scenes of a seed, shuffled by it, that last about that many minutes together; all when that is enough.

    Scenes keep their length, so that a recording rendered for few minutes serves for many.
    """
    chosen: list[Path] = []
    left_s = 60.0 * minutes
    for place in np.random.default_rng([seed, 10]).permutation(len(files)):
        path = files[place]
        length_s = load_scene(path).duration_s
        if not chosen or length_s <= left_s + OVER_S:
            chosen.append(path)
            left_s -= length_s
    return sorted(chosen)


def suite_recording(path: Path, seed: int, cache: Path) -> tuple[Path, Scene]:
    """The recording of the member of a scene that a seed draws, and the member; from the cache when it is there."""
    scene = draw_scene(load_toml(path, "a scene in TOML"), seed, path.stem)
    return rendered(scene, f"suite-{path.stem}-{seed}", cache), scene


def run_job(job: SuiteJob) -> dict[Way, SceneScore] | str:
    """Render, track (both once, from the cache when they are there) and score one scene in every way that was chosen;
    or why it cannot be made, or the engine refuses it."""
    try:
        recording, scene = suite_recording(job.path, job.seed, job.cache)
        folder = run_pass(Pass(recording, job.cache, job.config, job.tracker))
    except WorkError as error:
        return f"{job.name}: {error}"
    if job.out is not None:
        folder = Path(shutil.copytree(folder, job.out / job.name, dirs_exist_ok=True))
    tracks: dict[Way, Trajectories] = {"online": read_tracks(folder / "tracks.csv")}
    if job.refine:
        tracks["refined"] = refined_tracks(folder)
    truth = read_truth(recording / "truth.csv")
    duration_s = scene.n_frames / scene.fps
    scores: dict[Way, SceneScore] = {}
    for way, some in tracks.items():
        evaluation = evaluate_tracks(some, truth)
        scores[way] = SceneScore(job.path.stem, job.seed, evaluation, recording, scene.n_frames, duration_s, folder)
    return scores


def refined_tracks(folder: Path) -> Trajectories:
    """The tracks of a run refined as ``planview refine`` does, in a copy of its folder."""
    with tempfile.TemporaryDirectory(prefix="planview-refine-") as temporary:
        copy = Path(shutil.copytree(folder, Path(temporary) / "run"))
        refine_run(copy)
        return read_tracks(copy / "tracks.csv")


def score_jobs(jobs: Sequence[SuiteJob], at_once: int) -> tuple[dict[Way, list[SceneScore]], list[str]]:
    """The scores of every way in the order of the jobs, and why some are left out."""
    results = dict(watched(run_job, jobs, at_once))
    scores: dict[Way, list[SceneScore]] = {}
    left_out = []
    for job in jobs:
        result = results[job]
        if isinstance(result, str):
            left_out.append(result)
            progress(f"left out: {result}")
            continue
        for way, score in result.items():
            scores.setdefault(way, []).append(score)
    return scores, left_out


def new_seed() -> int:
    """A judging seed from the clock, which has most likely never been rendered."""
    return JUDGING_SEED + (time.time_ns() // 1_000_000 ^ os.getpid()) % 1_000_000_000


@benchmark
def suite(
    *,
    seed: Sequence[int] = (),
    minutes: float = 10.0,
    scene: Sequence[str] = (),
    jobs: int = 1,
    scenes: Path = SUITE,
    tracker: str = "joint",
    refine: bool = False,
    out: Path | None = None,
    cache: Path | None = None,
    config: Path | None = None,
    overrides: Sequence[str] = (),
) -> Report:
    """Render the scenes of a seed, track them and score them.

    A seed draws a member of every committed scene: mirrored or not, other places, times and speeds, clothes, heights,
    light, floor and walls, and another stereo pair that looks nearly there. People who wander take other ways.

    Seeds 0 to 99 are for tuning the engine; seeds from 100 on are for judging it, each once. Rendered recordings, and
    runs of the present code over them, are kept in the cache: an interrupted suite resumes.

    Example: python -m benchmarks suite --seed 1 --minutes 3 --jobs 2 --refine

    Args:
        seed: Seeds of the scenes. Default: a new one from the clock, on which nothing was tuned.
        minutes: Length of the scenes of each seed together [min]; the seed decides which.
        scene: Only these scenes, by name.
        jobs: Recordings processed at the same time, each in a process of its own.
        scenes: Folder with scenes.
        tracker: One of planview run, or peaks, the baseline of height peaks.
        refine: Score the refined tracks, too.
        out: Folder that keeps the runs (tracks.csv, run.json) and suite.json; nothing is kept by default.
        cache: Folder for rendered recordings; the user's cache by default.
        config: TOML file with parameters of the engine.
        overrides: One parameter of the engine; can be repeated.
    """
    in_range("jobs", jobs, 1, 10_000)
    in_range("minutes", minutes, 0.01, 1000)
    for value in seed:
        in_range("seed", value, 0, 2**62)
    files = scene_files(scene, scenes)
    settings = load_config(config, overrides)
    seeds = list(dict.fromkeys(seed)) or [new_seed()]
    progress("seeds: " + ", ".join(f"{one}{' (tuned on)' * (one < JUDGING_SEED)}" for one in seeds))
    folder = cache_folder(cache)
    work = []
    for one in seeds:
        for path in choose_files(files, one, minutes):
            work.append(SuiteJob(path, one, folder, out, settings, tracker, refine))
    scores, left_out = score_jobs(work, jobs)
    values: dict[str, Any] = {"seeds": seeds, "left_out": left_out, **provenance()}
    tables = []
    notes = []
    for way, some in scores.items():
        values[way] = scores_json(some)
        tables.append(score_table(f"scene, {way}", some))
        notes += error_notes(f"scene, {way}", some)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_whole(out / "suite.json", json_text(values))
    return Report(values, tables, notes)
