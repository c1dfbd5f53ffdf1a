"""The challenge suite: random scenes of a seed, rendered once, tracked and scored."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter

from benchmarks.options import BenchOptions, Flag, json_text, progress, rendered, scene_files
from benchmarks.passes import Pass, SceneScore, print_scores, provenance, run_pass, scores_json, watched
from benchmarks.random_scenes.generator import SUITE, random_scene
from calib.errors import InputError, WorkError
from calib.io import load_toml, write_whole
from planview.engine.config import Config
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.finished import refine_run
from planview.synthetic.scene import Scene
from planview.trajectories.table import Trajectories, read_tracks, read_truth

Way = Literal["online", "refined"]
"""Tracks as they came, and those refined afterwards."""
JUDGING_SEED = 100
"""The engine is tuned on seeds below; seeds from here on judge it, each once."""


@dataclass(frozen=True)
class SuiteJob:
    """A challenge of a seed to be rendered, tracked and scored, with ``refine`` also refined; ``cache``: folder of
    rendered recordings and of runs over them; ``out``: gets a copy of the run."""

    path: Path
    seed: int
    cache: Path
    out: Path | None
    config: Config
    tracker: str = "joint"
    refine: bool = False

    @property
    def name(self) -> str:
        return f"{self.path.stem}-{self.seed}"


def chosen_files(files: Sequence[Path], seed: int, minutes: float) -> list[Path]:
    """Scenes of a seed, shuffled by it, that last about that many minutes together; all when that is enough.

    Scenes keep their length, so that a recording rendered for few minutes serves for many.
    """
    lengths = {path: float(load_toml(path, "a challenge in TOML").get("duration_s", 30.0)) for path in files}
    chosen: list[Path] = []
    left = 60.0 * minutes
    for path in (files[k] for k in np.random.default_rng([seed, 10]).permutation(len(files))):
        if not chosen or lengths[path] <= left + 10.0:
            chosen.append(path)
            left -= lengths[path]
    return sorted(chosen)


def suite_recording(path: Path, seed: int, cache: Path) -> tuple[Path, Scene]:
    """The recording of a challenge, and its scene; from the cache when it is there."""
    scene = random_scene("suite", seed, path).scene
    return rendered(scene, f"suite-{path.stem}-{seed}", cache), scene


def run_job(job: SuiteJob) -> dict[Way, SceneScore] | str:
    """Render, track (both once, from the cache when they are there) and score one scene in every way asked for; or why
    no attempt fits into its room, or the engine refuses it."""
    try:
        recording, scene = suite_recording(job.path, job.seed, job.cache)
        kept = run_pass(Pass(recording, job.cache, job.config, job.tracker))
    except WorkError as error:
        return f"{job.name}: {error}"
    if job.out is not None:
        kept = Path(shutil.copytree(kept, job.out / job.name, dirs_exist_ok=True))
    tracks: dict[Way, Trajectories] = {"online": read_tracks(kept / "tracks.csv")}
    if job.refine:
        tracks["refined"] = refined_tracks(kept)
    truth, n = read_truth(recording / "truth.csv"), scene.n_frames
    return {
        way: SceneScore(job.path.stem, job.seed, evaluate_tracks(t, truth), recording, n, n / scene.fps, kept)
        for way, t in tracks.items()
    }


def refined_tracks(folder: Path) -> Trajectories:
    """The tracks of a run refined as ``planview refine`` does, in a copy of its folder."""
    with tempfile.TemporaryDirectory(prefix="planview-refine-") as temporary:
        copy = Path(shutil.copytree(folder, Path(temporary) / "run"))
        refine_run(copy)
        return read_tracks(copy / "tracks.csv")


def scored(jobs: Sequence[SuiteJob], at_once: int) -> tuple[dict[Way, list[SceneScore]], list[str]]:
    """The scores of every way in the order of the jobs, and why some are left out."""
    done, left_out = dict(watched(run_job, jobs, at_once)), []
    ways: dict[Way, list[SceneScore]] = {}
    for job in jobs:
        by_way = done[job]
        if isinstance(by_way, str):
            left_out.append(by_way)
            progress(f"left out: {by_way}")
        else:
            for way, score in by_way.items():
                ways.setdefault(way, []).append(score)
    return ways, left_out


@Parameter(name="*")
@dataclass(frozen=True)
class SuiteOptions(BenchOptions):
    """Which challenges are rendered, and how they are tracked."""

    seed: Annotated[Sequence[int], Parameter(negative="")] = ()
    """Seeds of the challenges. Default: a new one from the clock, on which nothing was tuned."""
    minutes: float = 10.0
    """Length of the challenges of each seed together [min]; the seed decides which. The whole suite is longer than ten
    minutes."""
    scene: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these challenges, by name."""
    jobs: int = 1
    """Recordings processed at the same time, each in a process of its own."""
    scenes: Path = SUITE
    """Folder with challenges."""
    tracker: str = "joint"
    """Tracker that follows people: one of planview run, or peaks, the baseline of height peaks."""
    refine: Flag = False
    """Score the refined tracks, too."""
    out: Path | None = None
    """Folder that keeps the runs (tracks.csv, run.json) and suite.json; nothing is kept by default."""

    def files(self) -> list[Path]:
        """The challenges named. Raises InputError: there is none of a name, or a number out of its range."""
        if self.jobs < 1 or not 0 < self.minutes <= 1000 or any(s < 0 for s in self.seed):
            raise InputError(
                f"expected --jobs from 1, --minutes above 0, --seed from 0, "
                f"found {self.jobs}, {self.minutes:g}, {self.seed}"
            )
        return scene_files(self.scene, self.scenes)


def suite(*, options: SuiteOptions | None = None) -> None:
    """Render the challenges of a seed, track them and score them.

    Every seed is another recording of every scene: other rooms, rigs, lenses, light, people, clothes and ways. Seeds 0
    to 99 are for tuning the engine; seeds from 100 on are for judging it, each once.

    Rendered recordings, and runs of the present code over them, are kept in the cache: an interrupted
    suite resumes.

    Example: python -m benchmarks suite --seed 1 --minutes 3 --jobs 2 --refine
    """
    o = options or SuiteOptions()
    files = o.files()
    # A judging seed from the clock has most likely never been rendered.
    new = JUDGING_SEED + (time.time_ns() // 1_000_000 ^ os.getpid()) % 1_000_000_000
    seeds = list(dict.fromkeys(o.seed)) or [new]
    progress("seeds: " + ", ".join(f"{s}{' (tuned on)' if s < JUDGING_SEED else ''}" for s in seeds))
    settings = o.settings()
    chosen = [(s, path) for s in seeds for path in chosen_files(files, s, o.minutes)]
    jobs = [SuiteJob(path, seed, o.cache_folder, o.out, settings, o.tracker, o.refine) for seed, path in chosen]
    ways, left_out = scored(jobs, o.jobs)
    result = {"seeds": seeds, "left_out": left_out, **provenance()}
    result |= {way: scores_json(scores) for way, scores in ways.items()}
    if o.out is not None:
        o.out.mkdir(parents=True, exist_ok=True)
        write_whole(o.out / "suite.json", json_text(result))
    if o.json_output:
        print(json_text(result), end="")
        return
    for way, scores in ways.items():
        print_scores(f"scene, {way}", scores)
