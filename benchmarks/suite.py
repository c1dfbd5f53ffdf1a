"""The challenge suite: scenes drawn from a seed, rendered once, tracked and scored."""

from __future__ import annotations

import shutil
import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from benchmarks.accuracy import RenderOptions, SceneScore, rendered, totals
from benchmarks.passes import PEER, BenchTracker, Pass, run_pass
from calib.errors import InputError
from calib.text import reason
from planview.engine.config import Config
from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.result import KINDS
from planview.output.finished import refine_run
from planview.synthetic.committed import SCENES
from planview.synthetic.ranges import draw
from planview.synthetic.scene import Scene
from planview.trajectories.table import Trajectories, read_tracks, read_truth

SUITE = SCENES / "suite"
"""The committed challenges."""
Way = Literal["online", "refined", "peer"]
"""Tracks as they came, those refined afterwards, and those of the naive engine."""
JUDGING_SEED = 100
"""Seeds below are worked on; seeds from here on judge, each once."""


@dataclass(frozen=True)
class SuiteJob:
    """One scene of one seed to be rendered, tracked and scored.

    Attributes:
        cache: folder of rendered recordings and of runs over them.
        out: folder that gets a copy of the run; None for none.
        refine, peer: also score the refined tracks, and those of the naive engine.
    """

    path: Path
    seed: int
    cache: Path
    out: Path | None
    config: Config
    tracker: BenchTracker = "template"
    refine: bool = False
    peer: bool = False

    @property
    def name(self) -> str:
        return f"{self.path.stem}-{self.seed}"


@dataclass(frozen=True)
class SuiteScore:
    """The scores of one way of tracking a scene.

    Attributes:
        recording: folder of the scene.
        frames, duration_s: its length, in frames and [s].
    """

    way: Way
    score: SceneScore
    recording: Path
    frames: int
    duration_s: float

    def to_json(self) -> dict[str, Any]:
        of_scene = {"recording": str(self.recording), "frames": self.frames, "duration_s": self.duration_s}
        return self.score.to_json() | of_scene


@dataclass(frozen=True)
class SuiteTotals:
    """All scenes together.

    Attributes:
        minutes: length of the recordings.
        significant: significant errors by kind and in total.
        strict: lost, missed and false tracks as significant ones, and every change of identity (CLEAR).
        significant_per_10_min, strict_per_10_min: the same for ten minutes.
        mota, idf1: pooled over rows.
        position_error_m, position_std_m, height_error_m: pooled means and deviation over matches; NaN without one.
    """

    minutes: float
    truth_rows: int
    significant: dict[str, int]
    strict: int
    significant_per_10_min: float
    strict_per_10_min: float
    mota: float
    idf1: float
    switches: int
    position_error_m: float
    position_std_m: float
    height_error_m: float


def load_challenge(path: Path) -> dict[str, Any]:
    """The table of a challenge file.

    Raises:
        InputError: unreadable or not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: expected a challenge scene in TOML, found {reason(error)}") from error


def drawn_scene(path: Path, seed: int) -> Scene:
    """The scene of a challenge file for a seed.

    Raises:
        InputError: not a challenge, or a value out of range.
        WorkError: the ranges ask for more than fits into the room.
    """
    try:
        return draw(load_challenge(path), seed, path.stem)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"]) or "the challenge"
        raise InputError(f"{path}: {where}: {first['msg']}, found {first['input']!r}") from error


def chosen_files(files: Sequence[Path], seed: int, minutes: float) -> list[Path]:
    """Scenes of a seed, in an order that the seed shuffles, that last about so many minutes; all when that is enough.

    Scenes keep their length, so that a recording rendered for few minutes serves for many.
    """
    lengths = {path: float(load_challenge(path).get("duration_s", 30.0)) for path in files}
    order = [files[k] for k in np.random.default_rng([seed, 10]).permutation(len(files))]
    chosen: list[Path] = []
    left = 60.0 * minutes
    for path in order:
        if not chosen or lengths[path] <= left + 10.0:
            chosen.append(path)
            left -= lengths[path]
    return sorted(chosen)


def dealt_files(files: Sequence[Path], seeds: Sequence[int]) -> list[tuple[int, Path]]:
    """All scenes, by name, each with one of the seeds in turn."""
    return [(seeds[i % len(seeds)], path) for i, path in enumerate(sorted(files))]


def suite_recording(path: Path, seed: int, cache: Path) -> tuple[Path, Scene]:
    """The recording of a seed, from the cache when it is whole there; one that was cut off is rendered again."""
    scene = drawn_scene(path, seed)
    name, options = f"suite-{path.stem}-{seed}", RenderOptions(cache)
    for _ in range(2):
        folder = rendered(scene, name, options, lambda _: None)
        if is_whole(folder, scene.n_frames):
            break
        shutil.rmtree(folder, ignore_errors=True)
    return folder, scene


def is_whole(folder: Path, n_frames: int) -> bool:
    """Whether a rendered recording has all of its images, times and truth."""
    images = [path for side in ("left", "right") for path in sorted((folder / side).glob("*.jpg"))]
    times = folder / "timestamps.csv"
    return (
        len(images) == 2 * n_frames
        and all(_has_end(path) for path in images)
        and (folder / "rig.toml").is_file()
        and (folder / "truth.csv").is_file()
        and times.is_file()
        and len(times.read_text().splitlines()) == n_frames + 1
    )


def _has_end(path: Path) -> bool:
    """Whether a JPEG file ends with its end marker."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 2))
        return file.read() == b"\xff\xd9"


def run_job(job: SuiteJob) -> list[SuiteScore]:
    """Render, track (both once, from the cache when they are there) and score one scene."""
    recording, scene = suite_recording(job.path, job.seed, job.cache)
    # One pass serves all ways, the ablation and later tables.
    kept = run_pass(Pass(recording, job.cache, job.config, job.tracker, recorded=job.tracker == "template"))
    if job.out is not None:
        kept = Path(shutil.copytree(kept, job.out / job.name, dirs_exist_ok=True))
    tracks: dict[Way, Trajectories] = {"online": read_tracks(kept / "tracks.csv")}
    if job.refine:
        tracks["refined"] = refined_tracks(kept)
    if job.peer and job.tracker == "template":
        tracks["peer"] = read_tracks(kept / PEER)
    truth = read_truth(recording / "truth.csv")
    scores = {way: SceneScore(job.path.stem, job.seed, evaluate_tracks(t, truth), kept) for way, t in tracks.items()}
    return [SuiteScore(way, score, recording, scene.n_frames, scene.duration_s) for way, score in scores.items()]


def refined_tracks(folder: Path) -> Trajectories:
    """The tracks of a run refined as ``planview edit --refine`` does, in a copy of its folder."""
    with tempfile.TemporaryDirectory(prefix="planview-refine-") as temporary:
        copy = Path(shutil.copytree(folder, Path(temporary) / "run"))
        refine_run(copy)
        return read_tracks(copy / "tracks.csv")


def suite_totals(scores: Sequence[SuiteScore]) -> SuiteTotals:
    """All scenes together."""
    pooled, every = totals([s.score for s in scores]), [s.score.evaluation for s in scores]
    minutes = sum(s.duration_s for s in scores) / 60
    switches = sum(e.clear.switches for e in every)
    significant = {"total": pooled.significant["total"]} | {k: pooled.significant.get(k, 0) for k in KINDS}
    strict = significant["total"] - significant["swapped"] + switches
    rows = sum(e.truth_rows + e.track_rows for e in every)
    return SuiteTotals(
        minutes=minutes,
        truth_rows=pooled.truth_rows,
        significant=significant,
        strict=strict,
        significant_per_10_min=10 * significant["total"] / minutes,
        strict_per_10_min=10 * strict / minutes,
        mota=pooled.mota,
        idf1=2 * sum(e.identity.idtp for e in every) / rows if rows else float("nan"),
        switches=switches,
        position_error_m=pooled.position_error_m,
        position_std_m=pooled.position_std_m,
        height_error_m=pooled.height_error_m,
    )
