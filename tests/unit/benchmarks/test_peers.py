"""The naive tracker that others are compared with."""

import numpy as np
import pytest

from benchmarks.peaks import PeakTracker, peaks
from planview.maps.builder import FloorPoints, MapParams, PlanViewMaps, Raster
from planview.maps.grid import Grid
from planview.tracking.base import Observation


def observed(frame: int, timestamp_s: float, *people: tuple[float, float]) -> Observation:
    return Observation(frame, timestamp_s, build_maps=lambda: maps_from(*people))


def walked(tracker, ways, n=8):
    """Tracks after n frames of 0.1 s over straight ways (x, y, vx, vy)."""
    for i in range(n):
        at = [(x + 0.1 * i * vx, y + 0.1 * i * vy) for x, y, vx, vy in ways]
        tracks = tracker.update(observed(i, 0.1 * i, *at))
    return tracks


def maps_from(*people: tuple[float, float]) -> PlanViewMaps:
    """People at (x, y) straight below or next to a camera, 1.7 m tall: discs of 0.15 m that are sampled each 2 cm."""
    grid = Grid.covering(0.0, 0.0, 4.0, 4.0, 0.04)
    steps = 0.02 * np.arange(-7, 8)
    disc = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) < 0.15]
    xy = np.concatenate([np.empty((0, 2)), *(np.array(p) + disc for p in people)])
    xyz = np.column_stack([xy, np.full(len(xy), 1.7)]).astype(np.float32)
    points = FloorPoints(xyz, np.full(len(xyz), 0.001, np.float32), np.arange(len(xyz), dtype=np.int32))
    return Raster(grid, MapParams()).maps(points)


def test_peak_is_the_head_of_a_person_also_shoulder_to_shoulder():
    (peak,) = peaks(maps_from((2.0, 2.0)))
    assert peak == pytest.approx((2.0, 2.0, 1.7), abs=0.1)
    assert len(peaks(maps_from((1.7, 2.0), (2.2, 2.0)))) == 2


def test_walkers_keep_their_ids_and_are_confirmed_after_some_frames():
    tracker, ways = PeakTracker(), [(1.0, 1.0, 1.0, 0.0), (3.0, 3.0, -1.0, 0.0)]
    assert {t.state for t in walked(tracker, ways, 2)} == {"tentative"}
    tracker.reset()
    late = walked(tracker, ways)
    assert [(t.track_id, t.state) for t in late] == [(1, "confirmed"), (2, "confirmed")]
    assert late[0].x_m == pytest.approx(1.7, abs=0.1)


def test_person_who_is_not_seen_is_lost_and_gone_later():
    tracker = PeakTracker()
    walked(tracker, [(2.0, 2.0, 0.0, 0.0)])
    (lost,) = tracker.update(observed(8, 0.8))
    assert lost.state == "lost" and tracker.update(observed(50, 5.0)) == ()
