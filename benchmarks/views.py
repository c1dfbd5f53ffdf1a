"""Counts of both single-camera trackers on drawn views of one camera (``data/synthetic/views``), beside their truth."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from benchmarks.accuracy import RenderOptions, Tell, rendered
from benchmarks.frame_counts import VISIBLE_MIN, count_frames
from calib.errors import InputError
from calib.io import parse_toml, read_text
from calib.params import first_problem
from planview.counting.geometry import RulePlane
from planview.counting.rules import parse_rules
from planview.counting.scoring import CrossingScores, score_counts
from planview.counting.totals import Clock, count_tracks, count_truth
from planview.engine.config import Config
from planview.engine.factory import open_engine
from planview.synthetic.assets import SCENES
from planview.synthetic.random_scenes.views import RandomView, random_view
from planview.trajectories.table import Trajectories, TrajectoryCollector, read_truth

VIEWS = SCENES / "views"
"""The committed tables of views, by name."""
WINDOW_S = 2.0
"""Largest time between a true crossing and the one counted for it [s]: a person hesitating in a door (our choice)."""
FULL_BOX = ("full_left_px", "full_top_px", "full_width_px", "full_height_px")
ViewTracker = Literal["human-model", "ellipse-particle"]


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
    tracker: ViewTracker
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


def view_names(names: Sequence[str] = ()) -> list[str]:
    """Views by name.

    Raises:
        InputError: no such view.
    """
    known = [path.stem for path in sorted(VIEWS.glob("*.toml"))]
    for name in names:
        if name not in known:
            raise InputError(f"--scene: expected one of the views {', '.join(known)}, found {name!r}")
    return list(names) or known


def drawn_view(name: str, seed: int, changes: Mapping[str, Mapping[str, Any]] | None = None) -> RandomView:
    """The view of a seed, with some values changed (see ``random_view``).

    Raises:
        InputError: unreadable, or a value out of its range.
    """
    path = VIEWS / f"{name}.toml"
    try:
        return random_view(parse_toml(read_text(path, "a view in TOML")), seed, name, changes)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(error)}") from error


def score_drawn_view(
    name: str, seed: int, tracker: ViewTracker, options: RenderOptions, config: Config, tell: Tell
) -> ViewScore:
    """Render a view of a seed unless the cache has it, track it, and count at its line.

    Ellipses are tracked and counted in the image without a camera; the human model on the floor with the true one.
    """
    view = drawn_view(name, seed)
    recording = rendered(view.scene, f"view-{name}-{seed}", options, tell)
    tell(f"tracking {name} of seed {seed} with {tracker}")
    camera = recording / "camera.toml" if tracker == "human-model" else None
    engine = open_engine(recording, tracker, config, camera)
    collector = TrajectoryCollector()
    for result in engine:
        collector.add(result.frame, result.timestamp_s, result.tracks)
    tracks, truth = collector.trajectories(), full_truth(recording / "truth.csv")
    size = view.scene.mount.width, view.scene.mount.height
    rules = parse_rules(rules_of(view, size), RulePlane(getattr(engine, "camera", None), size), "line")
    clock, n = Clock(tracks, view.scene.fps), options.frames or view.scene.n_frames
    true = count_truth(truth, rules, clock, n_frames=n)
    scores = score_counts(true, count_tracks(tracks, rules, clock=clock, n_frames=n), WINDOW_S)
    right = sum(g.frames * (g.right_percent or 0.0) for g in scores.occupancy["middle"]) / 100
    occupancy = right / max(1, sum(g.frames for g in scores.occupancy["middle"]))
    found = len(np.unique(tracks.track_id[tracks.state == "confirmed"]))
    there = len(np.unique(truth.track_id[truth.visible >= VISIBLE_MIN]))
    wrong = count_frames(name, tracks, truth, n).error
    return ViewScore(name, seed, tracker, scores.crossings["line"], found, there, wrong, occupancy)


def rules_of(view: RandomView, size: tuple[int, int]) -> dict[str, Any]:
    """The line of a view, and a zone in its middle: three quarters of its width and height, where there is floor."""
    left, right, bottom = size[0] / 8, 7 * size[0] / 8, size[1] - 1.0
    top = max(size[1] / 4, _horizon(view) + 0.05 * size[1])
    zone = {"name": "middle", "polygon_px": [[left, top], [right, top], [right, bottom], [left, bottom]]}
    return {
        "tripwire": [{"name": "line", "from_px": list(view.wire_px[0]), "to_px": list(view.wire_px[1])}],
        "zone": [zone],
    }


def _horizon(view: RandomView) -> float:
    """Row of the horizon [px], negative above the image."""
    camera = view.scene.camera
    assert camera is not None  # a view has one
    return (camera.height - 1) / 2 - camera.focal_px / max(math.tan(math.radians(camera.tilt_deg)), 1e-6)


def full_truth(path: Path) -> Trajectories:
    """``truth.csv`` with the boxes of whole silhouettes inside the image, whatever hides them."""
    truth = read_truth(path)
    with path.open(newline="", encoding="utf-8") as file:
        rows = [[float(row[name] or "nan") for name in FULL_BOX] for row in csv.DictReader(file)]
    truth.box_px[:] = np.array(rows).reshape(-1, 4)
    return truth
