"""``maps.h5``: the plan-view recording of a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.errors import InputError
from planview.maps.recording import MapsFrame, MapsWriter
from planview.pipeline.engine import Engine, FrameResult


class MapsLog:
    """Writes the foreground points of every frame (see ``planview.maps.recording``).

    Args:
        engine: whose frames will come.
        path: the file to write.
    Raises:
        InputError: an engine without disparity.
        WorkError: the file cannot be written.
    """

    def __init__(self, engine: Engine, path: Path) -> None:
        if engine.stereo is None:
            raise InputError("--save-maps: expected a stereo pair or images with depth, found a single camera")
        self._engine, self._step = engine, engine.stereo.reduction
        self._writer = MapsWriter(path, engine.stereo, engine.config.model_dump_json(), engine.recording.fps)

    def frame(self, result: FrameResult) -> None:
        """Add a frame.

        Raises:
            WorkError: the disk is full.
        """
        maps, disparity = result.observation.maps, result.disparity
        if maps is None or disparity is None:
            raise InputError("--save-maps: expected a recording with images, found recorded maps")
        reduced = np.ascontiguousarray(disparity[:: self._step, :: self._step])
        self._writer.add(MapsFrame.of(result.frame, result.timestamp_s, maps.points, reduced))

    def close(self) -> None:
        """Write what is left."""
        self._writer.close(self._engine.recording.skipped)
