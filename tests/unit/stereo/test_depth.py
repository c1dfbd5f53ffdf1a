"""From disparity to depth and points on the floor."""

import cv2
import numpy as np
import pytest

from calib.floor.plane import Plane
from stereo.depth import Depth, RectifiedGeometry, back_project, median_image
from stereo.floor import FOCAL_STD, SCALE_STD, align_plane, of_like_light, with_calibration_errors
from stereo.rig_correction import RigCorrection

GEOMETRY = RectifiedGeometry(4, 3, 400.0, 400.0, 1.5, 1.0, 0.1, disparity_std_px=0.25)


def test_depth_is_focal_times_baseline_over_disparity():
    depth = GEOMETRY.depth(np.array([[20.0, 4.1, np.nan, 0.0, -1.0, 3.9]], np.float32), max_m=10.0)
    np.testing.assert_allclose(depth, [[2.0, 40 / 4.1, *[np.nan] * 4]], rtol=1e-6)


def test_disparity_is_focal_times_baseline_over_depth():
    assert GEOMETRY.disparity_at(2.0) == pytest.approx(20.0)


def test_a_pair_without_a_baseline_is_refused():
    with pytest.raises(ValueError, match="baseline"):
        RectifiedGeometry(640, 480, 525.0, 525.0, 319.5, 239.5, 0.0)


def test_deviation_of_depth_grows_with_its_square():
    # d z = z^2 / (f b) d d: 4 / 40 * 0.25 and 16 / 40 * 0.25.
    np.testing.assert_allclose(GEOMETRY.depth_std_m(np.array([2.0, 4.0], np.float32)), [0.025, 0.1], rtol=1e-6)
    assert GEOMETRY.depth_std_m(2.0) == pytest.approx(0.025)


def test_back_projection_puts_the_principal_point_on_the_axis():
    depth = np.full((3, 4), 2.0, np.float32)
    depth[0, 0] = np.nan
    points = back_project(depth, GEOMETRY)
    assert np.isnan(points[0, 0]).all()
    np.testing.assert_allclose(points[1, 2], [0.5 * 2 / 400, 0.0, 2.0], atol=1e-7)
    np.testing.assert_allclose(points[2, 3], [1.5 * 2 / 400, 1.0 * 2 / 400, 2.0], atol=1e-7)


@pytest.mark.parametrize(("step", "first"), [(1, 0.0), (2, 0.5), (3, 1.0), (4, 1.5)])
def test_a_sample_stands_for_its_middle(step, first):
    u, v = np.meshgrid(np.arange(24.0), np.arange(12.0))
    samples = Depth.of_whole(np.zeros((12, 24), np.uint8), (20 + 0.1 * u + 0.05 * v).astype(np.float32), step)
    u, v = np.meshgrid(np.arange(first, 24, step), np.arange(first, 12, step))
    np.testing.assert_allclose(samples.disparity, 20 + 0.1 * u + 0.05 * v, rtol=1e-6)
    points = back_project(np.full(samples.disparity.shape, 2.0, np.float32), GEOMETRY, step)
    np.testing.assert_allclose(points[..., :2], 2.0 * np.stack([u - 1.5, v - 1.0], axis=-1) / 400, atol=1e-6)


N = np.nan


@pytest.mark.parametrize(
    ("pixels", "shown"),
    [
        ([[20, 10], [20, 10]], 20.0),
        ([[20, 10], [10.2, 10.1]], 10.1),
        ([[10, 20], [20.3, 19.7]], 20.0),
        ([[N, 10], [N, 20]], 20.0),
        ([[10, 10.2], [N, N]], 10.1),
        ([[N, N], [N, 10]], 10.0),
        ([[N, N], [N, N]], N),
    ],
)
def test_a_sample_on_an_edge_shows_one_surface(pixels, shown):
    disparity = np.array(pixels, np.float32)
    assert Depth.of_whole(np.zeros((2, 2), np.uint8), disparity, 2).disparity.tolist() == [
        [pytest.approx(shown, rel=1e-6, nan_ok=True)]
    ]


def test_samples_of_an_image_are_means_of_their_own_pixels_up_to_the_border():
    columns = np.tile(np.arange(0, 70, 10, dtype=np.uint8), (3, 1))
    samples = Depth.of_whole(columns, columns.astype(np.float32), 2)
    assert samples.image.tolist() == [[5, 25, 45, 60]] * 2
    assert samples.disparity[:, 3].tolist() == [60.0, 60.0]


def test_rays_through_pixels_are_at_unit_depth():
    # 40 px right of and 20 px below the principal point (1.5, 1) at a focal length of 400 px.
    np.testing.assert_allclose(GEOMETRY.rays([[41.5, 21.0]]), [[0.1, 0.05, 1.0]])


def test_median_image_shows_what_stays():
    frames = [np.array([[depth, np.nan]], np.float32) for depth in (4.0, 1.0, 4.0)]
    np.testing.assert_array_equal(median_image(frames), [[4.0, np.nan]])


FLOOR_GEOMETRY = RectifiedGeometry(320, 240, 260.0, 260.0, 159.5, 119.5, 0.2)


def plane(tilt_deg: float, roll_deg: float, height_m: float) -> Plane:
    tilt, roll = np.radians([tilt_deg, roll_deg])
    normal = np.array([np.sin(roll), -np.sin(tilt) * np.cos(roll), -np.cos(tilt) * np.cos(roll)])
    return Plane(-normal / height_m, 1.0, np.zeros((3, 3)))


def seen(true: Plane, contrast: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left and right image of a spotted plane, and its depth [m]."""
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    inverse = FLOOR_GEOMETRY.rays(np.stack([u, v], axis=-1)) @ true.q
    rng = np.random.default_rng(1)
    spots = cv2.GaussianBlur(rng.normal(size=(240, 320)), (0, 0), 2.5)
    right = (120 + contrast * spots).astype(np.float32)
    disparity = (260.0 * 0.2 * inverse).astype(np.float32)
    left = cv2.remap(
        right, u.astype(np.float32) - disparity, v.astype(np.float32), cv2.INTER_CUBIC, None, cv2.BORDER_REFLECT
    )
    depth = np.where(inverse > 0.1, 1.0 / np.maximum(inverse, 0.1), np.nan).astype(np.float32)
    noise = rng.normal(size=(2, 240, 320)).astype(np.float32)
    return left + noise[0], right + noise[1], depth


@pytest.mark.parametrize(
    ("lights", "taken"), [([100, 60, 104, 62, 0], [1, 0, 1, 0, 0]), ([60, 100, 61, 62], [1, 0, 1, 1])]
)
def test_images_are_taken_in_the_more_frequent_or_else_brighter_light(lights, taken):
    assert of_like_light([np.full((16, 16), light, np.uint8) for light in lights]).tolist() == taken


TRUE, GUESS = plane(60.0, 1.0, 2.5), plane(60.7, 0.7, 2.54)


@pytest.mark.parametrize("stands", [False, True], ids=["empty", "something stands on it"])
def test_a_plane_is_aligned_to_a_tenth_of_a_degree(stands):
    left, right, depth = seen(TRUE, 200.0)
    if stands:
        left[100:160, 140:200], depth[100:160, 140:200] = left[40:100, 140:200], 1.5
    aligned = align_plane(plane(60.3, 0.8, 2.52) if stands else GUESS, left, right, depth, FLOOR_GEOMETRY)
    assert aligned.distance_m == pytest.approx(2.5, abs=0.01)
    assert np.degrees([aligned.tilt_rad, aligned.roll_rad]) == pytest.approx([60.0, 1.0], abs=0.1)
    assert 0 < np.sqrt(np.trace(aligned.covariance)) < 0.01


KNOWN = Plane(np.array([0.0, 0.0, -0.4]), 1.0, np.zeros((3, 3)))  # 2.5 m below
SCALED = 0.4**2 * (SCALE_STD**2 + FOCAL_STD**2)


def test_a_floor_is_known_no_better_than_the_baseline_that_scales_it():
    np.testing.assert_allclose(with_calibration_errors(KNOWN, 0.1).covariance, np.diag([0, 0, SCALED]))


def test_a_floor_is_known_no_better_than_the_turn_of_the_camera():
    rolled = RigCorrection(np.array([0.0, 0.0, 2e-3]), np.full(3, 1e-4), np.array([0.0, 0.0, 1.0]))
    turned = (1e-4 / 0.1) ** 2, SCALED + 0.5 * (2e-3 / 0.1) ** 2  # a yaw moves all disparities, a roll tilts them
    np.testing.assert_allclose(with_calibration_errors(KNOWN, 0.1, rolled).covariance, np.diag([0, *turned]))


def test_without_texture_the_guess_stays():
    assert align_plane(GUESS, *seen(TRUE, 0.0), FLOOR_GEOMETRY) is GUESS
