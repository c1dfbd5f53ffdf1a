import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.pose import SE3
from calib.rig import world_from_plane
from planview.maps import _kernels as kernels
from planview.maps.builder import MapBuilder, MapParams
from planview.maps.grid import Grid
from stereo.depth import RectifiedGeometry
from tests.reference import maps as reference

GEOMETRY = RectifiedGeometry(64, 48, 50.0, 50.0, 31.5, 23.5, 0.1)
OVERHEAD = world_from_plane(np.array([0.0, 0.0, -1.0]), 3.0)


def builder(**params: float | bool) -> MapBuilder:
    return MapBuilder(
        GEOMETRY, OVERHEAD, MapParams.model_validate({"smoothing_m": 0.0, "occupancy_min": 0.0, **params})
    )


def flat(depth_m: float) -> np.ndarray:
    return np.full((48, 64), GEOMETRY.disparity_at(depth_m), dtype=np.float32)


def test_height_map_of_a_table_below_an_overhead_camera_is_its_height() -> None:
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[20:28, 28:36] = 255
    maps = builder()(flat(2.0), mask)
    assert maps.height_raw.max() == pytest.approx(1.0, abs=1e-5)


def test_occupancy_of_a_surface_is_its_area_at_any_distance() -> None:
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[10:30, 20:40] = 255
    for depth in (1.0, 2.0):
        # 20 x 20 pixels, each depth / 50 wide.
        assert builder()(flat(depth), mask).occupancy_raw.sum() == pytest.approx((20 * depth / 50) ** 2, rel=1e-4)


def test_maps_skip_pixels_without_depth_and_background() -> None:
    disparity = flat(2.0)
    disparity[:, :32] = np.nan
    mask = np.full((48, 64), 255, dtype=np.uint8)
    mask[24:] = 0
    assert len(builder()(disparity, mask).points.xyz) == 24 * 32


def test_maps_leave_out_what_is_above_h_max_or_on_the_ground() -> None:
    mask = np.full((48, 64), 255, dtype=np.uint8)
    assert builder()(flat(0.4), mask).height_raw.max() == 0.0
    assert builder()(flat(2.95), mask).height_raw.max() == 0.0


def test_height_is_masked_where_occupancy_is_low() -> None:
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[20, 30] = 255
    lone = builder(smoothing_m=0.04, occupancy_min=2.0)(flat(2.0), mask)
    assert lone.height_raw.max() > 0.9
    assert lone.height.max() == 0.0


def test_reduced_maps_show_the_same_area() -> None:
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[10:30, 20:40] = 255
    half = MapBuilder(GEOMETRY, OVERHEAD, MapParams(smoothing_m=0.0, occupancy_min=0.0), reduction=2)
    maps = half(flat(2.0)[::2, ::2], mask[::2, ::2])
    assert maps.occupancy_raw.sum() == pytest.approx((20 * 2.0 / 50) ** 2, rel=1e-4)


def test_map_builder_refuses_images_of_another_size() -> None:
    with pytest.raises(ValueError, match="expected disparity and mask"):
        builder()(flat(2.0)[:-1], np.zeros((47, 64), dtype=np.uint8))


def test_grid_cell_owns_its_lower_edge() -> None:
    grid = Grid.covering(0.0, 0.0, 1.0, 0.5, 0.1)
    assert grid.shape == (5, 10)
    assert grid.centre_of(0, 0) == pytest.approx((0.05, 0.05))
    assert grid.index_of(0.05, 0.05) == pytest.approx((0.0, 0.0))
    height, occupancy = np.empty(grid.shape, np.float32), np.empty(grid.shape, np.float32)
    point = np.array([[0.5, 0.25, 1.0]], np.float32)
    kernels.accumulate(point, np.ones(1, np.float32), 0.0, 0.0, 0.0, 0.25, height, occupancy)
    assert height[1, 2] == 1.0


def test_grid_refuses_a_hall_too_large() -> None:
    with pytest.raises(ValueError, match="at most"):
        Grid.covering(0.0, 0.0, 1000.0, 1000.0, 0.03)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_map_kernels_equal_their_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    disparity = rng.uniform(-1, 30, (12, 16)).astype(np.float32)
    disparity[rng.random((12, 16)) < 0.2] = np.nan
    mask = (rng.random((12, 16)) < 0.7).astype(np.uint8)
    pose = SE3.from_rotvec(rng.normal(size=3), rng.normal(size=3)).matrix[:3]
    intrinsics = np.array([20.0, 22.0, 7.5, 5.5])
    results = []
    for module in (kernels, reference):
        points, area = np.zeros((192, 3), np.float32), np.zeros(192, np.float32)
        pixels = np.zeros(192, np.int32)
        n = module.back_project(disparity, mask, 0.5, 10.0, intrinsics, pose, 2.4, points, area, pixels)
        height, occupancy = np.empty((9, 11), np.float32), np.empty((9, 11), np.float32)
        module.accumulate(points[:n], area[:n], 0.15, -1.0, -2.0, 0.5, height, occupancy)
        results.append((n, points, area, pixels, height, occupancy))
    for ours, theirs in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6)
