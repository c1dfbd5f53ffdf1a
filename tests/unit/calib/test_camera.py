import numpy as np
import pytest

from calib.camera import Camera
from calib.pose import SE3
from calib.rig import Floor, world_from_plane

BROWN = Camera(640, 480, 500.0, 505.0, 320.0, 240.0, "brown", (-0.3, 0.1, 0.001, -0.001, 0.0))
FISHEYE = Camera(640, 480, 300.0, 300.0, 320.0, 240.0, "fisheye", (0.02, -0.01, 0.003, 0.0))


RATIONAL = Camera(
    1280, 800, 808.3, 807.5, 634.2, 407.7, "rational", (-9.2, 65.3, -5e-5, 5e-4, -87.7, -9.29, 65.5, -87.8)
)
TILTED = Camera(
    640, 480, 500.0, 505.0, 320.0, 240.0, "rational",
    (-0.3, 0.1, 0.001, -0.001, 0.0, 0.1, 0.05, 0.01, 0.001, 0.002, -0.001, 0.0005, 0.02, -0.03),
)  # fmt: skip


@pytest.mark.parametrize("camera", [BROWN, FISHEYE, RATIONAL, TILTED])
def test_camera_unproject_inverts_project(camera: Camera) -> None:
    points = np.array([[0.0, 0.0, 2.0], [0.8, -0.5, 2.0], [-0.9, 0.6, 3.0], [1.0, 0.6, 2.0]])
    rays = camera.unproject(camera.project(points))
    np.testing.assert_allclose(rays, points / points[:, 2:], atol=1e-9)


def test_camera_has_no_ray_for_a_pixel_beyond_where_its_lens_turns_back() -> None:
    # r - 0.3 r^3 has its maximum 0.7027 at r = 1.054: nothing is imaged further out than 351 px.
    camera = Camera(1000, 480, 500.0, 500.0, 500.0, 240.0, "brown", (-0.3, 0.0, 0.0, 0.0))
    rays = camera.unproject([[500.0 + 340.0, 240.0], [500.0 + 360.0, 240.0]])
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1, :2]).all()


def test_camera_projects_points_behind_it_to_nan() -> None:
    assert np.isnan(BROWN.project([[0.0, 0.0, -1.0]])).all()


def test_scaled_camera_keeps_pixel_centres() -> None:
    half = BROWN.scaled(320, 240)
    pixel = BROWN.project([[0.4, 0.2, 2.0]])
    np.testing.assert_allclose(half.project([[0.4, 0.2, 2.0]]), (pixel + 0.5) / 2 - 0.5, atol=1e-9)


def test_camera_refuses_nan() -> None:
    with pytest.raises(ValueError, match="finite"):
        Camera(640, 480, float("nan"), 500.0, 320.0, 240.0)


def test_pose_inverse_undoes_it() -> None:
    pose = SE3.from_rotvec([0.1, -0.2, 0.3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose((pose.inverse() @ pose).matrix, np.eye(4), atol=1e-12)


def test_world_of_an_overhead_camera_has_x_along_image_x_and_y_up_the_image() -> None:
    floor = Floor(world_from_plane(np.array([0.0, 0.0, -1.0]), 2.7))
    np.testing.assert_allclose(floor.world_SE3_left @ [[1.0, 0.0, 2.7]], [[1.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(floor.world_SE3_left @ [[0.0, -1.0, 1.7]], [[0.0, 1.0, 1.0]], atol=1e-12)
    assert floor.tilt_rad == pytest.approx(0.0)
    assert floor.height_m == pytest.approx(2.7)


def test_world_of_a_level_camera_has_y_forward() -> None:
    floor = Floor(world_from_plane(np.array([0.0, -1.0, 0.0]), 2.0))
    np.testing.assert_allclose(floor.world_SE3_left @ [[0.0, 2.0, 5.0]], [[0.0, 5.0, 0.0]], atol=1e-12)
    assert np.degrees(floor.tilt_rad) == pytest.approx(90.0)
