import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.types import F64
from planview.maps.builder import CameraViewpoint, FloorPoints
from planview.tracking import _axis_kernels
from planview.tracking.body_axis import BodyAxis
from tests.reference import axis as reference


def _camera_at(place_m: F64) -> CameraViewpoint:
    return CameraViewpoint(place_m, 0.01, np.eye(3, 4), (160, 120))


def test_axis_lies_behind_the_visible_half_of_a_head() -> None:
    """A sphere of radius 0.095 m at 3 m, seen horizontally: its visible half is centred 6.3 cm too near."""
    rng = np.random.default_rng(0)
    radius, centre, camera = 0.095, np.array([0.0, 3.0, 1.6]), np.array([0.0, 0.0, 1.6])
    offset = rng.uniform(-radius, radius, (20000, 2))
    offset = offset[(offset**2).sum(axis=1) < radius**2]
    near = np.sqrt(radius**2 - (offset**2).sum(axis=1))
    xyz = (centre + np.column_stack([offset[:, 0], -near, offset[:, 1]])).astype(np.float32)
    area = np.full(len(xyz), np.pi * radius**2 / len(xyz), np.float32)
    points = FloorPoints(xyz, area, np.arange(len(xyz), dtype=np.int32))
    (measured,) = BodyAxis(_camera_at(camera), 2.4)(points, np.array([[0.0, 2.95]]), 0.5)
    assert measured.from_head
    assert (measured.x_m, measured.y_m) == pytest.approx((0.0, 3.0), abs=0.005)
    assert measured.height_m == pytest.approx(1.695, abs=0.015)


def test_axis_of_nobody_seen_is_unknown() -> None:
    nothing = FloorPoints(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int32))
    (measured,) = BodyAxis(_camera_at(np.array([0.0, 0.0, 2.5])), 2.4)(nothing, np.array([[0.0, 1.0]]), 0.5)
    assert np.isnan(measured.x_m) and np.isnan(measured.height_m)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_axis_kernels_equal_their_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-1, -1, -0.2), (1, 1, 2.5), (60, 3)).astype(np.float32)
    area = rng.uniform(0, 1, 60).astype(np.float32)
    people = rng.uniform(-1, 1, (3, 2))
    results = []
    for module in (_axis_kernels, reference):
        label, histogram, sums = np.empty(60, np.int32), np.empty((3, 50)), np.empty((3, 3))
        module.height_histograms(xyz, area, people, 0.6, 0.05, label, histogram)
        low, high = np.array([0.5, 0.0, 1.0]), np.array([2.0, 1.5, np.inf])
        module.slab_centroids(xyz, area, label, low, high, people, 0.4, sums)
        top, bodies, heads = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
        module.tops(histogram, np.array([0.01, 0.3, 9.0]), 0.05, 0.04, top)
        module.body_and_head(xyz, area, label, people, 0.6, low, 0.2, bodies, heads)
        results.append((label, histogram, sums, top, bodies, heads))
    for ours, theirs in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)
