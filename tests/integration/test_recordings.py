"""Recordings and calibrations as people and other tools wrote them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.one_camera import load_tsai
from calib.types import F32, U8
from stereo.depth import RectifiedGeometry
from stereo.floor import FloorSearch, PairFrames, spread_frames
from stereo.matcher import DisparityRange, SgbmMatcher
from stereo.readers import find_layout, open_recording
from stereo.rectify import Rectifier, RectifyParams, aligned_rectifier

STEREO = [
    ("euroc-asl", "euroc", (752, 480), 12, 20.0, 458.654, 0.11008),
    ("kitti-raw-made", "kitti", (640, 400), 20, 15.0, 404.4458, 0.07381),
    ("ros1-bag/stereo.bag", "bag", (640, 400), 20, 15.0, 404.1356, 0.07381),
    ("ros2-sqlite3/stereo", "bag", (640, 400), 20, 15.0, 404.1356, 0.07381),
    ("ros2-mcap/stereo/stereo.mcap", "bag", (640, 400), 20, 15.0, 404.1356, 0.07381),
    ("side-by-side/lr_raw.mp4", "side-by-side", (640, 400), 20, 15.0, 404.1356, 0.07381),
    ("side-by-side/rl_swapped_raw.mp4", "side-by-side", (640, 400), 20, 15.0, 404.1356, 0.07381),
]
REFUSED = {
    "negatives/example_noimages.bag": "found /rosout of rosgraph_msgs/msg/Log",
    "negatives/example_bz2_noimages.bag": "found /rosout of rosgraph_msgs/msg/Log",
    "negatives/logs_noimages.mcap": "expected messages of ROS 2, found others",
    "negatives/empty.db3": "expected image topics of two cameras",
    "negatives/lfs_pointer.bag": "git lfs pull",
    "negatives/truncated.bag": "rosbag reindex",
    "negatives/truncated.mcap": "mcap recover",
    "negatives/fake.svo": "ZED SDK",
    "mcap-foxglove/custom-camera-model.mcap": "write its images into folders",
    "side-by-side/not_stereo_depth_and_rgb.mp4": "depth in a video is not read",
}


@pytest.fixture
def recordings(shared_data) -> Path:
    if not (shared_data / "recordings").is_dir():
        pytest.skip("no recordings in the test data")
    return shared_data / "recordings"


@pytest.mark.parametrize(("name", "reader", "size", "frames", "fps", "focal_px", "baseline_m"), STEREO)
def test_stereo_sample_opens_as_it_was_recorded(recordings, name, reader, size, frames, fps, focal_px, baseline_m):
    assert find_layout(recordings / name)[0].key == reader
    recording = open_recording(recordings / name)
    assert recording.sensor.rig.left.size == size
    assert recording.n_frames == frames
    assert recording.fps == pytest.approx(fps, rel=1e-4)
    assert recording.sensor.rig.left.fx == pytest.approx(focal_px, rel=1e-5)
    assert recording.sensor.rig.baseline_m == pytest.approx(baseline_m, rel=1e-3)
    assert len(recording.sample(2)) == 2


def test_depth_topics_open_as_they_were_recorded(recordings):
    _, layout = find_layout(recordings / "ros1-bag" / "rgbd_compressed.bag")
    frame = layout.open().sample(1)[0]
    assert layout.kind == "rgbd"
    assert layout.n_frames == 15
    assert layout.clock.fps == pytest.approx(5.0)
    assert frame.index == 0
    assert layout.streams[1].pixels == "depth"


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_recording_is_refused_in_one_sentence(recordings, name):
    with pytest.raises(InputError) as error:
        open_recording(recordings / name)
    assert REFUSED[name] in str(error.value)
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def samples(shared_data) -> Path:
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
def test_sample_is_read(name, size, baseline_m, samples):
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
def test_sample_without_a_usable_rig_is_refused(name, why, samples):
    with pytest.raises(InputError, match=why):
        load_rig(samples / name)


def test_kalibr_chain_agrees_with_imu_poses_of_the_same_rig(samples):
    chain = load_rig(samples / "msckf_vio_camchain-imucam-euroc.yaml")
    imu = load_rig(samples / "openvins_euroc_kalibr_imucam_chain.yaml")
    np.testing.assert_allclose(chain.right_SE3_left.matrix, imu.right_SE3_left.matrix, atol=1e-8)


def test_ros_pose_agrees_with_its_own_rectification(samples):
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


def test_pets_view_puts_the_annotated_feet_where_the_annotation_does(shared_data):
    folder = shared_data / "pets09-s2l1-view001"
    camera = load_tsai(folder / "View_001.xml")  # of images of 768x576; the rows are of 480x360
    rows = np.loadtxt(folder / "gt.txt", delimiter=",")
    feet = (np.column_stack([rows[:, 2] + rows[:, 4] / 2, rows[:, 3] + rows[:, 5]]) + 0.5) * 1.6 - 0.5
    away = np.linalg.norm(camera.back_project(feet) - rows[:, 7:9], axis=1)
    assert np.median(away) < 0.15
    assert away.max() < 0.25


def middlebury(folder: Path) -> tuple[U8, U8, F32]:
    left, right, truth = (cv2.imread(str(folder / name), 0) for name in ("im2.ppm", "im6.ppm", "disp2.pgm"))
    assert left is not None
    assert right is not None
    assert truth is not None
    known = truth.astype(np.float32) / 4
    known[truth == 0] = np.nan
    return left, right, known


@pytest.mark.parametrize(("scene", "bad_most"), [("cones", 0.064), ("teddy", 0.102)])
def test_middlebury_is_matched_better_than_by_plain_sgbm(shared_data, scene, bad_most):
    left, right, truth = middlebury(shared_data / "middlebury-2003" / scene)
    geometry = RectifiedGeometry(left.shape[1], left.shape[0], 400.0, 400.0, 225.0, 187.0, 0.16)
    found = SgbmMatcher(geometry, disparities=DisparityRange(0, 64))(left, right)
    valid = np.isfinite(found) & np.isfinite(truth)
    bad = np.mean(np.abs(found - truth)[valid] > 1.0)
    assert bad <= bad_most
    assert valid.sum() / np.isfinite(truth).sum() > 0.85  # plain SGBM: 0.82


def test_overhead_pair_is_corrected_by_its_own_matches(shared_data):
    recording = open_recording(shared_data / "overhead-stereo")
    pairs = spread_frames(recording, FloorSearch())
    assert isinstance(pairs, PairFrames)
    found = pairs.correction
    assert np.degrees(found.angles[2]) == pytest.approx(0.158, abs=0.02)  # see the recording's README
    assert list(found.is_applied) == [True, False, True]  # yaw cannot be printed
    assert "roll corrected by 0.15" in str(found)
    assert found.before_px > 0.3
    assert found.after_px < 0.25  # 0.5 px of the recorded 1280
    floor = pairs.floor()
    assert floor.height_m == pytest.approx(2.706, abs=0.02)
    up = floor.world_SE3_left.rotation[2]
    about_x, about_y = np.degrees([np.arctan2(-up[1], -up[2]), np.arcsin(up[0])])
    assert about_x == pytest.approx(10.9, abs=1.0)  # at 640 px; 0.4 at the recorded 1280
    assert about_y == pytest.approx(2.8, abs=1.0)
    half = aligned_rectifier(recording.sensor.rig, pairs.frames[1::2], RectifyParams())[2]
    assert np.all(np.abs(half.angles - found.angles) < 3.0 * found.deviations)


def test_overhead_videos_are_read_whole(shared_data):
    recording = open_recording(shared_data / "overhead-stereo")
    count = sum(1 for _ in recording)
    assert count == recording.n_frames == 330
    assert recording.skipped == []
    assert recording.sensor.rig.left.size == (1280, 800)
    assert Rectifier(recording.sensor.rig).geometry.baseline_m == pytest.approx(0.0738, abs=1e-4)
