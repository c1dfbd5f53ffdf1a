"""The joint tracker with several sensors."""

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from toy_people import look_at, oblique_camera, observed

from planview.maps.view import PixelRays, View
from planview.tracking import body
from planview.tracking.explain.births import _place_behind
from planview.tracking.explain.explanation import Explanation, upright_pose
from planview.tracking.joint import JointTracker
from planview.tracking.joint.ranges import JointParams, likelihood_of_ranges
from planview.trajectories.state import TrackState
from stereo.depth import RectifiedGeometry


def sensor(width_px: int, at_m: tuple[float, float] = (0.0, 0.0), turn_deg: float = 0.0) -> PixelRays:
    height_px, focal_px = width_px * 3 // 4, 0.8 * width_px
    cu_px, cv_px = (width_px - 1) / 2, (height_px - 1) / 2
    geometry = RectifiedGeometry(width_px, height_px, focal_px, focal_px, cu_px, cv_px, 0.12)
    return oblique_camera(at_m=at_m, turn_deg=turn_deg, geometry=geometry)


def walk(sensors: Sequence[PixelRays], seed: int, frames: int = 20) -> list[list[View]]:
    """What sensors see of three people who walk, from the third frame on; one sensor misses two frames."""
    rng = np.random.default_rng(seed)
    start, velocity = rng.uniform((-1.5, 2.0), (1.5, 5.0), (3, 2)), rng.uniform(-1.2, 1.2, (3, 2))
    facing, heights = np.arctan2(*velocity.T[::-1]), rng.uniform(1.5, 1.9, 3)
    scenes = []
    for n in range(frames):
        places = start + velocity * n / 10
        people = [(*place, h, way) for place, h, way in zip(places.tolist(), heights, facing, strict=True)]
        scenes.append([look_at(rays, people if n > 1 else [], (30, 160, 90)) for rays in sensors])
        if n in (8, 9):
            scenes[-1][1] = View.unknown(sensors[1].shape, rays=sensors[1])
    return scenes


def follow(scenes: Sequence[Sequence[View]], tracker: JointTracker | None = None) -> list[tuple[TrackState, ...]]:
    tracker = tracker or JointTracker()
    return [tracker.update(observed(n, n / 10, *views)) for n, views in enumerate(scenes)]


SEVERAL = sensor(80), sensor(120, (-2.0, 0.5), -40.0), sensor(160, (0.5, 6.5), 180.0)


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_tracks_do_not_depend_on_the_order_in_which_sensors_are_listed(seed):
    scenes = walk(SEVERAL, seed)
    first = follow(scenes)
    assert len({s.track_id for states in first for s in states if s.state == "confirmed"}) == 3
    for order in list(permutations(range(3)))[1:]:
        other = follow([[views[k] for k in order] for views in scenes])
        for ours, theirs in zip(first, other, strict=True):
            assert [(s.track_id, s.state) for s in ours] == [(s.track_id, s.state) for s in theirs]
            for a, b in zip(ours, theirs, strict=True):
                # Not to the bit: sums over pixels are taken sensor by sensor.
                assert (a.x_m, a.y_m, a.height_m) == pytest.approx((b.x_m, b.y_m, b.height_m), abs=1e-6)


def test_what_sensors_at_one_place_have_seen_is_kept_apart():
    tracker, sensors = JointTracker(), (sensor(120), sensor(80, turn_deg=30.0))
    follow([[look_at(rays, [(-0.4, 3.0, 1.75)]) for rays in sensors]] * 3, tracker)
    (person,) = tracker._people
    assert [seen.shape for seen in person.proof.spent.values()] == [rays.shape for rays in sensors]
    assert all(seen.any() for seen in person.proof.spent.values())
    assert all(tried.any() for tried in tracker._births._tried_m)


FACING = tuple(look_at(rays, []) for rays in (sensor(80), sensor(80, (0.0, 10.0), 180.0)))


@pytest.mark.parametrize(
    ("cameras", "behind"), [([0, 0], 0.5), ([1, 1], -0.5), ([0, 1], 0.0)], ids=["first", "second", "from both sides"]
)
def test_a_newcomer_stands_behind_its_surface_as_the_sensors_look_that_saw_it(cameras, behind):
    frame = Explanation(FACING, likelihood_of_ranges(JointParams()))
    points = np.array([[0.0, 4.0, 1.5, 2.0, 0.0]] * 2).T
    assert _place_behind(points, np.array(cameras), frame).tolist() == pytest.approx(
        [0.0, 4.0 + behind * body.TORSO.torso_radius_m]
    )


def test_people_are_explained_from_the_nearest_to_any_sensor_on():
    poses = np.array([upright_pose((0.0, y, 1.7)) for y in (4.0, 9.0)])
    for views in (FACING, FACING[::-1]):
        assert Explanation(views, likelihood_of_ranges(JointParams())).order_by_distance(poses).tolist() == [1, 0]


def test_arrays_that_do_not_fit_each_other_are_refused():
    tracker, seen = JointTracker(), look_at(sensor(80), [])
    with pytest.raises(ValueError, match="one size"):
        replace(seen, rays=sensor(120))
    with pytest.raises(ValueError, match="one size"):
        replace(seen, colour=np.zeros((59, 80), np.uint8))
    tracker.update(observed(0, 0.0, seen))
    for others in ([look_at(sensor(120), [])], [seen, seen]):
        with pytest.raises(ValueError, match="as in the frames before"):
            tracker.update(observed(1, 0.1, *others))


IN_BOUNDS = """
import numpy as np
from planview.tracking.explain.samples import map_lacking
from test_several_sensors import follow, sensor, walk

try:
    map_lacking(np.full((5, 1), 9.0, np.float32), np.zeros(2), 1.0, np.zeros((2, 2), np.float32))
except IndexError:
    assert follow(walk((sensor(80), sensor(120, turn_deg=30.0)), 0, 8))[-1]
else:
    raise SystemExit("bounds are not checked")
"""


@pytest.mark.slow
def test_kernels_stay_inside_their_arrays(tmp_path):
    here = Path(__file__).parent
    paths = os.pathsep.join(str(place) for place in (here, here.parents[3], here.parents[4]))
    checked = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": paths}
    found = subprocess.run(
        [sys.executable, "-c", IN_BOUNDS], env=os.environ | checked, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stderr
