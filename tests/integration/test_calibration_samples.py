"""Calibration files as other tools wrote them."""

from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.tsai import load_tsai


@pytest.fixture(scope="module")
def samples(shared_data: Path) -> Path:
    return shared_data / "calib-format-samples"


@pytest.mark.parametrize(
    ("name", "size", "baseline_m"),
    [
        ("opencv_intrinsics.yml", (640, 480), 3.343),
        ("chusei_ros_left.yaml", (320, 240), 0.1813),
        ("chusei_ros_right.yaml", (320, 240), 0.1813),
        ("depthai_eeprom_calib.json", (1280, 800), 0.07381),
        ("msckf_vio_camchain-imucam-euroc.yaml", (752, 480), 0.11008),
        ("msckf_vio_camchain-imucam-euroc-noextrinsics.yaml", (752, 480), 0.11008),
        ("msckf_vio_camchain-imucam-fla.yaml", (960, 800), 0.20006),
        ("openvins_euroc_kalibr_imucam_chain.yaml", (752, 480), 0.11008),
        ("zed_factory_SN1010.conf", (1280, 720), 0.12),
        ("zed_factory_SN1010.conf", (672, 376), 0.12),
    ],
)
def test_sample_is_read(name: str, size: tuple[int, int], baseline_m: float, samples: Path) -> None:
    rig = load_rig(samples / name, size)
    assert rig.baseline_m == pytest.approx(baseline_m, rel=1e-3)
    assert rig.left.size == rig.right.size == size


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("stereopi_ros_left.yaml", r"principal point inside the image of 320x240, found \(634.9, 379.8\)"),
        ("stereopi_ros_right.yaml", "principal point inside the image"),
        ("dreameer_opencv_olddata_intrinsics.yml", r"T = \+1.0461 m: left and right are swapped"),
        ("barry_opencv_intrinsics.yml", "millimetres"),
        ("lacatus_data_pets09_cameracalib_camera001.cfg", "none of these formats"),
    ],
)
def test_sample_without_a_usable_rig_is_refused(name: str, why: str, samples: Path) -> None:
    with pytest.raises(InputError, match=why):
        load_rig(samples / name)


def test_kalibr_chain_and_imu_poses_of_the_same_rig_agree(samples: Path) -> None:
    chain = load_rig(samples / "msckf_vio_camchain-imucam-euroc.yaml")
    imu = load_rig(samples / "openvins_euroc_kalibr_imucam_chain.yaml")
    np.testing.assert_allclose(chain.right_SE3_left.matrix, imu.right_SE3_left.matrix, atol=1e-8)


def test_ros_pose_agrees_with_its_own_rectification(samples: Path) -> None:
    # A point must fall on the same row of both rectified images of the file.
    rig = load_rig(samples / "chusei_ros_left.yaml")
    left_rows = np.array(
        [[0.964297, 0.000775, 0.264822], [-0.002139, 0.999986, 0.004861], [-0.264815, -0.005254, 0.964285]]
    )
    right_rows = np.array(
        [[0.936555, 0.004652, 0.350489], [-0.002834, 0.99998, -0.005699], [-0.350508, 0.004344, 0.93655]]
    )
    points = np.array([[0.1, 0.2, 2.0], [-0.3, 0.1, 3.0]])
    left, right = points @ left_rows.T, (rig.right_SE3_left @ points) @ right_rows.T
    np.testing.assert_allclose(left[:, 1] / left[:, 2], right[:, 1] / right[:, 2], atol=1e-5)
    np.testing.assert_allclose(left[:, 0] - right[:, 0], 88.273173 / 486.886495, atol=1e-4)


def test_pets_view_puts_the_annotated_feet_where_the_annotation_does(shared_data: Path) -> None:
    folder = shared_data / "pets09-s2l1-view001"
    camera = load_tsai(folder / "View_001.xml", (480, 360))
    rows = np.loadtxt(folder / "gt.txt", delimiter=",")
    feet = np.column_stack([rows[:, 2] + rows[:, 4] / 2, rows[:, 3] + rows[:, 5]])
    away = np.linalg.norm(camera.back_project(feet) - rows[:, 7:9], axis=1)
    assert np.median(away) < 0.15
    assert away.max() < 0.25
