"""Counts and occupancy of one camera against known truth: rendered views, real trajectories, the real pavement clip."""

from __future__ import annotations

import csv
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from cyclopts import Parameter

from benchmarks.options import BenchOptions, Rendering, progress, rendered, report, scene_files
from benchmarks.random_scenes.generator import VIEWS, random_scene
from benchmarks.random_scenes.tables import RandomScene
from calib.errors import InputError
from planview.counting.events import Direction, Event
from planview.counting.geometry import RulePlane
from planview.counting.rules import Rules, load_rules, parse_rules
from planview.counting.scoring import CountScores, CrossingScores, score_counts, score_events
from planview.counting.totals import Clock, Counts, count_tracks, count_truth
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.open import open_engine
from planview.output.script import run
from planview.synthetic.assets import SCENES
from planview.synthetic.scene import Scene, load_scene
from planview.trajectories.formats import load_tracks
from planview.trajectories.table import Trajectories, read_truth

SINGLE = SCENES / "single"
"""Committed scenes of single cameras; the rules of NAME.toml are in NAME.rules.toml."""
RULES = ".rules.toml"
WINDOW_S = 2.0
"""Largest time between a true crossing and the one counted for it [s]: a person hesitating in a door (our choice)."""
VISIBLE_MIN = 0.25
"""A person counts as visible from this share of the body on: a head and shoulders, or one in a row of people."""
ACCURACY_MIN = 0.97
"""Counting accuracy that every view must reach; Zhang et al. 2008, table 3, has 76 to 97 %."""
RIGHT_MIN_PERCENT = {"0": 98.0, "1-2": 98.0, "3-5": 98.0, "6-9": 96.0, "10+": 88.0}
ROOM_RIGHT_MIN_PERCENT = {"0": 98.0, "1-2": 98.0, "3-5": 97.0, "6-9": 95.0, "10+": 88.0}
PAPER_RIGHT_PERCENT = {"0": 96.6, "1-2": 97.4, "3-5": 99.1, "6-9": 95.2, "10+": 85.2}
"""Time with the right occupancy by true number: the aim, that of random rooms, and table 4 of Zhang et al. 2008."""
PAVEMENT_FRAMES = (96, 154, 828, 918, 1001, 1021, 1296, 1306, 351)
"""True crossings of the line y = 200 of the pavement clip, from the README of the recordings."""
FULL_BOX = ("full_left_px", "full_top_px", "full_width_px", "full_height_px")
TRAJECTORIES = ("uo-050-180-180.txt", "boa-300-frei.txt")
SingleTracker = Literal["human-model", "ellipse-particle"]
Row = dict[str, Any]


@dataclass(frozen=True)
class CountingTable:
    """Rows of what was scored: tripwires, zones by their true number of people, and numbers of people in a frame."""

    crossings: list[Row] = field(default_factory=list)
    occupancy: list[Row] = field(default_factory=list)
    frames: list[Row] = field(default_factory=list)

    def __add__(self, other: CountingTable) -> CountingTable:
        return CountingTable(
            self.crossings + other.crossings, self.occupancy + other.occupancy, self.frames + other.frames
        )


def table_of(
    recording: str, scores: CountScores, right_min_percent: Mapping[str, float] = RIGHT_MIN_PERCENT
) -> CountingTable:
    """The rows of one recording's scores; ranges that never occur are left out."""
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
        _occupancy_row(recording, rule, asdict(group), right_min_percent)
        for rule, groups in scores.occupancy.items()
        for group in groups
        if group.frames
    ]
    return CountingTable(crossings, occupancy)


def _occupancy_row(recording: str, rule: str, group: Row, right_min_percent: Mapping[str, float]) -> Row:
    people, right = group["people"], group["right_percent"]
    limit, paper = right_min_percent[people], PAPER_RIGHT_PERCENT[people]
    ok = right is None or right >= limit
    return {"recording": recording, "rule": rule, **group, "limit": limit, "paper": paper, "ok": ok}


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
    """How scenes of a single camera are rendered, tracked and scored.

    Attributes:
        rendering: options of it; fewer frames than a scene has are scored alone.
        out: gets a folder with each run.
    """

    rendering: Rendering
    out: Path
    config: Config
    tracker: SingleTracker = "human-model"

    def track(self, recording: Path, camera: Path | None, name: str) -> tuple[Engine, Trajectories]:
        """Track the recording of a single camera into a folder."""
        progress(f"tracking {name} with {self.tracker}")
        engine = open_engine(recording, self.tracker, self.config, camera)
        if engine.stereo is not None:
            raise InputError(f"{recording}: expected the recording of a single camera, found a stereo pair")
        return engine, run(engine, self.out / name, overwrite=True)

    def score(
        self, scene: Scene, name: str, rules_on: Callable[[RulePlane], Rules], right_min_percent: Mapping[str, float]
    ) -> CountingTable:
        """Render a scene unless the cache has it, track it, and score the counts of the rules on its camera's floor."""
        recording = rendered(scene, name, self.rendering)
        engine, tracks = self.track(recording, recording / "camera.toml", name)
        truth, n_frames = read_truth(recording / "truth.csv"), self.rendering.frames or engine.recording.n_frames
        scores = score_rules(rules_on(RulePlane(engine.camera)), tracks, truth, engine.recording.fps, n_frames)
        counts = {"recording": name, **count_frames(tracks, truth, n_frames)}
        return table_of(name, scores, right_min_percent) + CountingTable(frames=[counts])


def score_rules(rules: Rules, tracks: Trajectories, truth: Trajectories, fps: float, n_frames: int) -> CountScores:
    """Counts of tracks by rules against those of the truth."""
    clock = Clock(tracks, fps)
    true = count_truth(truth, rules, clock, n_frames=n_frames)
    return score_counts(true, count_tracks(tracks, rules, clock=clock, n_frames=n_frames), WINDOW_S)


def score_scene(rules: Path, scorer: Scorer) -> CountingTable:
    """Score a committed scene NAME.toml with its rules, NAME.rules.toml."""
    name = rules.name.removesuffix(RULES)
    scene = load_scene(rules.with_name(f"{name}.toml"))
    return scorer.score(scene, name, lambda plane: load_rules(rules, plane), RIGHT_MIN_PERCENT)


def score_room(seed: int, scorer: Scorer) -> CountingTable:
    """Score the number of people in the random conference room of a seed."""
    room, name = random_scene("conference", seed), f"conference-{seed}"
    rules = {"zone": [{"name": "room", "polygon_m": [list(corner) for corner in room.zone_m]}]}
    return scorer.score(room.scene, name, lambda plane: parse_rules(rules, plane, name), ROOM_RIGHT_MIN_PERCENT)


def all_rooms(tables: Sequence[CountingTable]) -> CountingTable:
    """The rows of every room, and after several rooms one row for each range with the frames of all of them."""
    together = sum(tables, CountingTable())
    rows = []
    for people in ROOM_RIGHT_MIN_PERCENT if len(tables) > 1 else ():
        groups = [row for row in together.occupancy if row["people"] == people and row["frames"]]
        if groups:
            frames = [g["frames"] for g in groups]
            means = {
                name: float(np.average([g[name] for g in groups], weights=frames))
                for name in ("right_percent", "mean_difference", "mean_absolute_difference")
            }
            group = {"people": people, "frames": sum(frames), **means}
            rows.append(_occupancy_row("all rooms", "room", group, ROOM_RIGHT_MIN_PERCENT))
    return together + CountingTable(occupancy=rows)


def score_trajectories(data: Path) -> CountingTable:
    """Real trajectories as measured, and with noise of 0.10 m and three in ten frames dropped.

    Args:
        data: folder with the laboratory files.
    """
    rules = {"tripwire": [{"name": "y = 0", "from_m": [-10.0, 0.0], "to_m": [10.0, 0.0]}]}

    def across(tracks: Trajectories) -> Counts:
        return count_tracks(tracks, parse_rules(rules, RulePlane(), "y = 0"))

    together = CountingTable()
    for name in TRAJECTORIES:
        tracks = load_tracks(data / name)
        truth = passages(tracks)
        rng = np.random.default_rng(0)
        noise = rng.normal(0.0, 0.10, (2, len(tracks)))
        kept = rng.random(int(tracks.frame.max()) + 1) >= 0.3
        worse = replace(tracks, x_m=tracks.x_m + noise[0], y_m=tracks.y_m + noise[1]).where(kept[tracks.frame])
        together += table_of(name, score_events(truth, across(tracks), WINDOW_S))
        together += table_of(f"{name}, noise and gaps", score_events(truth, across(worse), WINDOW_S))
    return together


def passages(tracks: Trajectories) -> list[Event]:
    """The truth of people who walk from one end of a corridor to the other: each passes y = 0 once, where they last do.

    Found without the counting engine, so that it can be checked against it.
    """
    events = []
    for track_id in np.unique(tracks.track_id):
        mine = tracks.where(tracks.track_id == track_id)
        left = mine.y_m >= 0
        changes = np.flatnonzero(left[1:] != left[:-1])
        if left[0] != left[-1]:
            at = int(changes[-1]) + 1
            way: Direction = "left_to_right" if left[0] else "right_to_left"
            events.append(
                Event(int(mine.frame[at]), float(mine.timestamp_s[at]), "y = 0", "crossing", int(track_id), way)
            )
    return events


def pavement_truth() -> list[Event]:
    """The true crossings of the pavement clip, a person for each; up the image is from the right of the line to its
    left."""
    return [
        Event(frame, frame / 30.0, "y = 200", "crossing", person, "left_to_right" if frame == 351 else "right_to_left")
        for person, frame in enumerate(PAVEMENT_FRAMES, start=1)
    ]


def score_pavement(clip: Path, scorer: Scorer, camera: Path | None) -> CountingTable:
    """The clip against the crossings in the README of the recordings.

    Args:
        clip: pavement.mp4.
        camera: camera.toml of the clip; without one, the line is applied in the image to the feet of boxes.
    """
    engine, tracks = scorer.track(clip, camera, "pavement")
    wire = {"name": "y = 200", "from_px": [0.0, 200.0], "to_px": [399.0, 200.0]}
    rules = parse_rules({"tripwire": [wire]}, RulePlane(engine.camera, engine.size), "y = 200")
    return table_of("pavement", score_events(pavement_truth(), count_tracks(tracks, rules), WINDOW_S))


def score_view(path: Path, seed: int, scorer: Scorer) -> Row:
    """Render a view of a seed unless the cache has it, track it, and count at its line.

    Ellipses are tracked and counted in the image without a camera; the human model on the floor with the true one.
    """
    view = random_scene("views", seed, path)
    recording = rendered(view.scene, f"view-{path.stem}-{seed}", scorer.rendering)
    camera = recording / "camera.toml" if scorer.tracker == "human-model" else None
    engine, tracks = scorer.track(recording, camera, f"{path.stem}-{seed}-{scorer.tracker}")
    truth = full_truth(recording / "truth.csv")
    size = view.scene.mount.width, view.scene.mount.height
    rules = parse_rules(view_rules(view), RulePlane(engine.camera, size), "line")
    n = scorer.rendering.frames or view.scene.n_frames
    scores = score_rules(rules, tracks, truth, view.scene.fps, n)
    line, middle = scores.crossings["line"], scores.occupancy["middle"]
    right = sum(g.frames * (g.right_percent or 0.0) for g in middle) / 100
    return {
        "view": path.stem, "seed": seed, "tracker": scorer.tracker, **directions(line), "strict": strict_accuracy(line),
        "people": len(np.unique(tracks.track_id[tracks.state == "confirmed"])),
        "there": len(np.unique(truth.track_id[truth.visible >= VISIBLE_MIN])),
        "wrong_frames": count_frames(tracks, truth, n)["error"],
        "occupancy": right / max(1, sum(g.frames for g in middle)),
    }  # fmt: skip


def view_rules(view: RandomScene) -> dict[str, Any]:
    """The line of a view, and a zone in its middle: three quarters of its width and height, where there is floor."""
    camera = view.scene.mount
    width, height = camera.width, camera.height
    horizon = (height - 1) / 2 - camera.focal_px / max(math.tan(math.radians(camera.tilt_deg)), 1e-6)
    left, right, bottom = width / 8, 7 * width / 8, height - 1.0
    top = max(height / 4, horizon + 0.05 * height)
    corners = [[left, top], [right, top], [right, bottom], [left, bottom]]
    line = {"name": "line", "from_px": list(view.wire_px[0]), "to_px": list(view.wire_px[1])}
    return {"tripwire": [line], "zone": [{"name": "middle", "polygon_px": corners}]}


def full_truth(path: Path) -> Trajectories:
    """``truth.csv`` with the boxes of whole silhouettes inside the image, whatever hides them."""
    truth = read_truth(path)
    with path.open(newline="", encoding="utf-8") as file:
        rows = [[float(row[name] or "nan") for name in FULL_BOX] for row in csv.DictReader(file)]
    truth.box_px[:] = np.array(rows).reshape(-1, 4)
    return truth


def strict_accuracy(scores: CrossingScores) -> float:
    """Strict accuracy of the crossings; 1 where no person crosses and none is counted, 0 where only that is so."""
    if scores.strict_accuracy is not None:
        return scores.strict_accuracy
    return float(scores.found_left_to_right + scores.found_right_to_left == 0)


def view_means(views: Sequence[Row]) -> list[Row]:
    """Each tracker's mean, with the interval that holds 95 % of the means of views resampled from these."""
    means = []
    for tracker in dict.fromkeys(row["tracker"] for row in views):
        mine = [row for row in views if row["tracker"] == tracker]
        strict = np.array([row["strict"] for row in mine])
        resampled = np.random.default_rng(0).choice(strict, (10_000, len(strict))).mean(axis=1)
        low, high = map(float, np.quantile(resampled, (0.025, 0.975)))
        means.append({
            "tracker": tracker, "strict_mean": (float(strict.mean()), low, high),
            "strict_worst": float(strict.min()), "people": sum(row["people"] for row in mine),
            "there": sum(row["there"] for row in mine), "occupancy": float(np.mean([row["occupancy"] for row in mine])),
        })  # fmt: skip
    return means


@Parameter(name="*")
@dataclass(frozen=True)
class CountingOptions(BenchOptions):
    """What is counted, and by which tracker."""

    scene: Annotated[Sequence[str], Parameter(negative="", show_default=False)] = ()
    """Only these rendered scenes, by name."""
    tracker: SingleTracker = "human-model"
    """Who follows people in the rendered views and the pavement clip."""
    data: Path | None = None
    """Folder of the real recordings (trajectories/, overhead-counting/); left out when not given."""
    pavement_camera: Path | None = None
    """camera.toml of the pavement clip; without one, the ellipse-particle tracker and the image are used for it."""
    frames: int | None = None
    """Only the first frames of every rendered scene."""
    scenes: Path = SINGLE
    """Folder with scenes and their rules."""
    seeds: Annotated[Sequence[int], Parameter(negative="", show_default=False)] = ()
    """Seeds of the random views of data/synthetic/views (--scene names some of these then), with both trackers. The
    engine was tuned on seeds 0 to 9."""
    rooms: Annotated[Sequence[int], Parameter(negative="", show_default=False)] = ()
    """Seeds of random conference rooms: another camera, other clothes and seats each; 0 to 9 were tuned on."""
    out: Path | None = None
    """Folder that keeps the runs; a temporary one by default."""


def counting(*, options: CountingOptions | None = None) -> None:
    """Score counts and occupancy on rendered views and real recordings, next to the paper's figures.

    Example: python -m benchmarks counting --scene door_oblique --scene conference

    Example of wrong numbers of people: python -m benchmarks counting --scene station --tracker ellipse-particle

    Example with random views: python -m benchmarks counting --seeds 501 --seeds 502

    Example with random conference rooms: python -m benchmarks counting --rooms 501 --rooms 502

    Example with the real recordings: python -m benchmarks counting --data ../shared/data --pavement-camera camera.toml
    """
    o = options or CountingOptions()
    if o.frames is not None and o.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {o.frames}")
    for name, seeds in (("--seeds", o.seeds), ("--rooms", o.rooms)):
        if any(seed < 0 for seed in seeds):
            raise InputError(f"{name}: expected numbers from 0, found {min(seeds)}")
    with tempfile.TemporaryDirectory() as temporary:
        rendering = Rendering(o.cache_folder, frames=o.frames)
        scorer = Scorer(rendering, o.out or Path(temporary), o.settings(), o.tracker)
        if o.seeds:
            views = [
                score_view(path, seed, replace(scorer, tracker=tracker))
                for seed in o.seeds
                for path in scene_files(o.scene, VIEWS)
                for tracker in get_args(SingleTracker)
            ]
            report(o.json_output, views=views, means=view_means(views))
            return
        if o.rooms:
            table = all_rooms([score_room(seed, scorer) for seed in o.rooms])
        else:
            table = sum((score_scene(path, scorer) for path in scene_files(o.scene, o.scenes, RULES)), CountingTable())
            if o.data is not None:
                table += score_trajectories(o.data / "trajectories")
                who = scorer if o.pavement_camera is not None else replace(scorer, tracker="ellipse-particle")
                table += score_pavement(o.data / "overhead-counting" / "pavement.mp4", who, o.pavement_camera)
    report(o.json_output, **vars(table))
