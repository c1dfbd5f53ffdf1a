"""A naive engine to compare with: what a user of OpenCV would write in an afternoon.

MOG2 in colour, the foreground's points summed over floor cells, connected blobs of cells as people, the Hungarian
method, a constant-velocity Kalman filter. It is given what such a user may buy or calibrate: rectification, disparity
and floor are those of the engine itself.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.io import write_whole
from planview.engine.engine import Engine, FrameResult
from planview.maps.builder import MapBuilder, PlanViewMaps
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState
from planview.trajectories.table import TrajectoryCollector, write_table

FOREGROUND = 255
"""MOG2's mark of foreground; it marks shadows with 127."""
OPENED = np.ones((3, 3), np.uint8)
"""Foreground narrower than this [px] is noise."""
POSITION_STD_M, ACCELERATION_STD_MPS2, SPEED_STD_MPS = 0.1, 2.0, 1.0
"""Deviations of the Kalman filter: position of a blob, random acceleration, velocity of a newcomer."""
CONFIRM_FRAMES = 5
"""A newcomer is confirmed after so many consecutive frames."""


class Blob(NamedTuple):
    """Connected occupied cells: centre of mass and height of their points [m]."""

    x_m: float
    y_m: float
    height_m: float


def blobs(maps: PlanViewMaps) -> list[Blob]:
    """People of one frame: connected cells with enough surface that are tall enough."""
    # A floor cell belongs to a blob from this visible surface per floor area on [m^2/m^2].
    n, labels = cv2.connectedComponents((maps.occupancy > 0.5 * maps.grid.cell_m**2).astype(np.uint8))
    xyz, area = maps.points.xyz, maps.points.area
    rows = ((xyz[:, 1] - maps.grid.y_min_m) / maps.grid.cell_m).astype(int).clip(0, maps.grid.n_rows - 1)
    cols = ((xyz[:, 0] - maps.grid.x_min_m) / maps.grid.cell_m).astype(int).clip(0, maps.grid.n_cols - 1)
    label, found = labels[rows, cols], []
    for i in range(1, n):
        mine = label == i
        # Smallest visible surface of a person [m^2]: head and shoulders.
        if area[mine].sum() < 0.15:
            continue
        x, y = np.average(xyz[mine, :2], axis=0, weights=area[mine])
        # Percentile of the heights of a blob that is the person's height: single points above are noise.
        height = float(np.percentile(xyz[mine, 2], 98.0))
        # Lowest top of a person [m]; lower things are chairs and bags.
        if height >= 1.0:
            found.append(Blob(float(x), float(y), height))
    return found


@dataclass
class _BlobPerson:
    track_id: int
    kalman: FloorKalman
    height_m: float
    frames: int = 1
    since_s: float = 0.0

    def state(self, now_s: float) -> TrackState:
        confirmed = self.frames >= CONFIRM_FRAMES
        state = "tentative" if not confirmed else "confirmed" if now_s == self.since_s else "lost"
        k = self.kalman
        return TrackState(self.track_id, state, k.x_m, k.y_m, k.vx_mps, k.vy_mps, self.height_m)  # type: ignore[arg-type]


@dataclass
class BlobTracker:
    """Blobs to people: the Hungarian method on distances, one Kalman filter each."""

    decisions: tuple[Decision, ...] = ()
    _people: list[_BlobPerson] = field(default_factory=list)
    _last_s: float = 0.0
    _next_id: int = 1

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame from its maps."""
        now_s, found = observation.timestamp_s, blobs(observation.maps) if observation.maps else []
        for p in self._people:
            p.kalman = p.kalman.predicted(now_s - self._last_s, ACCELERATION_STD_MPS2)
        self._last_s = now_s
        at = np.array([(p.kalman.x_m, p.kalman.y_m) for p in self._people]).reshape(-1, 1, 2)
        cost = np.linalg.norm(at - np.array([b[:2] for b in found]).reshape(1, -1, 2), axis=2)
        # Farthest a person is from the prediction [m].
        pairs = [(i, j) for i, j in zip(*linear_sum_assignment(cost), strict=True) if cost[i, j] < 0.7]
        for i, j in pairs:
            person, blob = self._people[i], found[j]
            person.kalman = person.kalman.updated(blob.x_m, blob.y_m, POSITION_STD_M)
            person.height_m += 0.1 * (blob.height_m - person.height_m)
            person.frames, person.since_s = person.frames + 1, now_s
        # Newcomers without a blob are forgotten at once, others after a while.
        # A person without a blob for this long is gone [s].
        self._people = [
            p for p in self._people if p.since_s == now_s or (p.frames >= CONFIRM_FRAMES and now_s - p.since_s <= 1.0)
        ]
        for j in set(range(len(found))) - {j for _, j in pairs}:
            kalman = FloorKalman.at(found[j].x_m, found[j].y_m, POSITION_STD_M, SPEED_STD_MPS)
            self._people.append(_BlobPerson(self._next_id, kalman, found[j].height_m, since_s=now_s))
            self._next_id += 1
        return tuple(p.state(now_s) for p in self._people)

    def debug(self) -> TrackerDebug:
        """Nothing to show."""
        return TrackerDebug()

    def reset(self) -> None:
        """Forget all people."""
        self._people, self._last_s, self._next_id = [], 0.0, 1


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
        self._tracker, self._tracks = BlobTracker(), TrajectoryCollector()

    def frame(self, result: FrameResult) -> None:
        """Track a frame."""
        image, disparity = result.observation.image, result.disparity
        if image is None or disparity is None:
            raise ValueError("expected frames with image and disparity")
        mask = np.where(np.asarray(self._mog2.apply(image)) == FOREGROUND, FOREGROUND, 0).astype(np.uint8)
        mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, OPENED), dtype=np.uint8)
        maps = self._maps(np.ascontiguousarray(disparity[:: self._step, :: self._step]), mask)
        tracks = self._tracker.update(Observation(result.frame, result.timestamp_s, maps=maps))
        self._tracks.add(result.frame, result.timestamp_s, tracks)

    def mark(self) -> dict[str, int]:
        """See ``RunLog``; a benchmark is not resumed."""
        return {}

    def close(self) -> None:
        """Write the tracks."""
        text = io.StringIO()
        write_table(text, self._tracks.trajectories())
        write_whole(self._path, text.getvalue())
