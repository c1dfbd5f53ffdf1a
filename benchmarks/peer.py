"""A naive engine to compare with: what a user of OpenCV would write in an afternoon.

MOG2 in colour, the foreground's points summed over floor cells, and ``PeakTracker`` on these maps. It is given what
such a user may buy or calibrate: rectification, disparity and floor are those of the engine itself.
"""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np

from benchmarks.peaks import PeakTracker
from calib.io import write_whole
from planview.engine.engine import Engine, FrameResult
from planview.maps.builder import MapBuilder
from planview.tracking.base import Observation
from planview.trajectories.table import TrajectoryCollector, write_table

FOREGROUND = 255
"""MOG2's mark of foreground; it marks shadows with 127."""
OPENED = np.ones((3, 3), np.uint8)
"""Foreground narrower than this [px] is noise."""


class PeerLog:
    """The naive engine over the frames of a run of the engine: nothing is read or matched again.

    Args:
        engine: of a stereo pair, whose frames will come.
        path: ``tracks.csv`` of the naive engine, to be written.
    """

    def __init__(self, engine: Engine, path: Path) -> None:
        view = engine.stereo
        if view is None:
            raise ValueError("expected an engine of a stereo pair")
        self._path, self._step = path, view.reduction
        self._maps = MapBuilder(view.geometry, view.floor.world_SE3_left, engine.config.maps, view.reduction)
        # Frames of MOG2's memory. OpenCV's default of 500 takes a person who stands for 4 s for background.
        self._mog2 = cv2.createBackgroundSubtractorMOG2(history=5000, detectShadows=True)
        self._tracker, self._tracks = PeakTracker(), TrajectoryCollector()

    def frame(self, result: FrameResult) -> None:
        """Track a frame."""
        image, disparity = result.observation.image, result.disparity
        if image is None or disparity is None:
            raise ValueError("expected frames with image and disparity")
        mask = np.where(np.asarray(self._mog2.apply(image)) == FOREGROUND, FOREGROUND, 0).astype(np.uint8)
        mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, OPENED), dtype=np.uint8)
        maps = self._maps(np.ascontiguousarray(disparity[:: self._step, :: self._step]), mask)
        tracks = self._tracker.update(
            Observation(result.frame, result.timestamp_s, views=result.observation.views, build_maps=lambda: maps)
        )
        self._tracks.add(result.frame, result.timestamp_s, tracks)

    def mark(self) -> dict[str, int]:
        """See ``RunLog``; a benchmark is not resumed."""
        return {}

    def close(self) -> None:
        """Write the tracks."""
        text = io.StringIO()
        write_table(text, self._tracks.trajectories())
        write_whole(self._path, text.getvalue())
