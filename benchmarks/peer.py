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
from calib.types import U8
from planview.engine.config import Config, ungated
from planview.engine.engine import FrameResult, StageClock
from planview.engine.frames import MatchedFrame, Separated
from planview.engine.pipeline import Pipeline
from planview.engine.setup import AnySetup, set_up_any
from planview.foreground.masks import FOREGROUND
from planview.maps.builder import PlanViewMaps
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState
from planview.trajectories.table import TrajectoryCollector, write_table
from stereo.readers import open_any
from stereo.recording import Recording, RgbdRecording
from stereo.sampled_sgm import SampledDisparity

HISTORY = 5000
"""Frames of MOG2's memory. OpenCV's default of 500 takes a person who stands for 4 s for background."""
OPENED = np.ones((3, 3), np.uint8)
"""Foreground narrower than this [px] is noise."""
OCCUPIED = 0.5
"""A floor cell belongs to a blob from this visible surface per floor area on [m^2/m^2]."""
BLOB_M2 = 0.15
"""Smallest visible surface of a person [m^2]: head and shoulders."""
TALL_M = 1.0
"""Lowest top of a person [m]; lower things are chairs and bags."""
TOP_PERCENT = 98.0
"""Percentile of the heights of a blob that is the person's height: single points above are noise."""
GATE_M = 0.7
"""Farthest a person is from the prediction [m]."""
POSITION_STD_M, ACCELERATION_STD_MPS2, SPEED_STD_MPS = 0.1, 2.0, 1.0
"""Deviations of the Kalman filter: position of a blob, random acceleration, velocity of a newcomer."""
CONFIRM_FRAMES = 5
"""A newcomer is confirmed after so many consecutive frames."""
DROP_S = 1.0
"""A person without a blob for this long is gone [s]."""


class Blob(NamedTuple):
    """Connected occupied cells: centre of mass and height of their points [m]."""

    x_m: float
    y_m: float
    height_m: float


@dataclass
class _Person:
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


def blobs(maps: PlanViewMaps) -> list[Blob]:
    """People of one frame: connected cells with enough surface that are tall enough."""
    n, labels = cv2.connectedComponents((maps.occupancy > OCCUPIED * maps.grid.cell_m**2).astype(np.uint8))
    xyz, area = maps.points.xyz, maps.points.area
    rows = ((xyz[:, 1] - maps.grid.y_min_m) / maps.grid.cell_m).astype(int).clip(0, maps.grid.n_rows - 1)
    cols = ((xyz[:, 0] - maps.grid.x_min_m) / maps.grid.cell_m).astype(int).clip(0, maps.grid.n_cols - 1)
    label, found = labels[rows, cols], []
    for i in range(1, n):
        mine = label == i
        if area[mine].sum() < BLOB_M2:
            continue
        x, y = np.average(xyz[mine, :2], axis=0, weights=area[mine])
        height = float(np.percentile(xyz[mine, 2], TOP_PERCENT))
        if height >= TALL_M:
            found.append(Blob(float(x), float(y), height))
    return found


@dataclass
class BlobTracker:
    """Blobs to people: the Hungarian method on distances, one Kalman filter each."""

    decisions: tuple[Decision, ...] = ()
    _people: list[_Person] = field(default_factory=list)
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
        pairs = [(i, j) for i, j in zip(*linear_sum_assignment(cost), strict=True) if cost[i, j] < GATE_M]
        for i, j in pairs:
            person, blob = self._people[i], found[j]
            person.kalman = person.kalman.updated(blob.x_m, blob.y_m, POSITION_STD_M)
            person.height_m += 0.1 * (blob.height_m - person.height_m)
            person.frames, person.since_s = person.frames + 1, now_s
        self._drop(now_s)
        for j in set(range(len(found))) - {j for _, j in pairs}:
            kalman = FloorKalman.at(found[j].x_m, found[j].y_m, POSITION_STD_M, SPEED_STD_MPS)
            self._people.append(_Person(self._next_id, kalman, found[j].height_m, since_s=now_s))
            self._next_id += 1
        return tuple(p.state(now_s) for p in self._people)

    def _drop(self, now_s: float) -> None:
        """Forget people without a blob: newcomers at once, others after a while."""
        for p in list(self._people):
            if now_s > p.since_s and (p.frames < CONFIRM_FRAMES or now_s - p.since_s > DROP_S):
                self._people.remove(p)

    def debug(self) -> TrackerDebug:
        """Nothing to show."""
        return TrackerDebug()

    def reset(self) -> None:
        """Forget all people."""
        self._people, self._last_s, self._next_id = [], 0.0, 1


class Peer(Pipeline):
    """The naive engine: the engine's rectification, disparity and floor, and all of its own after these."""

    def __init__(self, recording: Recording | RgbdRecording, setup: AnySetup, config: Config) -> None:
        super().__init__(recording, setup, ungated(config), BlobTracker())

    @staticmethod
    def open(path: Path, config: Config) -> Peer:
        """Open a recording (errors as of ``Pipeline.from_recording``)."""
        recording = open_any(path)
        return Peer(recording, set_up_any(recording, config), config)

    def reset(self) -> None:
        """Forget people and background."""
        super().reset()
        self._mog2 = cv2.createBackgroundSubtractorMOG2(history=HISTORY, detectShadows=True)

    def separate(self, matched: MatchedFrame, clock: StageClock) -> Separated:
        """See ``Pipeline``: MOG2, which marks shadows with 127."""
        step = self.stereo.reduction
        image = matched.image
        marked = np.asarray(self._mog2.apply(image))
        mask: U8 = np.where(marked == FOREGROUND, marked, 0).astype(np.uint8)
        mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, OPENED), dtype=np.uint8)
        clock.record("foreground")
        assert matched.disparity is not None
        points = self.maps.points(np.ascontiguousarray(matched.disparity[::step, ::step]), mask)
        return Separated(image, mask, points, SampledDisparity(matched.disparity))


class PeerLog:
    """The naive engine over the frames of a run of the engine: nothing is read or matched again.

    Args:
        engine: whose frames will come.
        path: ``tracks.csv`` of the naive engine, to be written.
    """

    def __init__(self, engine: Pipeline, path: Path) -> None:
        self._peer, self._path, self._tracks = (
            Peer(engine.recording, engine.setup, engine.config),
            path,
            TrajectoryCollector(),
        )
        self._peer.reset()

    def frame(self, result: FrameResult) -> None:
        """Track a frame."""
        image, disparity = result.observation.image, result.disparity
        if image is None or disparity is None:
            raise ValueError("expected frames with image and disparity")
        matched = MatchedFrame(result.frame, result.timestamp_s, image, disparity, {})
        self._tracks.add(result.frame, result.timestamp_s, self._peer.track(matched).tracks)

    def mark(self) -> dict[str, int]:
        """See ``RunLog``; a bench is not resumed."""
        return {}

    def finish(self) -> None:
        """See ``RunLog``."""

    def close(self) -> None:
        """Write the tracks."""
        text = io.StringIO()
        write_table(text, self._tracks.trajectories())
        write_whole(self._path, text.getvalue())
