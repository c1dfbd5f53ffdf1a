"""Recorded plan-view maps to people: all that comes after the foreground, from its points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.types import U8
from planview.engine.config import Config
from planview.engine.engine import Engine, Frame, FrameResult, Remembers, StageClock, refuse_frame
from planview.maps.builder import floor_in_view, plan_view
from planview.maps.pixels import Cloud, SeenPixels
from planview.maps.recording import MapsFrame, MapsRecording
from planview.tracking.base import Observation, Tracker, followed

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


class ReplayEngine(Engine):
    """Builds maps from recorded points, and lets a tracker follow people in them.

    With the parameters of the recording the tracks are the same bit for bit. With others they are an approximation:
    the feedback that the recording's tracker gave to its foreground stays in the points.
    """

    def __init__(self, recording: MapsRecording, tracker: Tracker, config: Config | None = None) -> None:
        """Compose the stages, with the parameters of the recording when ``config`` is None.

        Raises:
            InputError: a parameter that decided which points were recorded differs, or maps of another rig.
        """
        recorded = recorded_config(recording)
        config = config or recorded
        _refuse_fixed(recording.path, recorded, config)
        view, pose = recording.view, recording.view.floor.world_SE3_left
        try:
            if floor_in_view(view.geometry, pose, recorded.maps) != view.grid:
                raise ValueError("expected the grid of the rig and floor in the file, found one of another rig")
            self._cloud = Cloud(view.geometry, pose, config.maps, view.reduction)
        except ValueError as error:
            raise InputError(f"{recording.path}: {error}") from error
        self._path, self._view = recording.path, replace(view, grid=self._cloud.grid)
        super().__init__(recording, tracker, config, view.camera, view.geometry.size, {"": self._view})

    def memory(self) -> dict[str, Remembers]:
        """The tracker, and how far away the background is."""
        return super().memory() | {"background": self._cloud.background}

    def prepare(self, frame: Frame, clock: StageClock) -> Callable[[], FrameResult]:
        """See ``Engine``. Raises InputError, too, when the frame is tracked: damaged maps."""
        if not isinstance(frame, MapsFrame):
            refuse_frame("the points of plan-view maps", frame)
        return partial(self._track, frame, clock)

    def _track(self, frame: MapsFrame, clock: StageClock) -> FrameResult:
        disparity, mask = np.full(self._cloud.shape, np.nan, np.float32), np.zeros(self._cloud.shape, np.uint8)
        disparity.reshape(-1)[frame.pixels] = frame.disparities
        mask.reshape(-1)[frame.pixels] = mask.reshape(-1)[frame.unmatched] = 255
        codes: U8 | None = None
        if frame.colours is not None:
            codes = np.zeros(mask.shape, np.uint8)
            codes.reshape(-1)[frame.pixels] = frame.colours
        view = self._cloud.seen(disparity, mask, frame.timestamp_s, frame.background, codes=codes)
        if unknown := len(frame.unmatched) == mask.size:
            view = SeenPixels.unknown(self._cloud.rays)
        if len(view.points.pixels) != len(frame.pixels):
            raise InputError(
                f"{self._path}: frame {frame.index}: expected {len(frame.pixels)} points in reach of the rig, "
                f"found {len(view.points.pixels)}: the maps are damaged or another rig's"
            )
        clock.record("maps")
        build_maps = partial(plan_view, view.points, self._cloud.grid, self.config.maps)
        camera, at = self.camera, (frame.index, frame.timestamp_s)
        observation = Observation(*at, views=(view,), camera=camera, build_maps=build_maps, unknown=unknown)
        tracks, decisions = followed(self.tracker, observation), self.tracker.decisions
        clock.record("track")
        return FrameResult(
            frame.index, frame.timestamp_s, tracks, decisions, observation, clock.stages_ms, stereo=self._view
        )


def _refuse_fixed(path: Path, recorded: Config, config: Config) -> None:
    fixed = [(name, getattr(recorded, name), getattr(config, name)) for name in FIXED_TABLES]
    fixed += [(f"maps.{n}", getattr(recorded.maps, n), getattr(config.maps, n)) for n in FIXED_MAP_PARAMETERS]
    for name, before, now in fixed:
        if before != now:
            raise InputError(f"{path}: expected {name} as recorded, found it changed: the points depend on it")
