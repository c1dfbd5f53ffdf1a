"""Counts and occupancy of one camera against known truth: committed scenes with rules, and random conference rooms."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from benchmarks.options import BenchOptions, Row, progress, rendered, report, scene_files
from benchmarks.random_scenes.generator import random_scene
from benchmarks.random_scenes.tables import RandomScene
from benchmarks.real import SingleTracker
from calib.errors import InputError
from planview.api.run import run
from planview.counting.rules import RulePlane, Rules, load_rules, parse_rules
from planview.counting.totals import CountScores, CrossingScores, count_tracks, count_truth, score_counts
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.open import open_engine
from planview.synthetic.assets import SCENES
from planview.synthetic.scene import Scene, load_scene
from planview.trajectories.clock import Clock
from planview.trajectories.table import Trajectories, read_truth

SINGLE = SCENES / "single"
"""Committed scenes of single cameras; the rules of NAME.toml are in NAME.rules.toml."""
RULES = ".rules.toml"
WINDOW_S = 2.0
"""Largest time between a true crossing and the one counted for it [s]: a person hesitating in a door."""
VISIBLE_MIN = 0.25
"""A person counts as visible from this share of the body on: a head and shoulders, or one in a row of people."""
ACCURACY_MIN = 0.97
"""Counting accuracy that every scene must reach; Zhang et al. 2008, table 3, has 76 to 97 %."""
RIGHT_MIN_PERCENT = {"0": 98.0, "1-2": 98.0, "3-5": 98.0, "6-9": 96.0, "10+": 88.0}
PAPER_RIGHT_PERCENT = {"0": 96.6, "1-2": 97.4, "3-5": 99.1, "6-9": 95.2, "10+": 85.2}
"""Time with the right occupancy by true number: the aim, and table 4 of Zhang et al. 2008."""


def score_rows(recording: str, scores: CountScores) -> dict[str, list[Row]]:
    """Rows of one recording's tripwires, and of its zones by true number of people, where that occurs."""
    crossings = [
        {
            "recording": recording, "rule": rule, **directions(s), "accuracy": s.accuracy,
            "limit": ACCURACY_MIN, "strict": s.strict_accuracy, "precision": s.precision, "recall": s.recall,
            "wrong_direction": s.wrong_direction, "late_s": s.timing_mean_s,
            "ok": s.accuracy is None or s.accuracy >= ACCURACY_MIN,
        }
        for rule, s in scores.crossings.items()
    ]  # fmt: skip
    occupancy = [
        {
            "recording": recording, "rule": rule, **asdict(group), "limit": RIGHT_MIN_PERCENT[group.people],
            "paper": PAPER_RIGHT_PERCENT[group.people],
            "ok": group.right_percent is None or group.right_percent >= RIGHT_MIN_PERCENT[group.people],
        }
        for rule, groups in scores.occupancy.items()
        for group in groups
        if group.frames
    ]  # fmt: skip
    return {"crossings": crossings, "occupancy": occupancy}


def directions(scores: CrossingScores) -> Row:
    """True and found numbers, left to right and right to left."""
    return {
        "true": f"{scores.true_left_to_right}+{scores.true_right_to_left}",
        "found": f"{scores.found_left_to_right}+{scores.found_right_to_left}",
    }


def count_frames(tracks: Trajectories, truth: Trajectories, n_frames: int) -> Row:
    """Compare the number of confirmed tracks with that of people who show, in frames 0 to n_frames - 1.

    Args:
        truth: with ``visible``; people without it count as seen.
    Returns:
        frames, those with a wrong number, those with fewer tracks, and the share of wrong ones (the counting error of
        del-Blanco et al. 2012, table I).
    """
    shown = truth.frame[~(truth.visible < VISIBLE_MIN)]
    confirmed = tracks.frame[tracks.state == "confirmed"]
    found, true = (np.bincount(f[f < n_frames], minlength=n_frames) for f in (confirmed, shown))
    wrong, too_few = int((found != true).sum()), int((found < true).sum())
    return {"frames": n_frames, "wrong": wrong, "too_few": too_few, "error": wrong / max(1, n_frames)}


@dataclass(frozen=True)
class Scorer:
    """How scenes of a single camera are rendered, at most their first frames, and tracked; ``out`` gets a folder with
    each run."""

    cache: Path
    frames: int | None
    out: Path
    config: Config

    def track(
        self, recording: Path, tracker: SingleTracker, camera: Path | None, name: str
    ) -> tuple[Engine, Trajectories]:
        """Track the recording of a single camera into a folder."""
        progress(f"tracking {name} with {tracker}")
        engine = open_engine(recording, tracker, self.config, camera)
        if engine.stereo is not None:
            raise InputError(f"{recording}: expected the recording of a single camera, found a stereo pair")
        return engine, run(engine, out=self.out / name, overwrite=True, quiet=True)

    def scene(
        self, scene: Scene, name: str, tracker: SingleTracker, rules_on: Callable[[RulePlane], Rules]
    ) -> dict[str, list[Row]]:
        """Score a scene, with rules on the floor below its camera."""
        recording = rendered(scene, name, self.cache, self.frames)
        engine, tracks = self.track(recording, tracker, recording / "camera.toml", name)
        truth, n_frames = read_truth(recording / "truth.csv"), self.frames or engine.recording.n_frames
        scores = score_rules(rules_on(RulePlane(engine.camera)), tracks, truth, engine.recording.fps, n_frames)
        frames = [{"recording": name, **count_frames(tracks, truth, n_frames)}]
        return score_rows(name, scores) | {"frames": frames}


def room_rules(room: RandomScene, plane: RulePlane) -> Rules:
    """The floor of a conference room that its camera sees, as a zone."""
    return parse_rules({"zone": [{"name": "room", "polygon_m": [list(at) for at in room.zone_m]}]}, plane, "room")


def score_rules(rules: Rules, tracks: Trajectories, truth: Trajectories, fps: float, n_frames: int) -> CountScores:
    """Counts of tracks by rules against those of the truth."""
    clock = Clock(tracks, fps)
    true = count_truth(truth, rules, clock, n_frames=n_frames)
    return score_counts(true, count_tracks(tracks, rules, clock=clock, n_frames=n_frames), WINDOW_S)


@Parameter(name="*")
@dataclass(frozen=True)
class CountingOptions(BenchOptions):
    """What is counted, and by which tracker."""

    scene: Annotated[Sequence[str], Parameter(negative="", show_default=False)] = ()
    """Only these rendered scenes, by name."""
    tracker: SingleTracker = "human-model"
    """Tracker of the scenes."""
    frames: int | None = None
    """Only the first frames of every rendered scene."""
    scenes: Path = SINGLE
    """Folder with scenes and their rules."""
    rooms: Annotated[Sequence[int], Parameter(negative="", show_default=False)] = ()
    """Seeds of random conference rooms: another camera, other clothes and seats each. Seeds 0 to 9 were used to tune
    the engine."""
    out: Path | None = None
    """Folder that keeps the runs; a temporary one by default."""


def counting(*, options: CountingOptions | None = None) -> None:
    """Score counts and occupancy on rendered scenes, next to the paper's figures.

    Example: python -m benchmarks counting --scene door_oblique --scene conference

    Example of wrong numbers of people: python -m benchmarks counting --scene station --tracker ellipse-particle

    Example with random conference rooms: python -m benchmarks counting --rooms 501 --rooms 502
    """
    o = options or CountingOptions()
    if (o.frames is not None and o.frames < 1) or any(seed < 0 for seed in o.rooms):
        raise InputError(f"expected --frames from 1, --rooms from 0, found {o.frames}, {list(o.rooms)}")
    with tempfile.TemporaryDirectory() as temporary:
        scorer = Scorer(o.cache_folder, o.frames, o.out or Path(temporary), o.settings())
        rooms = {f"conference-{seed}": random_scene("conference", seed) for seed in o.rooms}
        scored = [scorer.scene(r.scene, name, o.tracker, partial(room_rules, r)) for name, r in rooms.items()]
        for path in () if rooms else scene_files(o.scene, o.scenes, RULES):
            name = path.name.removesuffix(RULES)
            scene = load_scene(path.with_name(f"{name}.toml"))
            scored.append(scorer.scene(scene, name, o.tracker, partial(load_rules, path)))
    report(o.json_output, **{key: [row for rows in scored for row in rows[key]] for key in scored[0]})
