"""Counts and occupancy of one camera against known truth: committed scenes with rules, and members of one of them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.members import Table, Variation, draw_member, scenes_of
from benchmarks.options import Report, Row, benchmark, cache_folder, progress, rendered, scene_files, tables
from calib.io import load_toml
from calib.types import F64
from planview.api.arguments import in_range
from planview.api.run import run
from planview.counting.rules import RulePlane, Rules, load_rules, parse_rules
from planview.counting.totals import CountScores, count_tracks, count_truth, score_counts
from planview.engine.config import Config, load_config
from planview.engine.open import ImageTrackerName, open_engine
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


@benchmark
def counting(
    *,
    scene: Sequence[str] = (),
    tracker: ImageTrackerName = "human-model",
    frames: int | None = None,
    scenes: Path = SINGLE,
    rooms: Sequence[int] = (),
    out: Path | None = None,
    cache: Path | None = None,
    config: Path | None = None,
    overrides: Sequence[str] = (),
) -> Report:
    """Score counts and occupancy on rendered scenes, next to the paper's figures.

    Example: python -m benchmarks counting --scene door_oblique --scene conference

    Example of wrong numbers of people: python -m benchmarks counting --scene station --tracker ellipse-particle

    Example with other conference rooms: python -m benchmarks counting --rooms 501 --rooms 502

    Args:
        scene: Only these rendered scenes, by name.
        tracker: Tracker of the scenes.
        frames: Only the first frames of every rendered scene.
        scenes: Folder with scenes and their rules.
        rooms: Seeds of members of the conference room: another camera, other clothes, places and times each. Seeds 0 to
            99 are for tuning.
        out: Folder that keeps the runs; a temporary one by default.
        cache: Folder for rendered recordings; the user's cache by default.
        config: TOML file with parameters of the engine.
        overrides: One parameter of the engine; can be repeated.
    """
    if frames is not None:
        in_range("frames", frames, 1, 1_000_000)
    for seed in rooms:
        in_range("rooms", seed, 0, 2**62)
    settings = load_config(config, overrides)
    with tempfile.TemporaryDirectory() as temporary:
        scorer = Scorer(tracker, cache_folder(cache), frames, out or Path(temporary), settings)
        committed = load_toml(SINGLE / "conference.toml", "a scene in TOML")
        for seed in rooms:
            room = draw_member(committed, seed, "conference")
            scorer.score(scenes_of(room)[0], f"conference-{seed}", partial(room_rules, room, committed["camera"]))
        if not rooms:
            for path in scene_files(scene, scenes, RULES):
                name = path.name.removesuffix(RULES)
                scorer.score(load_scene(path.with_name(f"{name}.toml")), name, partial(load_rules, path))
    return tables(crossings=scorer.crossings, occupancy=scorer.occupancy, frames=scorer.frames)


def room_rules(member: Variation, committed: Table, plane: RulePlane) -> Rules:
    """The zone of the committed conference room, which its camera sees, on the floor below a member's camera."""
    (zone,) = load_toml(SINGLE / f"conference{RULES}", "rules in TOML")["zone"]
    corners = []
    for corner_m in zone["polygon_m"]:
        in_room_m = member.floor.point(to_room(committed, corner_m))
        corners.append(to_camera(member.table["camera"], in_room_m))
    return parse_rules({"zone": [zone | {"polygon_m": corners}]}, plane, "room")


def to_room(camera: Table, point_m: Sequence[float]) -> list[float]:
    """A place in the room, from x to the right of a camera and y ahead of it."""
    right, ahead = _axes(camera)
    return list(np.array(camera["at_m"][:2]) + point_m[0] * right + point_m[1] * ahead)


def to_camera(camera: Table, point_m: Sequence[float]) -> list[float]:
    """Inverse of ``to_room``."""
    away_m = np.array(point_m) - camera["at_m"][:2]
    return [float(away_m @ axis) for axis in _axes(camera)]


def _axes(camera: Table) -> tuple[F64, F64]:
    """Unit vectors in the room to the right of a camera, and ahead."""
    heading = np.radians(camera["heading_deg"])
    ahead = np.array([np.cos(heading), np.sin(heading)])
    return np.array([ahead[1], -ahead[0]]), ahead


@dataclass
class Scorer:
    """Renderer and tracker of scenes of a single camera, with their scores so far.

    Attributes:
        n_frames: at most the first frames.
        out: gets a folder with each run.
        crossings, occupancy, frames: rows of tripwires, of zones, and of numbers of people.
    """

    tracker: ImageTrackerName
    cache: Path
    n_frames: int | None
    out: Path
    config: Config
    crossings: list[Row] = field(default_factory=list)
    occupancy: list[Row] = field(default_factory=list)
    frames: list[Row] = field(default_factory=list)

    def score(self, scene: Scene, name: str, rules_on: Callable[[RulePlane], Rules]) -> None:
        """Render, track and score a scene, with rules on the floor below its camera."""
        recording = rendered(scene, name, self.cache, self.n_frames)
        progress(f"tracking {name} with {self.tracker}")
        engine = open_engine(recording, self.tracker, self.config, recording / "camera.toml")
        tracks = run(engine, out=self.out / name, overwrite=True)
        truth = read_truth(recording / "truth.csv")
        n_frames = self.n_frames or engine.recording.n_frames
        rules = rules_on(RulePlane(engine.camera))
        scores = score_rules(rules, tracks, truth, engine.recording.fps, n_frames)
        self.crossings += crossing_rows(name, scores)
        self.occupancy += occupancy_rows(name, scores)
        self.frames.append({"recording": name, **count_frames(tracks, truth, n_frames)})


def score_rules(rules: Rules, tracks: Trajectories, truth: Trajectories, fps: float, n_frames: int) -> CountScores:
    """Counts of tracks by rules against those of the truth."""
    clock = Clock(tracks, fps)
    true = count_truth(truth, rules, clock, n_frames=n_frames)
    return score_counts(true, count_tracks(tracks, rules, clock=clock, n_frames=n_frames), WINDOW_S)


def crossing_rows(recording: str, scores: CountScores) -> list[Row]:
    """Rows of one recording's tripwires; numbers of people are left to right + right to left."""
    rows: list[Row] = []
    for rule, score in scores.crossings.items():
        rows.append(
            {
                "recording": recording,
                "rule": rule,
                "true": f"{score.true_left_to_right}+{score.true_right_to_left}",
                "found": f"{score.found_left_to_right}+{score.found_right_to_left}",
                "accuracy": score.accuracy,
                "limit": ACCURACY_MIN,
                "strict": score.strict_accuracy,
                "precision": score.precision,
                "recall": score.recall,
                "wrong_direction": score.wrong_direction,
                "late_s": score.timing_mean_s,
                "ok": score.accuracy is None or score.accuracy >= ACCURACY_MIN,
            }
        )
    return rows


def occupancy_rows(recording: str, scores: CountScores) -> list[Row]:
    """Rows of one recording's zones by true number of people, where that occurs."""
    rows: list[Row] = []
    for rule, groups in scores.occupancy.items():
        for group in groups:
            if not group.frames:
                continue
            limit = RIGHT_MIN_PERCENT[group.people]
            ok = group.right_percent is None or group.right_percent >= limit
            row = {"recording": recording, "rule": rule, **asdict(group)}
            rows.append(row | {"limit": limit, "paper": PAPER_RIGHT_PERCENT[group.people], "ok": ok})
    return rows


def count_frames(tracks: Trajectories, truth: Trajectories, n_frames: int) -> Row:
    """Compare the number of confirmed tracks with that of people who show, in frames 0 to n_frames - 1.

    Args:
        truth: with ``visible``; people without it count as seen.
    Returns:
        frames, those with a wrong number, those with fewer tracks, and the share of wrong ones (the counting error of
        del-Blanco et al. 2012, table I).
    """
    found = _people_per_frame(tracks.frame[tracks.state == "confirmed"], n_frames)
    true = _people_per_frame(truth.frame[~(truth.visible < VISIBLE_MIN)], n_frames)
    wrong = int((found != true).sum())
    too_few = int((found < true).sum())
    return {"frames": n_frames, "wrong": wrong, "too_few": too_few, "error": wrong / max(1, n_frames)}


def _people_per_frame(frames: np.ndarray, n_frames: int) -> np.ndarray:
    return np.bincount(frames[frames < n_frames], minlength=n_frames)
