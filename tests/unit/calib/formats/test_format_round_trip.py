"""Writing a rig and reading it back moves no reprojected point."""

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from calib.camera import Camera
from calib.errors import InputError
from calib.formats import FORMATS, load_rig, write_rig
from calib.pose import SE3
from calib.rig import StereoRig

MAX_PX = 1e-6
POSE = SE3.from_rotvec([0.01, -0.02, 0.005], [-0.12, 0.002, 0.001])
BROWN4 = Camera(1280, 720, 500.123456789, 501.5, 641.25, 359.75, "brown", (-0.3, 0.1, 0.001, -0.0005))
BROWN5 = Camera(1280, 720, 510.0, 509.0, 638.0, 361.0, "brown", (-0.25, 0.08, -0.001, 0.0005, 0.01))
RATIONAL8 = Camera(1280, 720, 510.0, 509.0, 638.0, 361.0, "rational", (0.1, 0.2, 0.001, 0.002, 0.03, 0.2, 0.1, 0.05))
RATIONAL14 = Camera(
    1280, 720, 510.0, 509.0, 638.0, 361.0, "rational", (*RATIONAL8.distortion, 0.001, 2e-4, -0.001, 3e-4, 0.01, -0.02)
)  # fmt: skip
FISHEYE = Camera(1280, 720, 300.0, 301.0, 640.0, 360.0, "fisheye", (0.02, -0.01, 0.003, -0.0005))
PLAIN = Camera(1280, 720, 500.0, 500.0, 640.0, 360.0)
RECTIFIED = StereoRig(
    PLAIN, Camera(1280, 720, 500.0, 500.0, 670.0, 360.0), SE3(np.eye(3), np.array([-0.2, 0.0, 0.0])), "rectified"
)
LENSES = {"brown4": BROWN4, "brown5": BROWN5, "rational8": RATIONAL8, "rational14": RATIONAL14, "fisheye": FISHEYE}
HOLDS = {
    "rig": set(LENSES),
    "opencv": set(LENSES),
    "depthai": set(LENSES),
    "kalibr": {"brown4", "fisheye"},
    "ros": {"brown4", "brown5", "rational8", "fisheye"},
    "zed": {"brown4", "brown5", "rational8"},
    "kitti": {"brown4", "brown5"},
    "euroc": {"brown4", "fisheye"},
    "middlebury": set(),
}


def furthest_pixel(one: StereoRig, other: StereoRig) -> float:
    x, y, z = np.meshgrid(np.linspace(-0.5, 0.5, 7), np.linspace(-0.4, 0.4, 7), [0.8, 2.0, 10.0])
    points = np.stack([x * z, y * z, z], axis=-1).reshape(-1, 3)
    left = one.left.project(points) - other.left.project(points)
    right = one.right.project(one.right_SE3_left @ points) - other.right.project(other.right_SE3_left @ points)
    return float(np.abs(np.concatenate([left, right])).max())


def name_of(key: str) -> str:
    suffix = {f.key: f.suffix for f in FORMATS}[key]
    return f"out{suffix}"


@pytest.mark.parametrize("key", HOLDS)
@pytest.mark.parametrize("lens", LENSES)
def test_format_keeps_every_reprojected_point_or_refuses(key, lens, tmp_path):
    rig = StereoRig(LENSES[lens], LENSES[lens], POSE, "test")
    path = tmp_path / name_of(key)
    if lens not in HOLDS[key]:
        with pytest.raises(InputError, match="can hold"):
            write_rig(rig, path, key)
        return
    write_rig(rig, path, key)
    assert furthest_pixel(load_rig(path), rig) < MAX_PX


@pytest.mark.parametrize("key", HOLDS)
def test_format_keeps_a_rectified_pair(key, tmp_path):
    path = tmp_path / name_of(key)
    write_rig(RECTIFIED, path, key)
    assert furthest_pixel(load_rig(path), RECTIFIED) < MAX_PX


def test_opencv_pair_of_files_in_a_folder_is_read_back(tmp_path):
    rig = StereoRig(BROWN4, BROWN5, POSE, "test")
    written = write_rig(rig, tmp_path / "pair", "opencv")
    assert [path.name for path in written] == ["intrinsics.yml", "extrinsics.yml"]
    assert furthest_pixel(load_rig(tmp_path / "pair"), rig) < MAX_PX
    assert furthest_pixel(load_rig(written[1]), rig) < MAX_PX


def test_opencv_reads_what_we_write(tmp_path):
    import cv2

    write_rig(StereoRig(RATIONAL14, RATIONAL14, POSE, ""), tmp_path / "rig.yml")
    storage = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("M1").mat(), RATIONAL14.matrix)
    np.testing.assert_array_equal(storage.getNode("D2").mat().ravel(), RATIONAL14.distortion)
    np.testing.assert_array_equal(storage.getNode("T").mat().ravel(), POSE.translation)


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_files_that_opencv_writes_are_read(suffix, tmp_path):
    import cv2

    path = tmp_path / f"stereo{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for number, camera in ((1, BROWN4), (2, BROWN5)):
        storage.write(f"M{number}", camera.matrix)
        storage.write(f"D{number}", camera.coefficients.reshape(1, -1))
    storage.write("R", np.array(POSE.rotation))
    storage.write("T", np.array(POSE.translation).reshape(3, 1))
    storage.release()
    rig = load_rig(path, (1280, 720))
    assert furthest_pixel(rig, StereoRig(BROWN4, BROWN5, POSE, "")) < MAX_PX


small = st.floats(-0.3, 0.3)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    turn=st.tuples(small, small, small),
    shift=st.tuples(st.floats(-4, -0.02), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)),
    focal=st.floats(200, 3000),
    key=st.sampled_from(["rig", "opencv", "depthai", "kalibr", "ros", "zed", "kitti", "euroc"]),
)
@example(turn=(0.0, 0.0, 1e-8), shift=(-1.0, 0.0, 0.0), focal=200.0, key="zed")
def test_any_pose_survives_every_format(turn, shift, focal, key, tmp_path):
    camera = Camera(1280, 720, focal, focal * 1.01, 600.0, 350.0, "brown", (-0.1, 0.01, 0.0, 0.0))
    rig = StereoRig(camera, camera, SE3.from_rotvec(turn, shift), "any")
    path = tmp_path / key / name_of(key)
    path.parent.mkdir(exist_ok=True)
    write_rig(rig, path, key)
    back = load_rig(path)
    np.testing.assert_allclose(back.right_SE3_left.matrix, rig.right_SE3_left.matrix, atol=1e-12)
    np.testing.assert_allclose(back.left.matrix, rig.left.matrix, rtol=1e-14)
