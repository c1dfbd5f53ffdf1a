"""A run's folder, opened: its files, its camera, its recording and its tracks, read when they are used."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.errors import InputError
from calib.floor_camera import FloorCamera
from calib.io import expecting
from calib.types import F64, I64, Bool
from planview.counting.events import Event, read_events
from planview.counting.rules import RulePlane
from planview.drawing.plan import PlanBounds, bounds_of
from planview.drawing.rules import Rule, rules_of
from planview.engine.info import camera_of
from planview.output.folder import RunInfo, read_run_info
from planview.trajectories.clock import Clock, Span
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories, people_of, read_tracks
from stereo.recording import OpenOptions

if TYPE_CHECKING:
    from planview.engine.config import Config
    from planview.evaluation.evaluate import EvaluationParams
    from planview.evaluation.result import Evaluation


TRACKS_ONLINE = "tracks_online.csv"
"""Tracks as the tracker wrote them, once they are refined."""
TRACKS_BEFORE = "tracks_before.csv"
"""Tracks without any edit, once they are edited."""


CAMERA_REACH = 0.6
"""Share of the size of the floor that people used, within which a camera is shown with it: one far from them would make
everything small."""


@dataclass(frozen=True, eq=False)
class RunFolder:
    """Results of a run in its folder; a part is read, or refused with InputError, when it is first used.

    Args:
        path: of the folder.
        truth_path: file of the true people; ``truth.csv`` of the recording where not given.
        other_tracks: in place of those of tracks.csv.
    """

    path: Path
    truth_path: Path | None = None
    other_tracks: Trajectories | None = None

    @staticmethod
    def around(path: Path) -> RunFolder | None:
        """The run of a folder or of a file of its tracks; None for other tracks."""
        folder = path
        if not path.is_dir():
            if path.name not in ("tracks.csv", TRACKS_ONLINE, TRACKS_BEFORE):
                return None
            folder = path.parent
        return RunFolder(folder) if (folder / "run.json").is_file() else None

    def read_all(self) -> RunFolder:
        """Itself; raises InputError for any part that cannot be read."""
        _ = self.info, self.tracks, self.events, self.counts, self.truth
        return self

    @property
    def has_run(self) -> bool:
        """True where there is a run.json; ``info`` is empty without one."""
        return (self.path / "run.json").is_file()

    @cached_property
    def info(self) -> RunInfo:
        """run.json."""
        return read_run_info(self.path / "run.json") if self.has_run else RunInfo()

    @cached_property
    def config(self) -> Config:
        """The parameters of the run; raises InputError: those of another version."""
        from planview.engine.config import config_of  # brings all trackers

        return config_of(self.info.config, str(self.path / "run.json"))

    @cached_property
    def tracks(self) -> Trajectories:
        """All rows of tracks.csv, with the frames that the run read."""
        info = self.info
        tracks = read_tracks(self.path / "tracks.csv") if self.other_tracks is None else self.other_tracks
        rows_end = int(tracks.frame.max(initial=-1)) + 1
        read_end = info.first_frame + info.frames_read + info.frames_skipped
        return replace(tracks, first_frame=info.first_frame, n_frames=max(rows_end, read_end))

    @cached_property
    def as_tracked(self) -> RunFolder:
        """The run with the tracks that the tracker wrote, before they were refined and edited."""
        if self.other_tracks is not None:
            return self
        if self.info.refined:
            return replace(self, other_tracks=read_tracks(self.path / TRACKS_ONLINE))
        before_edits = self.path / TRACKS_BEFORE
        if before_edits.is_file():
            return replace(self, other_tracks=read_tracks(before_edits))
        return self

    @cached_property
    def events(self) -> list[Event]:
        """Events of events.csv; none without it."""
        file = self.path / "events.csv"
        return read_events(file) if file.is_file() else []

    @cached_property
    def counts(self) -> dict[str, Any]:
        """counts.json, else the counts of run.json."""
        return read_object(self.path / "counts.json") or dict(self.info.counts)

    @cached_property
    def _source(self) -> RunInfo:
        """run.json of the run that read the images: of maps.h5 that of the run that wrote it."""
        info = self.info
        for _ in range(5):  # maps of maps
            path = _recording_of(info)
            if path is None or path.suffix != ".h5" or not (path.parent / "run.json").is_file():
                break
            info = read_run_info(path.parent / "run.json")
        return info

    def refuse_own_parts(self, roles: Iterable[str], remedy: str) -> None:
        """Raise InputError for parts that the user made and that are needed: a folder does not keep them."""
        names = [f"{role} {self.info.own_parts[role]}" for role in roles if role in self.info.own_parts]
        if names:
            parts = " and ".join(names)
            raise InputError(f"{self.path}: tracked with your own {parts}, which the folder does not keep: {remedy}")

    @property
    def recording(self) -> Path | None:
        """The recording with the images, as far as it is known."""
        return _recording_of(self._source)

    @property
    def options(self) -> OpenOptions:
        """Options to open the recording with again."""
        return self._source.opened

    @property
    def tracked(self) -> Path | None:
        """Recording that the run read, or maps.h5 of an earlier run."""
        return _recording_of(self.info)

    @property
    def truth_file(self) -> Path | None:
        """The file of the true people; None where there is none."""
        if self.truth_path is not None or self.recording is None:
            return self.truth_path
        file = self.recording / "truth.csv"
        return file if file.is_file() else None

    @cached_property
    def truth(self) -> Trajectories | None:
        """The true people of the frames tracked; None where there is no truth."""
        if self.truth_file is None:
            return None
        people = load_truth(self.truth_file)
        return people.where((people.frame >= self.info.first_frame) & (people.frame < self.n_frames))

    @cached_property
    def camera(self) -> FloorCamera | None:
        """The camera in whose pixels the boxes are, above the floor; None where run.json does not hold it."""
        rig = self.info.rig
        floor = self.info.floor
        if rig is None or floor is None:
            return None
        try:
            return camera_of(rig, floor)
        except ValueError as error:
            raise InputError(f"{self.path / 'run.json'}: expected a camera above the floor: {error}") from error

    @property
    def rule_plane(self) -> RulePlane:
        """Plane of the rules of these tracks, as while they were tracked."""
        return RulePlane(self.camera, self.info.size_px)

    @cached_property
    def clock(self) -> Clock:
        """Frames to times."""
        return Clock(self.tracks, self.info.fps or 30.0)  # 30 where tracks have no times either

    @property
    def n_frames(self) -> int:
        """Frames of the recording up to the last one that the run read."""
        return self.tracks.n_frames or 0

    def evaluate(self, params: EvaluationParams | None = None, frames: tuple[int, int] | None = None) -> Evaluation:
        """The scores of the tracks, by default at the rate of the run and in all its frames (see ``evaluate_tracks``).
        Raises InputError: no truth."""
        from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks  # brings scipy

        if self.truth is None:
            where = (self.recording or Path()) / "truth.csv"
            raise InputError(f"{where}: expected the truth of the run's recording, found none")
        params = params or EvaluationParams(fps=self.info.fps or 30.0)
        return evaluate_tracks(self.tracks, self.truth, params, frames)

    @property
    def frame_s(self) -> float:
        """Time from frame to frame [s]."""
        return 1 / self.info.fps if self.info.fps else self.clock.frame_s

    @cached_property
    def people(self) -> I64:
        """Ids of the people, ascending (``people_of``)."""
        return people_of(self.tracks, self.frame_s)

    @cached_property
    def of_people(self) -> Bool:
        """(N,) whether a row of ``tracks`` is a confirmed one of a person."""
        return np.asarray((self.tracks.state == "confirmed") & np.isin(self.tracks.track_id, self.people))

    @property
    def span(self) -> Span:
        """The time that the frames of the run cover."""
        info = self.info
        if info.start_s is None or info.end_s is None or not info.fps:
            return self.clock.span(self.n_frames)
        return Span(info.start_s, info.end_s, 1 / info.fps)

    @property
    def on_floor(self) -> bool:
        """True where the floor is known: without a camera, people are in pixels alone."""
        return self.info.floor is not None or bool(np.isfinite(self.tracks.x_m).any())

    @property
    def rules(self) -> list[Rule]:
        """Tripwires and zones with known points."""
        return rules_of(self.rule_counts)

    @property
    def rule_counts(self) -> dict[str, Any]:
        """Kind, points and totals of every rule, by name."""
        rules = self.counts.get("rules")
        return rules if isinstance(rules, dict) else {}

    @property
    def cameras(self) -> list[tuple[tuple[float, float], F64]]:
        """Place on the floor and outline of the view (N, 2) of every camera [m]."""
        rig = self.info.rig
        views = [] if rig is None else rig.sensors or [rig]
        return [(view.at_m, np.array(view.view_m, dtype=np.float64).reshape(-1, 2)) for view in views]

    def bounds(self) -> PlanBounds:
        """Part of the floor with people, rules, and cameras that are not far from them."""
        people = self.tracks.where(self.tracks.state != "tentative")
        places = [np.column_stack([people.x_m, people.y_m])]
        places += [rule.points for rule in self.rules if rule.on_floor]
        bounds = bounds_of(*places)
        reach_m = CAMERA_REACH * max(bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m)
        for (x, y), _ in self.cameras:
            beyond_m = max(bounds.x_min_m - x, x - bounds.x_max_m, bounds.y_min_m - y, y - bounds.y_max_m)
            if beyond_m <= reach_m:
                places.append(np.array([(x, y)]))
        return bounds_of(*places)


def _recording_of(info: RunInfo) -> Path | None:
    """The recording of a run where it was, else as it was given."""
    if info.recording and Path(info.recording).exists():
        return Path(info.recording)
    return Path(info.input) if info.input else None


def read_object(path: Path) -> dict[str, Any]:
    """A JSON object; an empty one where there is no file. Raises InputError: something else."""
    if not path.is_file():
        return {}
    with expecting(path, "JSON", OSError, ValueError, RecursionError):
        value = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(value).__name__}")
    return value
