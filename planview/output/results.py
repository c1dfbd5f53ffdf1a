"""What a run left in its folder."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.io import reason
from calib.types import F64
from planview.counting.events import Event, read_events
from planview.counting.totals import Clock
from planview.drawing.plan import PlanBounds, Rule, bounds_of, rules_of
from planview.output.folder import RunInfo, read_run_info
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories, read_tracks


def source_of(info: RunInfo) -> Path:
    """The recording with the images: of maps.h5 that of the run that wrote it, as far as it tells."""
    path = Path(info.input)
    # Plan-view recordings are followed so far back to the recording with the images.
    for _ in range(4):
        beside = path.parent / "run.json"
        if not (path.is_file() and beside.is_file()):
            break
        from planview.maps.recording import is_maps  # brings HDF5

        if not is_maps(path):
            break
        path = Path(read_run_info(beside).input)
    return path


@dataclass(frozen=True, eq=False)
class RunResults:
    """The files of a run; empty where a file is missing.

    Attributes:
        folder: of the run.
        info: run.json; has_run: whether there is one.
        tracks: all rows of tracks.csv.
        events: of events.csv.
        counts: counts.json, else the counts of run.json.
        truth: of the frames tracked, where there is one.
    """

    folder: Path
    info: RunInfo
    has_run: bool
    tracks: Trajectories
    events: list[Event]
    counts: dict[str, Any]
    truth: Trajectories | None

    @cached_property
    def clock(self) -> Clock:
        """Frames to times."""
        # Where the tracks have no times.
        return Clock(self.tracks, 30.0)

    @property
    def n_frames(self) -> int:
        """Frames of the run."""
        last = int(self.tracks.frame.max()) + 1 if len(self.tracks) else 0
        return max(last, self.info.frames_read + self.info.frames_skipped)

    @property
    def on_floor(self) -> bool:
        """Whether the floor is known: without a camera, people are in pixels alone."""
        return self.info.floor is not None or bool(np.isfinite(self.tracks.x_m).any())

    @property
    def rules(self) -> list[Rule]:
        """Tripwires and zones that can be drawn."""
        return rules_of(self.rule_counts)

    @property
    def rule_counts(self) -> dict[str, Any]:
        """Of every rule by name, its kind, points and totals."""
        rules = self.counts.get("rules")
        return rules if isinstance(rules, dict) else {}

    @property
    def cameras(self) -> list[tuple[tuple[float, float], F64]]:
        """Place on the floor and outline of the view (N, 2) of every camera [m]."""
        rig = self.info.rig
        views = [] if rig is None else rig.heads or [rig]
        return [(view.at_m, np.array(view.view_m, dtype=np.float64).reshape(-1, 2)) for view in views]

    def bounds(self) -> PlanBounds:
        """Where people were, the rules, and cameras that are not far from them."""
        tracks, known = self.tracks, self.tracks.state != "tentative"
        places = [
            np.column_stack([tracks.x_m[known], tracks.y_m[known]]),
            *(rule.points for rule in self.rules if rule.on_floor),
        ]
        bounds = bounds_of(*places)
        size = max(bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m)
        near = []
        for (x, y), _ in self.cameras:
            beyond = max(bounds.x_min_m - x, x - bounds.x_max_m, bounds.y_min_m - y, y - bounds.y_max_m)
            # Cameras within this share of the size of the floor that people used are shown with it: a camera far from
            # them would make everything small.
            near += [np.array([(x, y)])] if beyond <= 0.6 * size else []
        return bounds_of(*places, *near)


def read_results(folder: Path, truth: Path | None = None) -> RunResults:
    """Read a run's folder.

    Args:
        truth: file of the true people; ``truth.csv`` of the recording where not given.
    Raises:
        InputError: no tracks.csv, or a file that is not what its name says.
    """
    run, events = folder / "run.json", folder / "events.csv"
    info = read_run_info(run) if run.is_file() else RunInfo()
    beside = source_of(info) / "truth.csv" if info.input else None
    if truth is None and beside is not None and beside.is_file():
        truth = beside
    results = RunResults(
        folder,
        info,
        run.is_file(),
        read_tracks(folder / "tracks.csv"),
        read_events(events) if events.is_file() else [],
        read_object(folder / "counts.json") or dict(info.counts),
        None,
    )
    if truth is None:
        return results
    people = load_truth(truth)
    return replace(results, truth=people.where(people.frame < results.n_frames))


def read_object(path: Path) -> dict[str, Any]:
    """A JSON object; an empty one where there is no file.

    Raises:
        InputError: something else.
    """
    if not path.is_file():
        return {}
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected JSON, found {reason(error)}") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(value).__name__}")
    return value
