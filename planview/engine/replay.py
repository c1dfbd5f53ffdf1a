"""Recorded plan-view maps to people: all that comes after the foreground, from its points."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calib.carried import Carried
from calib.errors import InputError
from planview.engine.config import Config
from planview.engine.engine import Engine, Frame, RigDepths, StageClock, refuse_frame
from planview.maps.grid import floor_in_view
from planview.maps.plan_view import plan_view
from planview.maps.recording import MapsFrame, MapsRecording
from planview.maps.view import MapBuilder, View
from planview.tracking.base import Observation, Tracker, followed
from planview.trajectories.state import TrackState

FIXED_TABLES = ("analysis", "rectify", "range", "sgbm", "floor", "foreground", "feedback")
FIXED_MAP_PARAMETERS = ("height_max_m", "depth_std_max_m")
"""Parameters that decided which points were recorded."""


def recorded_config(recording: MapsRecording) -> Config:
    """The configuration that made a plan-view recording.

    Raises:
        InputError: it has parameters that this version does not know.
    """
    try:
        return Config.model_validate_json(recording.config)
    except ValueError as error:
        raise InputError(
            f"{recording.path}: expected the parameters of this version, found others: another version wrote the maps"
        ) from error


class ReplayStages:
    """Builds views from recorded points: ``Stages``.

    With the parameters of the recording the tracks are the same bit for bit. With others they are an approximation:
    the feedback that the recording's tracker gave to its foreground stays in the points.
    """

    ahead = 0
    checks = ()

    def __init__(self, recording: MapsRecording, config: Config, tracker: Tracker) -> None:
        """Raises InputError: a parameter that decided which points were recorded differs, or maps of another rig."""
        recorded, rig, self.tracker = recorded_config(recording), recording.view, tracker
        _refuse_fixed(recording.path, recorded, config)
        try:
            if floor_in_view(rig.geometry, rig.floor.world_SE3_left, recorded.maps) != rig.grid:
                raise ValueError("expected the grid of the rig and floor in the file, found one of another rig")
            self._maps = MapBuilder(rig.geometry, rig.floor.world_SE3_left, config.maps, rig.reduction)
        except ValueError as error:
            raise InputError(f"{recording.path}: {error}") from error
        self._path, self.camera, self.size = recording.path, rig.camera, rig.geometry.size
        self.rigs = {"": replace(rig, grid=self._maps.grid)}

    def match(self, frame: Frame, clock: StageClock) -> RigDepths:
        """Nothing: recorded points have been matched."""
        if not isinstance(frame, MapsFrame):
            refuse_frame("the points of plan-view maps", frame)
        return ()

    def track(
        self, frame: MapsFrame, depths: RigDepths, clock: StageClock
    ) -> tuple[Observation, tuple[TrackState, ...]]:
        """See ``Stages``. Raises InputError: damaged maps."""
        view = self._view(frame)
        clock.record("maps")
        maps = partial(plan_view, [view.points], self._maps.grid, self._maps.params)
        observation = Observation(frame.index, frame.timestamp_s, (view,), self.camera, maps)
        return observation, followed(self.tracker, observation)

    def _view(self, frame: MapsFrame) -> View:
        maps = self._maps
        disparity, mask = np.full(maps.shape, np.nan, np.float32), np.zeros(maps.shape, np.uint8)
        disparity.reshape(-1)[frame.pixels] = frame.disparities
        mask.reshape(-1)[frame.pixels] = mask.reshape(-1)[frame.unmatched] = 255
        points = maps.points(disparity, mask)
        if len(points.pixels) != len(frame.pixels):
            raise InputError(
                f"{self._path}: frame {frame.index}: expected {len(frame.pixels)} points in reach of the rig, "
                f"found {len(points.pixels)}: the maps are damaged or another rig's"
            )
        if len(frame.unmatched) == mask.size:
            return View.unknown(maps.shape, rays=maps.rays)
        return maps.view(replace(points, colours=frame.colours), mask, frame.timestamp_s, frame.background)

    def memory(self) -> dict[str, Carried]:
        """How far away the background is."""
        return {"maps": self._maps}


def replay_engine(recording: MapsRecording, tracker: Tracker, config: Config | None = None) -> Engine:
    """An engine for recorded plan-view maps, with the parameters of the recording when ``config`` is None. Raises
    InputError: a parameter that decided which points were recorded differs, or maps of another rig."""
    config = config or recorded_config(recording)
    return Engine(recording, config, ReplayStages(recording, config, tracker))


def _refuse_fixed(path: Path, recorded: Config, config: Config) -> None:
    fixed = [(name, getattr(recorded, name), getattr(config, name)) for name in FIXED_TABLES]
    fixed += [(f"maps.{n}", getattr(recorded.maps, n), getattr(config.maps, n)) for n in FIXED_MAP_PARAMETERS]
    for name, before, now in fixed:
        if before != now:
            raise InputError(f"{path}: expected {name} as recorded, found it changed: the points depend on it")
