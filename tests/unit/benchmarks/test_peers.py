"""The naive engines that trackers are compared with."""

import numpy as np
import pytest

from benchmarks.peaks import PeakTracker, peaks
from benchmarks.peer import BlobTracker, blobs
from planview.maps.builder import CameraViewpoint, FloorPoints, MapParams, PlanViewMaps, Raster
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


def walked(tracker, ways, maps, n=8):
    """Tracks after n frames of 0.1 s over straight ways (x, y, vx, vy)."""
    for i in range(n):
        at = [(x + 0.1 * i * vx, y + 0.1 * i * vy) for x, y, vx, vy in ways]
        tracks = tracker.update(Observation(i, 0.1 * i, maps=maps(*at)))
    return tracks


def test_blob_is_where_its_points_are_and_people_who_touch_are_one():
    (blob,) = blobs(maps_of((1.6, 2.0)))
    assert blob == pytest.approx((1.6, 2.0, 1.7), abs=1e-3)
    assert len(blobs(maps_of((1.6, 2.0), (2.2, 2.0)))) == 1
    assert len(blobs(maps_of((1.6, 2.0), (2.5, 2.0)))) == 2


def maps_from(*people: tuple[float, float]) -> PlanViewMaps:
    """People at (x, y) straight below or beside a camera, 1.7 m tall: discs of 0.15 m that are sampled each 2 cm."""
    grid = Grid.covering(0.0, 0.0, 4.0, 4.0, 0.04)
    steps = 0.02 * np.arange(-7, 8)
    disc = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) < 0.15]
    xy = np.concatenate([np.empty((0, 2)), *(np.array(p) + disc for p in people)])
    xyz = np.column_stack([xy, np.full(len(xy), 1.7)]).astype(np.float32)
    points = FloorPoints(xyz, np.full(len(xyz), 0.001, np.float32), np.arange(len(xyz), dtype=np.int32))
    # A camera at 4 m above (2, 2), which looks straight down.
    projection = np.array([[100.0, 0, -50, 0], [0, -100, -50, 400], [0, 0, -1, 4]])
    view = CameraViewpoint(np.array([2.0, 2.0, 4.0]), 0.001, projection, (10_000, 10_000))
    return Raster(grid, MapParams()).maps(points, view)


def test_peak_is_the_head_of_a_person_also_shoulder_to_shoulder():
    (peak,) = peaks(maps_from((2.0, 2.0)))
    assert peak == pytest.approx((2.0, 2.0, 1.7), abs=0.1)
    (beside,) = peaks(maps_from((3.5, 2.0)))
    assert 3.5 < beside.x_m < 3.5 + 0.08
    assert len(peaks(maps_from((1.7, 2.0), (2.2, 2.0)))) == 2


ENGINES = [(BlobTracker, maps_of, 4, 1.2), (PeakTracker, maps_from, 2, 4.2)]
"""Naive engines: tracker, its maps, frames in which people are tentative, and when somebody is gone [s]."""


@pytest.mark.parametrize(("engine", "maps", "early", "gone_s"), ENGINES)
def test_walkers_keep_their_ids_and_are_confirmed_after_some_frames(engine, maps, early, gone_s):
    tracker, ways = engine(), [(1.0, 1.0, 1.0, 0.0), (3.0, 3.0, -1.0, 0.0)]
    assert {t.state for t in walked(tracker, ways, maps, early)} == {"tentative"}
    tracker.reset()
    late = walked(tracker, ways, maps)
    assert [(t.track_id, t.state) for t in late] == [(1, "confirmed"), (2, "confirmed")]
    assert late[0].x_m == pytest.approx(1.7, abs=0.05 if engine is BlobTracker else 0.1)


@pytest.mark.parametrize(("engine", "maps", "early", "gone_s"), ENGINES)
def test_person_who_is_not_seen_is_lost_and_gone_later(engine, maps, early, gone_s):
    tracker = engine()
    walked(tracker, [(2.0, 2.0, 0.0, 0.0)], maps)
    (lost,) = tracker.update(Observation(8, 0.8, maps=maps()))
    assert lost.state == "lost" and tracker.update(Observation(50, 0.8 + gone_s, maps=maps())) == ()
