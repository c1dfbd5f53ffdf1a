"""RGB-D recordings: readers and registration."""

import json
from pathlib import Path

import numpy as np
import pytest
from reference import stereo_kernels as reference
from toy_recordings import write_images

from calib.camera import Camera
from calib.errors import InputError
from calib.pose import SE3
from calib.rig import RgbdRig
from calib.types import AnyArray
from stereo.depth import metres
from stereo.readers import open_any
from stereo.readers.pairing import nearest_mates
from stereo.recording import DepthCamera, Recording
from stereo.rgbd import DepthRegistration, RgbdRectifier, register_depth

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
LENS = (-0.1, 0.05, 0.0, 0.0, 0.0)


def test_sensors_have_the_noise_that_was_published():
    light, flight = (RgbdRectifier(CAMERA, kind).geometry for kind in ("structured-light", "time-of-flight"))
    assert light.depth_std_m(5.0) == pytest.approx(0.0356, abs=1e-4)  # Khoshelham and Elberink: about 4 cm at 5 m
    assert light.disparity_std_px == 0.25
    assert flight.depth_std_m(0.5) == pytest.approx(0.005, rel=0.01)
    at = flight.disparity_at(0.5)
    assert flight.disparity_std_per_px2 * at**2 == pytest.approx(at / 0.5 * 0.005)  # sigma_d = d / z sigma_z


def test_equivalent_disparity_gives_the_depth_back():
    depth = np.full((48, 64), 3.0, np.float32)
    depth[0, 0] = np.nan
    rectifier = RgbdRectifier(CAMERA, "structured-light")
    _, rectified = rectifier(np.zeros((48, 64, 3), np.uint8), depth)
    back = rectifier.geometry.depth(rectifier.disparity(rectified))
    np.testing.assert_allclose(back[10:, 10:], 3.0, rtol=1e-6)
    assert np.isnan(back[0, 0])


def test_rectifier_refuses_depth_of_another_size():
    with pytest.raises(ValueError, match="expected image and depth of"):
        RgbdRectifier(CAMERA, "stereo")(np.zeros((48, 64), np.uint8), np.ones((24, 32), np.float32))


@pytest.mark.parametrize("farther_px", [[], [38]], ids=["alone", "before a farther surface"])
def test_registration_shifts_the_nearer_depth_by_its_disparity(farther_px):
    rig = RgbdRig(CAMERA, CAMERA, SE3(np.eye(3), np.array([-0.1, 0.0, 0.0])))
    depth = np.full((48, 64), np.nan, np.float32)
    depth[20, farther_px] = 6.0  # 1 px to the left: column 37 too
    depth[20, 40] = 2.0
    moved = DepthRegistration(rig)(depth)
    assert np.argwhere(np.isfinite(moved)).tolist() == [[20, 37]]  # 60 px * 0.1 m / 2 m to the left
    assert moved[20, 37] == 2.0


def test_depth_fills_an_image_of_more_pixels():
    fine, depth = Camera(128, 96, 120.0, 120.0, 63.5, 47.5), np.full((48, 64), 2.0, np.float32)
    assert np.isfinite(DepthRegistration(RgbdRig(fine, CAMERA))(depth)[2:-2, 2:-2]).all()


def test_registered_depth_stays_as_it_is():
    depth = np.full((48, 64), 2.0, np.float32)
    assert DepthRegistration(RgbdRig(CAMERA))(depth) is depth


def test_registration_into_a_lens_hits_the_recorded_pixel():
    lens = Camera(64, 48, 60.0, 60.0, 31.5, 23.5, "brown", LENS)
    depth = np.full((48, 64), np.nan, np.float32)
    depth[40, 60] = 2.0
    moved = DepthRegistration(RgbdRig(lens, CAMERA))(depth)
    u, v = lens.project(CAMERA.unproject([(60.0, 40.0)]) * 2.0)[0]
    assert [round(v), round(u)] in np.argwhere(np.isfinite(moved)).tolist()


def test_registration_kernel_agrees_with_numpy():
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


COLOUR = {"fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48}
BGR = np.full((48, 64, 3), (30, 60, 90), np.uint8)


def deep(millimetres: int, size: tuple[int, int] = (48, 64)) -> AnyArray:
    return np.full(size, millimetres, np.uint16)


def _folders(
    path: Path, calibration: object, names: tuple[str, str] = ("rgb", "depth"), depth: AnyArray | None = None
) -> Path:
    write_images(path / names[0], "0.jpg", "1.jpg", "2.jpg", image=BGR)
    write_images(path / names[1], "0.png", "1.png", "2.png", image=deep(2500) if depth is None else depth)
    (path / "calib.json").write_text(json.dumps(calibration))
    return path


def _open(path: Path) -> Recording[DepthCamera]:
    recording = open_any(path)
    assert isinstance(recording.sensor, DepthCamera)
    return recording


@pytest.mark.parametrize("names", [("rgb", "depth"), ("color", "depth"), ("Color", "aligned_depth_to_color")])
def test_folders_hold_millimetres_unless_a_file_gives_another_unit(tmp_path, names):
    (frame, *_), recording = list(rec := _open(_folders(tmp_path, COLOUR, names))), rec
    assert (recording.n_frames, recording.sensor.camera.fx, recording.sensor.technology) == (
        3,
        60.0,
        "structured-light",
    )
    assert frame.image.shape == (48, 64, 3)
    np.testing.assert_allclose(frame.images[1], 2.5)


@pytest.mark.parametrize("scale", [5000.0, 0.0002])
def test_depth_scale_counts_units_of_a_metre_or_metres_of_a_unit(tmp_path, scale):
    frame = next(iter(_open(_folders(tmp_path, COLOUR | {"depth_scale": scale}))))
    np.testing.assert_allclose(frame.images[1], 0.5)


@pytest.mark.parametrize(
    ("key", "shift"),
    [("depth_to_rgb", {"T_m": [0.0, 0.0, 0.5]}), ("color_to_depth", {"T": [0.0, 0.0, -500.0]})],
    ids=["metres", "the other way in millimetres"],
)
def test_depth_in_its_own_frame_is_moved_by_the_pose(tmp_path, key, shift):
    content = {"rgb": COLOUR, "depth": COLOUR, key: {"R": np.eye(3).tolist(), **shift}}
    frame = next(iter(_open(_folders(tmp_path, content))))
    np.testing.assert_allclose(frame.images[1][24, 32], 3.0)


def test_open3d_intrinsics_are_stored_by_columns(tmp_path):
    matrix = [60.0, 0, 0, 0, 61.0, 0, 31.5, 23.5, 1.0]
    content = {"width": 64, "height": 48, "intrinsic_matrix": matrix, "depth_mode": "NFOV_UNBINNED"}
    recording = _open(_folders(tmp_path, content))
    assert (recording.sensor.camera.fy, recording.sensor.camera.cx, recording.sensor.technology) == (
        61.0,
        31.5,
        "time-of-flight",
    )


def test_images_in_the_folder_of_their_depth_are_distinguished_by_name(tmp_path):
    write_images(tmp_path, *(f"frame-00000{i}.color.png" for i in range(3)), image=BGR)
    write_images(tmp_path, *(f"frame-00000{i}.depth.png" for i in range(3)), image=deep(2000))
    (tmp_path / "intrinsic.json").write_text(json.dumps(COLOUR))
    assert [frame.index for frame in _open(tmp_path)] == [0, 1, 2]


def test_times_in_names_pair_images_with_depth(tmp_path):
    write_images(tmp_path / "rgb", *(f"1305031102.{t}.png" for t in (175304, 211214, 243211)), image=BGR)
    write_images(tmp_path / "depth", *(f"1305031102.{t}.png" for t in (160407, 226738)), image=deep(2000))
    (tmp_path / "intrinsic.json").write_text(json.dumps(COLOUR))
    recording = _open(tmp_path)
    assert [(frame.index, round(frame.timestamp_s, 4)) for frame in recording] == [(0, 0.0), (1, 0.0359)]
    assert recording.notes == ["1 of 3 images without a depth image within 20 ms, skipped"]


def test_depth_of_another_resolution_counts_as_registered(tmp_path):
    recording = _open(_folders(tmp_path, COLOUR, depth=deep(2000, (24, 32))))
    assert np.isfinite(next(iter(recording)).images[1][2:-2, 2:-2]).all()
    assert any("counts as registered" in note for note in recording.notes)


def test_folders_without_calibration_are_refused(tmp_path):
    (_folders(tmp_path, COLOUR) / "calib.json").unlink()
    with pytest.raises(InputError, match="calibration"):
        open_any(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (COLOUR | {"height": 40}, "another aspect"),
        ({"left": COLOUR, "right": COLOUR}, "stereo pair"),
    ],
)
def test_calibration_of_a_pair_or_another_aspect_is_refused_for_images_with_depth(tmp_path, content, message):
    with pytest.raises(InputError, match=message):
        open_any(_folders(tmp_path, content))


def test_calibration_of_twice_the_resolution_is_scaled(tmp_path):
    large = {"fx": 120.0, "fy": 120.0, "cx": 63.5, "cy": 47.5, "width": 128, "height": 96}
    recording = _open(_folders(tmp_path, large))
    assert recording.sensor.camera.fx == 60.0
    assert "scaled from 128x96" in recording.sensor.source


def test_lost_depth_image_is_skipped_with_a_reason(tmp_path):
    _folders(tmp_path, COLOUR)
    (tmp_path / "depth" / "1.png").write_bytes(b"broken")
    recording = _open(tmp_path)
    assert [frame.index for frame in recording] == [0, 2]
    why = "depth: depth/1.png cannot be decoded: no image that OpenCV reads"
    assert [(s.index, s.why) for s in recording.skipped] == [(1, why)]


def _tum(path: Path, depth_at: tuple[str, ...] = ("10.0", "10.1", "10.2")) -> Path:
    for name, times, image in (("rgb", ("10.0", "10.1", "10.2"), BGR), ("depth", depth_at, deep(10_000))):
        write_images(path / name, *(f"{t}.png" for t in times), image=image)
        (path / f"{name}.txt").write_text("\n".join(["# timestamp filename", *(f"{t} {name}/{t}.png" for t in times)]))
    return path


def test_tum_images_take_the_depth_of_their_time(tmp_path):
    recording = _open(_tum(tmp_path, ("10.01", "10.15", "10.21")))
    frames = list(recording)
    assert [(frame.index, round(frame.timestamp_s, 6)) for frame in frames] == [(0, 0.0), (2, 0.2)]
    np.testing.assert_allclose(frames[0].images[1][24, 32], 2.0)
    assert len(recording.skipped) == 1
    assert any("nominal Kinect camera" in note for note in recording.notes)


def test_tum_lists_may_have_milliseconds_before_names_of_windows(tmp_path):
    _tum(tmp_path)
    for name in ("rgb", "depth"):
        lines = [f"{1_700_000_000_000 + 100 * i} {name}\\10.{i}.png" for i in range(3)]
        (tmp_path / f"{name}.txt").write_text("\n".join(lines))
    assert [round(frame.timestamp_s, 6) for frame in _open(tmp_path)] == [0.0, 0.1, 0.2]


def test_tum_associations_decide_when_they_are_there(tmp_path):
    _tum(tmp_path, ("10.01", "10.11", "10.21"))
    (tmp_path / "associations.txt").write_text("10.0 rgb/10.0.png 10.01 depth/10.01.png\n")
    recording = _open(tmp_path)
    assert [frame.index for frame in recording] == [0]
    assert any("2 of 3 images" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("line", "found"),
    [("10.0 ../secret.png", "inside the recording"), ("nan rgb/10.1.png", r"rgb\.txt: expected time.* found 'nan")],
)
def test_tum_line_that_cannot_be_is_refused(tmp_path, line, found):
    (_tum(tmp_path) / "rgb.txt").write_text(f"# times\n10.0 rgb/10.0.png\n{line}\n")
    with pytest.raises(InputError, match=found):
        open_any(tmp_path)


def test_mates_are_nearest_to_each_other():
    images, depths = np.array([0, 33, 66]) * 1_000_000, np.array([30, 40, 90]) * 1_000_000
    assert nearest_mates(images, depths).tolist() == [-1, 0, -1]


def test_metres_leave_out_what_no_sensor_measures():
    found = metres(np.array([[0, 1000, 65535]], np.uint16), 1000.0)
    np.testing.assert_array_equal(found, np.array([[np.nan, 1.0, np.nan]], np.float32))


def test_tum_line_with_the_time_of_another_is_named(tmp_path):
    listed = "10.0 rgb/10.0.png\n10.1 rgb/10.1.png\n10.1 rgb/10.2.png\n10.10 rgb/10.3.png\n"
    (_tum(tmp_path) / "rgb.txt").write_text(listed)
    recording = _open(tmp_path)
    assert [frame.index for frame in recording] == [0, 1]
    assert recording.notes[0] == "2 lines of rgb.txt with the time of another, skipped"
