"""Tracking recorded plan-view maps: all that comes after the foreground, from its points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.errors import InputError
from planview.checks.check import Check
from planview.engine.boxes import BodyBoxes
from planview.engine.config import Config
from planview.engine.describe import StereoDescription
from planview.engine.engine import FrameResult, StageClock, beyond, timed_steps
from planview.maps.builder import MapBuilder
from planview.maps.pixels import KeptBackground, PixelRays, seen_pixels
from planview.maps.recording import MapsFrame, MapsRecording
from planview.tracking.base import Observation, Tracker

FIXED_TABLES = ("analysis", "rectify", "range", "sgbm", "matching", "floor", "foreground", "feedback")
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


class MapsPipeline(StereoDescription):
    """Build maps from recorded points and track: an ``Engine`` for plan-view recordings.

    With the parameters of the recording the tracks are the same bit for bit. With others they are an approximation:
    the feedback that the recording's tracker gave to its foreground stays in the points.

    Attributes:
        recording, config, tracker, stereo: see ``Engine``.
    """

    checks: tuple[Check, ...] = ()

    def __init__(self, recording: MapsRecording, tracker: Tracker, config: Config | None = None) -> None:
        """Compose the stages.

        Args:
            config: that of the recording when None.
        Raises:
            InputError: a parameter that decided which points were recorded differs, or maps of another rig.
        """
        recorded = recorded_config(recording)
        self.recording, self.tracker = recording, tracker
        self.config = c = config or recorded
        _refuse_fixed(recording.path, recorded, c)
        view = recording.view
        pose = view.floor.world_SE3_left
        try:
            if MapBuilder(view.geometry, pose, recorded.maps, view.reduction).grid != view.grid:
                raise ValueError("expected the grid of the rig and floor in the file, found one of another rig")
            self._maps = MapBuilder(view.geometry, pose, c.maps, view.reduction)
        except ValueError as error:
            raise InputError(f"{recording.path}: {error}") from error
        self.stereo = replace(view, grid=self._maps.grid)
        self._boxes = BodyBoxes(view.geometry, pose)
        self._background = KeptBackground()
        self._rays = PixelRays.of(view.geometry, pose, self._maps.shape, view.reduction)
        self._disparity = np.empty(view.shape, dtype=np.float32)
        self._mask = np.empty(view.shape, dtype=np.uint8)

    @staticmethod
    def from_recording(path: Path, tracker: Tracker, config: Config | None = None) -> MapsPipeline:
        """Open a plan-view recording (same errors as ``MapsRecording`` and the constructor)."""
        return MapsPipeline(MapsRecording(path), tracker, config)

    def reset(self) -> None:
        """Forget all people."""
        self.tracker.reset()
        self._background.reset()

    def step(self, frame: MapsFrame) -> FrameResult:
        """Track the points of the next frame."""
        return self._track(frame, StageClock())

    def __iter__(self) -> Iterator[FrameResult]:
        """``step`` over the recording from its first frame."""
        self.reset()
        yield from self.after(-1)

    def memory(self) -> dict[str, object]:
        """See ``Engine``."""
        return {"tracker": self.tracker, "background": self._background}

    def after(self, frame: int) -> Iterator[FrameResult]:
        """See ``Engine``."""
        yield from timed_steps(beyond(self.recording, frame), self._track)

    def _track(self, frame: MapsFrame, clock: StageClock) -> FrameResult:
        self._mask[:] = 0
        self._mask.reshape(-1)[frame.pixels] = 255
        self._disparity.reshape(-1)[frame.pixels] = frame.disparities
        maps = self._maps(self._disparity, self._mask)
        if len(maps.points.pixels) != len(frame.pixels):
            raise InputError(
                f"{self.recording.path}: frame {frame.index}: expected {len(frame.pixels)} points in reach of the rig, "
                f"found {len(maps.points.pixels)}: the maps are damaged or another rig's"
            )
        maps = replace(maps, points=replace(maps.points, colours=frame.colours))
        if frame.background is not None:
            self._background.renew(frame.background, frame.timestamp_s)
        lowest_m = self.config.maps.height_min_m
        seen = seen_pixels(self._rays, maps.points, frame.unmatched, self._background.disparity, lowest_m)
        clock.record("maps")
        observation = Observation(frame.index, frame.timestamp_s, maps=maps, views=(seen,))
        tracks = tuple(self._boxes(track) for track in self.tracker.update(observation))
        clock.record("track")
        return FrameResult(
            frame.index, frame.timestamp_s, tracks, self.tracker.decisions, observation, None, clock.stages_ms
        )


def _refuse_fixed(path: Path, recorded: Config, config: Config) -> None:
    fixed = [(name, getattr(recorded, name), getattr(config, name)) for name in FIXED_TABLES]
    fixed += [(f"maps.{n}", getattr(recorded.maps, n), getattr(config.maps, n)) for n in FIXED_MAP_PARAMETERS]
    for name, before, now in fixed:
        if before != now:
            raise InputError(f"{path}: expected {name} as recorded, found it changed: the points depend on it")
