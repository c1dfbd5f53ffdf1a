"""The naive engine: blobs of occupied cells, and who they are over time."""

import numpy as np
import pytest

from benchmarks.peer import BlobTracker, blobs
from planview.maps.builder import CameraViewpoint, FloorPoints, PlanViewMaps
from planview.maps.grid import Grid
from planview.tracking.base import Observation


def maps_of(*people):
    """People at (x, y), 1.7 m tall, each of 36 points on 6x6 cells of 0.1 m."""
    grid = Grid.covering(0.0, 0.0, 4.0, 4.0, 0.1)
    steps = 0.1 * (np.arange(6) - 2.5)
    around = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    xy = np.concatenate([np.empty((0, 2)), *(np.array(p) + around for p in people)])
    xyz = np.column_stack([xy, np.full(len(xy), 1.7)]).astype(np.float32)
    occupancy = np.zeros(grid.shape, np.float32)
    occupancy[(xy[:, 1] / 0.1).astype(int), (xy[:, 0] / 0.1).astype(int)] = 0.01
    n = len(xy)
    points = FloorPoints(xyz, np.full(n, 0.01, np.float32), np.arange(n, dtype=np.int32))
    view = CameraViewpoint(np.array([0.0, 0.0, 2.0]), 0.01, np.eye(3, 4), (160, 120))
    return PlanViewMaps(grid, occupancy, occupancy, occupancy, occupancy, 0.0, points, view)


def walked(tracker, ways, n=8):
    """Tracks after n frames of 0.1 s over straight ways (x, y, vx, vy)."""
    for i in range(n):
        at = [(x + 0.1 * i * vx, y + 0.1 * i * vy) for x, y, vx, vy in ways]
        tracks = tracker.update(Observation(i, 0.1 * i, maps=maps_of(*at)))
    return tracks


def test_blob_is_where_its_points_are_and_as_tall():
    (blob,) = blobs(maps_of((1.6, 2.0)))
    assert blob == pytest.approx((1.6, 2.0, 1.7), abs=1e-3)


def test_people_who_touch_are_one_blob():
    assert len(blobs(maps_of((1.6, 2.0), (2.2, 2.0)))) == 1
    assert len(blobs(maps_of((1.6, 2.0), (2.5, 2.0)))) == 2


def test_walkers_keep_their_ids_and_are_confirmed_after_five_frames():
    tracker = BlobTracker()
    early = walked(tracker, [(1.0, 1.0, 1.0, 0.0), (3.0, 3.0, -1.0, 0.0)], n=4)
    assert {t.state for t in early} == {"tentative"}
    tracker.reset()
    late = walked(tracker, [(1.0, 1.0, 1.0, 0.0), (3.0, 3.0, -1.0, 0.0)])
    assert [(t.track_id, t.state) for t in late] == [(1, "confirmed"), (2, "confirmed")]
    assert late[0].x_m == pytest.approx(1.7, abs=0.05)


def test_person_without_a_blob_is_lost_and_gone_after_a_second():
    tracker = BlobTracker()
    walked(tracker, [(1.0, 1.0, 0.0, 0.0)])
    (lost,) = tracker.update(Observation(8, 0.8, maps=maps_of()))
    assert lost.state == "lost"
    assert tracker.update(Observation(20, 2.0, maps=maps_of())) == ()
