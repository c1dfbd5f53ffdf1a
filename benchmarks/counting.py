"""Counts and occupancy of one camera against known truth: rendered views, real trajectories, the real pavement clip."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from cyclopts import Parameter
from rich.console import Console

from benchmarks.options import BenchOptions, Progress, Rendering, rendered, scene_files, show
from benchmarks.random_scenes.rooms import random_conference
from benchmarks.views import VIEWS, drawn_view, full_truth, rules_of
from calib.errors import InputError
from planview.counting.events import Direction, Event
from planview.counting.geometry import RulePlane
from planview.counting.rules import Rules, load_rules, parse_rules
from planview.counting.scoring import CountScores, CrossingScores, OccupancyGroup, score_counts, score_events
from planview.counting.totals import Clock, Counts, count_tracks, count_truth
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.open import open_engine
from planview.output.script import run
from planview.synthetic.assets import SCENES
from planview.synthetic.scene import Scene, load_scene
from planview.trajectories.formats import read_laboratory
from planview.trajectories.table import Trajectories, read_truth

SINGLE = SCENES / "single"
"""Committed scenes of single cameras; NAME.rules.toml beside NAME.toml says what to count."""
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
"""Time with the right occupancy by true number: the aim, that of drawn rooms, and table 4 of Zhang et al. 2008."""
TRAJECTORIES = ("uo-050-180-180.txt", "boa-300-frei.txt")
SingleTracker = Literal["human-model", "ellipse-particle"]


@dataclass(frozen=True)
class CrossingRow:
    """A tripwire of a recording beside its truth."""

    recording: str
    rule: str
    scores: CrossingScores

    @property
    def ok(self) -> bool:
        return self.scores.accuracy is None or self.scores.accuracy >= ACCURACY_MIN


@dataclass(frozen=True)
class OccupancyRow:
    """A zone of a recording, for one range of true numbers of people."""

    recording: str
    rule: str
    group: OccupancyGroup
    min_percent: float

    @property
    def ok(self) -> bool:
        return self.group.right_percent is None or self.group.right_percent >= self.min_percent


@dataclass(frozen=True)
class FrameCounts:
    """How often the number of people was wrong.

    Attributes:
        recording: name.
        frames: how many were compared.
        wrong: frames with another number of confirmed tracks than people who show.
        too_few: those of them with fewer tracks.
    """

    recording: str
    frames: int
    wrong: int
    too_few: int

    @property
    def error(self) -> float:
        """Share of frames with the wrong number (the counting error of del-Blanco et al. 2012, table I)."""
        return self.wrong / self.frames if self.frames else 0.0


@dataclass(frozen=True)
class CountingTable:
    """Everything that was scored."""

    crossings: tuple[CrossingRow, ...] = ()
    occupancy: tuple[OccupancyRow, ...] = ()
    views: tuple[FrameCounts, ...] = ()

    def __add__(self, other: CountingTable) -> CountingTable:
        return CountingTable(
            self.crossings + other.crossings, self.occupancy + other.occupancy, self.views + other.views
        )

    def to_json(self) -> dict[str, Any]:
        def named(row: CrossingRow | OccupancyRow) -> dict[str, Any]:
            return {"recording": row.recording, "rule": row.rule, "ok": row.ok}

        return {
            "crossings": [named(r) | asdict(r.scores) for r in self.crossings],
            "occupancy": [named(r) | asdict(r.group) for r in self.occupancy],
            "views": [{"error": v.error, **asdict(v)} for v in self.views],
        }


@dataclass(frozen=True)
class ViewScore:
    """One tracker on one drawn view.

    Attributes:
        view, seed: which recording.
        crossings: of the line through the middle.
        found, there: people with a confirmed track, people who showed.
        wrong_frames: share of frames with another number of people than show.
        occupancy: share of frames with the true number of people in the middle of the view.
    """

    view: str
    seed: int
    tracker: SingleTracker
    crossings: CrossingScores
    found: int
    there: int
    wrong_frames: float
    occupancy: float

    @property
    def strict(self) -> float:
        """Strict accuracy of the crossings; 1 where no person crosses and none is counted, 0 where only that is so."""
        c = self.crossings
        if c.strict_accuracy is not None:
            return c.strict_accuracy
        return float(c.found_left_to_right + c.found_right_to_left == 0)

    def to_json(self) -> dict[str, Any]:
        return {"strict": self.strict, **asdict(self)}


def table_of(
    recording: str, scores: CountScores, right_min_percent: Mapping[str, float] = RIGHT_MIN_PERCENT
) -> CountingTable:
    """The rows of one recording's scores; ranges that never occur are left out."""
    return CountingTable(
        tuple(CrossingRow(recording, rule, score) for rule, score in scores.crossings.items()),
        tuple(
            OccupancyRow(recording, rule, group, right_min_percent[group.people])
            for rule, groups in scores.occupancy.items()
            for group in groups
            if group.frames
        ),
    )


def count_frames(recording: str, tracks: Trajectories, truth: Trajectories, n_frames: int) -> FrameCounts:
    """Compare the number of confirmed tracks with that of people who show, in frames 0 to n_frames - 1.

    Args:
        truth: with ``visible``; people without it count as seen.
    """
    shown = truth.frame[~(truth.visible < VISIBLE_MIN)]
    confirmed = tracks.frame[tracks.state == "confirmed"]
    found, true = (np.bincount(f[f < n_frames], minlength=n_frames) for f in (confirmed, shown))
    return FrameCounts(recording, n_frames, int((found != true).sum()), int((found < true).sum()))


@dataclass(frozen=True)
class Scorer:
    """How scenes of a single camera are rendered, tracked and scored.

    Attributes:
        rendering: options of it; fewer frames than a scene has are scored alone.
        out: gets a folder with each run.
        progress: takes messages.
    """

    rendering: Rendering
    out: Path
    config: Config
    progress: Progress
    tracker: SingleTracker = "human-model"

    def track(self, recording: Path, camera: Path | None, name: str) -> tuple[Engine, Trajectories]:
        """Track the recording of a single camera into a folder."""
        self.progress(f"tracking {name} with {self.tracker}")
        engine = open_engine(recording, self.tracker, self.config, camera)
        if engine.stereo is not None:
            raise InputError(f"{recording}: expected the recording of a single camera, found a stereo pair")
        return engine, run(engine, self.out / name, overwrite=True)

    def score(
        self, scene: Scene, name: str, rules_on: Callable[[RulePlane], Rules], right_min_percent: Mapping[str, float]
    ) -> CountingTable:
        """Render a scene unless the cache has it, track it, count, and score the counts.

        Args:
            rules_on: makes what is counted, on the floor of the camera.
            right_min_percent: what each range of true numbers must reach.
        """
        recording = rendered(scene, name, self.rendering, self.progress)
        engine, tracks = self.track(recording, recording / "camera.toml", name)
        rules, truth = rules_on(RulePlane(engine.camera)), read_truth(recording / "truth.csv")
        clock, n_frames = Clock(tracks, engine.recording.fps), self.rendering.frames or engine.recording.n_frames
        found = count_tracks(tracks, rules, clock=clock, n_frames=n_frames)
        true = count_truth(truth, rules, clock, n_frames=n_frames)
        counts = CountingTable(views=(count_frames(name, tracks, truth, n_frames),))
        return table_of(name, score_counts(true, found, WINDOW_S), right_min_percent) + counts


def score_scene(rules: Path, scorer: Scorer) -> CountingTable:
    """Score a committed scene with the rules beside it (NAME.rules.toml beside NAME.toml)."""
    name = rules.name.removesuffix(RULES)
    scene = load_scene(rules.with_name(f"{name}.toml"))
    return scorer.score(scene, name, lambda plane: load_rules(rules, plane), RIGHT_MIN_PERCENT)


def score_room(seed: int, scorer: Scorer) -> CountingTable:
    """Score the number of people in the drawn conference room of a seed."""
    drawn, name = random_conference(seed), f"conference-{seed}"
    zone = {"name": "room", "polygon_m": [list(corner) for corner in drawn.zone_m]}
    return scorer.score(
        drawn.scene, name, lambda plane: parse_rules({"zone": [zone]}, plane, name), ROOM_RIGHT_MIN_PERCENT
    )


def all_rooms(tables: Sequence[CountingTable]) -> CountingTable:
    """The rows of every room, and after several rooms one row for each range with the frames of all of them."""
    together = sum(tables, CountingTable())
    if len(tables) < 2:
        return together
    rows = []
    for people, least in ROOM_RIGHT_MIN_PERCENT.items():
        groups = [row.group for row in together.occupancy if row.group.people == people and row.group.frames]
        if groups:
            frames = [g.frames for g in groups]
            right, mean, absolute = (
                float(np.average([getattr(g, name) for g in groups], weights=frames))
                for name in ("right_percent", "mean_difference", "mean_absolute_difference")
            )
            rows.append(
                OccupancyRow("all rooms", "room", OccupancyGroup(people, sum(frames), right, mean, absolute), least)
            )
    return together + CountingTable(occupancy=tuple(rows))


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
        tracks = read_laboratory(data / name)
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
    ways: list[tuple[int, Direction]] = [
        (frame, "right_to_left") for frame in (96, 154, 828, 918, 1001, 1021, 1296, 1306)
    ]
    # True crossings of the line y = 200 (frames), from the README of the recordings.
    return [
        Event(frame, frame / 30.0, "y = 200", "crossing", person, way)
        for person, (frame, way) in enumerate([*ways, (351, "left_to_right")], start=1)
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


def score_view(path: Path, seed: int, scorer: Scorer) -> ViewScore:
    """Render a view of a seed unless the cache has it, track it, and count at its line.

    Ellipses are tracked and counted in the image without a camera; the human model on the floor with the true one.
    """
    view = drawn_view(path, seed)
    recording = rendered(view.scene, f"view-{path.stem}-{seed}", scorer.rendering, scorer.progress)
    camera = recording / "camera.toml" if scorer.tracker == "human-model" else None
    engine, tracks = scorer.track(recording, camera, f"{path.stem}-{seed}-{scorer.tracker}")
    truth = full_truth(recording / "truth.csv")
    size = view.scene.mount.width, view.scene.mount.height
    rules = parse_rules(rules_of(view, size), RulePlane(engine.camera, size), "line")
    clock, n = Clock(tracks, view.scene.fps), scorer.rendering.frames or view.scene.n_frames
    true = count_truth(truth, rules, clock, n_frames=n)
    scores = score_counts(true, count_tracks(tracks, rules, clock=clock, n_frames=n), WINDOW_S)
    middle = scores.occupancy["middle"]
    right = sum(g.frames * (g.right_percent or 0.0) for g in middle) / 100
    return ViewScore(
        path.stem,
        seed,
        scorer.tracker,
        scores.crossings["line"],
        found=len(np.unique(tracks.track_id[tracks.state == "confirmed"])),
        there=len(np.unique(truth.track_id[truth.visible >= VISIBLE_MIN])),
        wrong_frames=count_frames(path.stem, tracks, truth, n).error,
        occupancy=right / max(1, sum(g.frames for g in middle)),
    )


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
    """Seeds of the drawn views of data/synthetic/views (--scene names some of these then), with both trackers. Seeds 0
    to 9 are worked on, others judge."""
    rooms: Annotated[Sequence[int], Parameter(negative="", show_default=False)] = ()
    """Seeds of drawn conference rooms: another camera, other clothes and seats each. Seeds 0 to 9 are worked on, others
    judge."""
    out: Path | None = None
    """Folder that keeps the runs; a temporary one by default."""


def counting(*, options: CountingOptions | None = None) -> None:
    """Score counts and occupancy on rendered views and real recordings, beside the paper's figures.

    Example: python -m benchmarks counting --scene door_oblique --scene conference

    Example of wrong numbers of people: python -m benchmarks counting --scene station --tracker ellipse-particle

    Example with drawn views of seeds never looked at: python -m benchmarks counting --seeds 501 --seeds 502

    Example with drawn conference rooms: python -m benchmarks counting --rooms 501 --rooms 502

    Example with the real recordings: python -m benchmarks counting --data ../shared/data --pavement-camera camera.toml
    """
    o = options or CountingOptions()
    if o.frames is not None and o.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {o.frames}")
    for name, seeds in (("--seeds", o.seeds), ("--rooms", o.rooms)):
        if any(seed < 0 for seed in seeds):
            raise InputError(f"{name}: expected numbers from 0, found {min(seeds)}")
    console = Console(markup=False)
    with _scoring(o) as scorer:
        if o.seeds:
            views = [
                score_view(path, seed, replace(scorer, tracker=tracker))
                for seed in o.seeds
                for path in scene_files(o.scene, VIEWS)
                for tracker in get_args(SingleTracker)
            ]
        elif o.rooms:
            table = all_rooms([score_room(seed, scorer) for seed in o.rooms])
        else:
            table = sum((score_scene(path, scorer) for path in scene_files(o.scene, o.scenes, RULES)), CountingTable())
            if o.data is not None:
                table += score_trajectories(o.data / "trajectories")
                who = scorer if o.pavement_camera is not None else replace(scorer, tracker="ellipse-particle")
                table += score_pavement(o.data / "overhead-counting" / "pavement.mp4", who, o.pavement_camera)
    if o.json_output:
        print(json.dumps([v.to_json() for v in views] if o.seeds else table.to_json(), indent=2))
    elif o.seeds:
        print_views(views, console)
    else:
        print_counting(table, console)


@contextmanager
def _scoring(o: CountingOptions) -> Iterator[Scorer]:
    """With a line of progress, and a temporary folder for runs that are not kept."""
    rendering = Rendering(o.cache_folder, frames=o.frames)
    with tempfile.TemporaryDirectory() as temporary, Console(stderr=True, markup=False).status("...") as status:
        yield Scorer(rendering, o.out or Path(temporary), o.settings(), status.update, o.tracker)


def print_views(scores: Sequence[ViewScore], console: Console) -> None:
    """A row per view and tracker, and each tracker's mean with 95 % of the sets drawn from these views again."""
    show([{"view": f"{s.view} {s.seed}", "tracker": s.tracker, **_crossings(s.crossings), "strict": s.strict,
           "people": s.found, "there": s.there, "wrong_frames": s.wrong_frames, "occupancy": s.occupancy}
          for s in scores], console)  # fmt: skip
    means = []
    for tracker in dict.fromkeys(s.tracker for s in scores):
        mine = [s for s in scores if s.tracker == tracker]
        strict = np.array([s.strict for s in mine])
        drawn = np.random.default_rng(0).choice(strict, (10_000, len(strict))).mean(axis=1)
        low, high = map(float, np.quantile(drawn, (0.025, 0.975)))
        means.append({
            "tracker": tracker, "strict_mean": float(strict.mean()), "from": low, "to": high,
            "strict_worst": float(strict.min()), "people": sum(s.found for s in mine),
            "there": sum(s.there for s in mine), "occupancy": float(np.mean([s.occupancy for s in mine])),
        })  # fmt: skip
    show(means, console)


def print_counting(table: CountingTable, console: Console) -> None:
    """Crossings as in table 3 and occupancy as in table 4 of the paper, beside what they must be."""
    if table.crossings:
        rows = [(row, row.scores) for row in table.crossings]
        show([{"view: line": f"{row.recording}: {row.rule}", **_crossings(s), "accuracy": s.accuracy,
               "to_reach": ACCURACY_MIN, "strict": s.strict_accuracy, "precision": s.precision, "recall": s.recall,
               "turned": s.wrong_direction, "late_s": s.timing_mean_s, "": "ok" if row.ok else "short"}
              for row, s in rows], console)  # fmt: skip
    if table.occupancy:
        show([{"view: zone": f"{row.recording}: {row.rule}", **asdict(row.group), "to_reach": row.min_percent,
               "paper": PAPER_RIGHT_PERCENT[row.group.people], "": "ok" if row.ok else "short"}
              for row in table.occupancy], console)  # fmt: skip
    if table.views:
        show([{**asdict(view), "error": view.error} for view in table.views], console)


def _crossings(scores: CrossingScores) -> dict[str, str]:
    """True and found numbers, left to right and right to left."""
    return {
        "true": f"{scores.true_left_to_right}+{scores.true_right_to_left}",
        "found": f"{scores.found_left_to_right}+{scores.found_right_to_left}",
    }
