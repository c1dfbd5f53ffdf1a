"""Images with depth: noise, rectification, registration."""

import numpy as np
import pytest
from reference import stereo_kernels as reference

from calib.camera import Camera
from calib.pose import SE3
from calib.rig import RgbdRig
from stereo._kernels import register_depth
from stereo.depth import DepthFromDisparity
from stereo.recording import RgbdFrame
from stereo.rgbd import DepthRegistration, RgbdRectifier

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
LENS = (-0.1, 0.05, 0.0, 0.0, 0.0)


def test_structured_light_has_the_published_noise() -> None:
    geometry = RgbdRectifier(CAMERA, "structured-light").geometry
    assert geometry.depth_std_m(5.0) == pytest.approx(0.0356, abs=1e-4)  # Khoshelham and Elberink: about 4 cm at 5 m
    assert geometry.disparity_std_px == 0.25


def test_time_of_flight_keeps_its_noise_nearby() -> None:
    geometry = RgbdRectifier(CAMERA, "time-of-flight").geometry
    assert geometry.depth_std_m(0.5) == pytest.approx(0.005, rel=0.01)
    at = geometry.disparity_at(0.5)
    assert geometry.disparity_std_per_px2 * at**2 == pytest.approx(at / 0.5 * 0.005)  # sigma_d = d / z sigma_z


def test_equivalent_disparity_gives_the_depth_back() -> None:
    depth = np.full((48, 64), 3.0, np.float32)
    depth[0, 0] = np.nan
    rectifier = RgbdRectifier(CAMERA, "structured-light")
    rectified = rectifier(RgbdFrame(0, 0.0, np.zeros((48, 64, 3), np.uint8), depth))
    back = DepthFromDisparity(rectifier.geometry)(rectifier.disparity(rectified))
    np.testing.assert_allclose(back[10:, 10:], 3.0, rtol=1e-6)
    assert np.isnan(back[0, 0])


def test_rectifier_refuses_depth_of_another_size() -> None:
    frame = RgbdFrame(0, 0.0, np.zeros((48, 64), np.uint8), np.ones((24, 32), np.float32))
    with pytest.raises(ValueError, match="expected image and depth of"):
        RgbdRectifier(CAMERA, "stereo")(frame)


@pytest.mark.parametrize("farther_px", [[], [38]], ids=["alone", "before a farther surface"])
def test_registration_shifts_depth_by_the_disparity_and_keeps_the_nearer_surface(farther_px: list[int]) -> None:
    rig = RgbdRig(CAMERA, CAMERA, SE3(np.eye(3), np.array([-0.1, 0.0, 0.0])))
    depth = np.full((48, 64), np.nan, np.float32)
    depth[20, farther_px] = 6.0  # 1 px to the left: column 37 too
    depth[20, 40] = 2.0
    moved = DepthRegistration(rig)(depth)
    assert np.argwhere(np.isfinite(moved)).tolist() == [[20, 37]]  # 60 px * 0.1 m / 2 m to the left
    assert moved[20, 37] == 2.0


def test_registration_fills_an_image_of_more_pixels() -> None:
    fine = Camera(128, 96, 120.0, 120.0, 63.5, 47.5)
    moved = DepthRegistration(RgbdRig(fine, CAMERA))(np.full((48, 64), 2.0, np.float32))
    assert np.isfinite(moved[2:-2, 2:-2]).all()


def test_registered_depth_stays_as_it_is() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    assert DepthRegistration(RgbdRig(CAMERA))(depth) is depth


def test_registration_into_a_lens_hits_the_recorded_pixel() -> None:
    lens = Camera(64, 48, 60.0, 60.0, 31.5, 23.5, "brown", LENS)
    depth = np.full((48, 64), np.nan, np.float32)
    depth[40, 60] = 2.0
    moved = DepthRegistration(RgbdRig(lens, CAMERA))(depth)
    u, v = lens.project(CAMERA.unproject([(60.0, 40.0)]) * 2.0)[0]
    assert [round(v), round(u)] in np.argwhere(np.isfinite(moved)).tolist()


def test_registration_kernel_agrees_with_numpy() -> None:
    rng = np.random.default_rng(3)
    depth = rng.uniform(0.5, 6.0, (20, 30)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = np.nan
    rays = rng.normal(0, 0.3, (20, 30, 3)).astype(np.float32)
    rays[..., 2] = 1.0
    v, u = np.mgrid[:41, :51].astype(np.float32)
    distorted = np.stack([u - 4 + 0.01 * v, v - 3], axis=-1).astype(np.float32)
    shift, pinhole = np.array([0.05, -0.02, 0.01]), np.array([30.0, 31.0, 25.0, 20.0])
    found, expected = np.empty((35, 45), np.float32), np.empty((35, 45), np.float32)
    for half in (0.5, 1.3):
        register_depth(depth, rays, shift, pinhole, distorted, half, found)
        reference.register_depth(depth, rays, shift, pinhole, distorted, half, expected)
        np.testing.assert_allclose(found, expected, rtol=1e-6)
        assert np.isfinite(found).sum() > 100
