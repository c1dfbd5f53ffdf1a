import numpy as np
import pytest

from stereo.depth import DepthFromDisparity, DepthParams, RectifiedGeometry, back_project, median_image

GEOMETRY = RectifiedGeometry(4, 3, 400.0, 400.0, 1.5, 1.0, 0.1, disparity_std_px=0.25)


def test_depth_is_focal_times_baseline_over_disparity() -> None:
    depth = DepthFromDisparity(GEOMETRY)(np.full((3, 4), 20.0, np.float32))
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, 2.0)


def test_depth_is_nan_without_disparity_and_beyond_the_maximum() -> None:
    disparity = np.array([[np.nan, 0.0, -1.0, 3.9, 4.1]], np.float32)
    depth = DepthFromDisparity(GEOMETRY, DepthParams(depth_max_m=10.0))(disparity)
    assert np.isnan(depth[0, :4]).all()
    assert depth[0, 4] == pytest.approx(40 / 4.1)


def test_depth_deviation_grows_with_the_square_of_the_depth() -> None:
    # d z = z^2 / (f b) d d: 4 / 40 * 0.25 and 16 / 40 * 0.25.
    np.testing.assert_allclose(GEOMETRY.depth_std_m(np.array([2.0, 4.0], np.float32)), [0.025, 0.1], rtol=1e-6)
    assert GEOMETRY.depth_std_m(2.0) == pytest.approx(0.025)


def test_disparity_at_inverts_depth() -> None:
    assert GEOMETRY.disparity_at(2.0) == pytest.approx(20.0)


def test_back_projection_puts_the_principal_point_on_the_axis() -> None:
    depth = np.full((3, 4), 2.0, np.float32)
    depth[0, 0] = np.nan
    points = back_project(depth, GEOMETRY)
    assert np.isnan(points[0, 0]).all()
    np.testing.assert_allclose(points[1, 2], [0.5 * 2 / 400, 0.0, 2.0], atol=1e-7)
    np.testing.assert_allclose(points[2, 3], [1.5 * 2 / 400, 1.0 * 2 / 400, 2.0], atol=1e-7)


def test_ray_through_a_pixel_is_at_unit_depth() -> None:
    # 40 px right of and 20 px below the principal point (1.5, 1) at a focal length of 400 px.
    np.testing.assert_allclose(GEOMETRY.rays([[41.5, 21.0]]), [[0.1, 0.05, 1.0]])


def test_projection_inverts_rays_at_any_depth() -> None:
    pixels = np.array([[[0.0, 0.0], [3.0, 2.0]]])
    np.testing.assert_allclose(GEOMETRY.project(2.5 * GEOMETRY.rays(pixels)), pixels)


def test_point_behind_the_camera_has_no_pixel() -> None:
    assert np.isnan(GEOMETRY.project([0.0, 0.0, -1.0])).all()


def test_median_image_leaves_out_who_walks_through_and_what_is_never_valid() -> None:
    frames = [np.array([[4.0, np.nan]], np.float32), np.array([[1.0, np.nan]], np.float32)]
    frames.append(np.array([[4.0, np.nan]], np.float32))
    np.testing.assert_array_equal(median_image(frames), [[4.0, np.nan]])
