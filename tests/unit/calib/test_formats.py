"""Calibration files of every format."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_calibrations import DEPTHAI, EUROC, KITTI, MIDDLEBURY, foreign_calibrations

from calib.camera import Camera
from calib.errors import InputError
from calib.formats import WRITTEN, load_rig, write_rig
from calib.formats.base import parse_yaml
from calib.formats.ros import camera_from
from calib.pose import SE3
from calib.rig import StereoRig

CAMERA = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, "brown", (-0.1, 0.01, 0.0, 0.0))
POSE = SE3.from_rotvec([0.0, 0.01, 0.0], [-0.1, 0.0, 0.0])
RIG = StereoRig(CAMERA, CAMERA, POSE, "test")


def matrix(name: str, rows: int, cols: int, data: str) -> str:
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"


def opencv_pair(folder: Path, header: str = "%YAML:1.0\n---\n", last: str = "0.", tx: str = "-0.1") -> Path:
    """Both files as OpenCV's example writes them, with the last coefficient and the first translation given."""
    k, d = "5.0e+002, 0., 3.2e+002, 0., 5.0e+002, 240., 0., 0., 1.", "-0.1, 1e-2, 0., "
    lens = matrix("M1", 3, 3, k) + matrix("D1", 1, 4, d + "0.") + matrix("M2", 3, 3, k) + matrix("D2", 1, 4, d + last)
    pose = matrix("R", 3, 3, "1., 0., 0., 0., 1., 0., 0., 0., 1.") + matrix("T", 3, 1, f"{tx}, 0., 0.")
    (folder / "intrinsics.yml").write_text(header + lens)
    (folder / "extrinsics.yml").write_text(header + pose)
    return folder


@pytest.mark.parametrize(
    "header", [f"{first}\n" for first in ("%YAML:1.0", "%YAML:1.0\n---", "%YAML 1.0\n---", "---", "\ufeff%YAML:1.0")]
)
def test_opencv_headers_of_every_style_are_read(header, tmp_path):
    rig = load_rig(opencv_pair(tmp_path, header), (640, 480))
    assert rig.baseline_m == pytest.approx(0.1)
    assert rig.left.distortion == (-0.1, 0.01, 0.0, 0.0)


def named(names: str) -> dict[str, object]:
    """The matrix, coefficients, rotation and translation of a pair under names of both cameras, R and T."""
    k, d, r, t = [[450.0, 0, 319.5], [0, 450.0, 239.5], [0, 0, 1]], [0.0] * 5, np.eye(3).tolist(), [-0.1, 0, 0]
    return dict(zip(names.split(), [k, d, k, d, r, t], strict=True))


def test_arrays_are_refused_with_the_way_out_that_is_read(tmp_path):
    np.save(tmp_path / "cal.npy", np.eye(3))
    for path in (tmp_path, tmp_path / "cal.npy"):
        with pytest.raises(InputError, match="K1, D1"):
            load_rig(path)
    (tmp_path / "cal.json").write_text(json.dumps(named("K1 D1 K2 D2 R T") | {"image_size": [640, 480]}))
    assert load_rig(tmp_path / "cal.json").baseline_m == pytest.approx(0.1)


def test_size_of_a_calibration_is_scaled_to_the_same_aspect_alone(tmp_path):
    write_rig(RIG, tmp_path / "rig.toml")
    rig = load_rig(tmp_path, (320, 240))
    assert rig.left.fx == pytest.approx(250.0)
    assert "scaled from 640x480 to 320x240" in rig.source
    with pytest.raises(InputError, match="640x360"):
        load_rig(tmp_path, (640, 360))


def test_size_that_a_file_lacks_is_taken_from_the_principal_point_with_a_note(tmp_path):
    rig = load_rig(opencv_pair(tmp_path))
    assert rig.left.size == (640, 480)
    assert "taken from the principal points" in rig.source


def test_keys_of_tutorials_are_read(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(named("mtxL distL mtxR distR rot trans")))
    assert load_rig(tmp_path).baseline_m == pytest.approx(0.1)


def test_files_that_hold_no_calibration_are_named(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"K": np.eye(3).tolist()}))
    (tmp_path / "rig.toml").write_text("")
    with pytest.raises(InputError, match=r"a\.json .*rig\.toml"):
        load_rig(tmp_path)


def test_millimetres_are_refused_unless_they_are_named(tmp_path):
    opencv_pair(tmp_path, tx="-100.")
    with pytest.raises(InputError, match=r"0\.1 m"):
        load_rig(tmp_path, (640, 480))
    assert load_rig(tmp_path, (640, 480), unit_m=0.001).baseline_m == pytest.approx(0.1)


def test_exchanged_cameras_are_refused_unless_they_are_swapped(tmp_path):
    opencv_pair(tmp_path, tx="0.1")
    with pytest.raises(InputError, match="swapped"):
        load_rig(tmp_path, (640, 480))
    assert load_rig(tmp_path, (640, 480), swap=True).right_SE3_left.translation[0] == pytest.approx(-0.1)


@pytest.mark.parametrize(("last", "tx"), [(".NaN", "-0.1"), ("0.", ".Inf"), ("nan", "-0.1"), ("[]", "-0.1")])
def test_numbers_that_are_not_finite_are_refused(last, tx, tmp_path):
    opencv_pair(tmp_path, last=last, tx=tx)
    with pytest.raises(InputError, match=r"intrinsics.yml.*(finite|numbers)"):
        load_rig(tmp_path, (640, 480))


@pytest.mark.parametrize("k1", [-1e6, -3.0, 1e6, 1e300])
def test_lens_that_shows_no_picture_is_refused(k1, tmp_path):
    camera = replace(CAMERA, distortion=(k1, 0.0, 0.0, 0.0))
    write_rig(replace(RIG, left=camera), tmp_path / "rig.toml")
    with pytest.raises(InputError, match="left lens"):
        load_rig(tmp_path / "rig.toml")


@pytest.mark.parametrize(
    ("end", "found"),
    [
        ("[right]", "line 13"),
        (", 0.0, 0.0]", "line 12"),
    ],
)
def test_where_a_rig_that_is_cut_short_ends_is_named(end, found, tmp_path):
    write_rig(RIG, tmp_path / "rig.toml")
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text[: text.index(end)])
    with pytest.raises(InputError, match=found):
        load_rig(tmp_path, (640, 480))


@pytest.mark.parametrize(("name", "found"), [("", "only half of a pair"), ("intrinsics.yml", "other half")])
def test_half_of_a_pair_is_refused(name, found, tmp_path):
    (opencv_pair(tmp_path) / "extrinsics.yml").unlink()
    with pytest.raises(InputError, match=found):
        load_rig(tmp_path / name, (640, 480))


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_projections_of_rectified_images_alone_are_a_calibration(suffix, tmp_path):
    storage = cv2.FileStorage(str(tmp_path / f"rect.{suffix}"), cv2.FILE_STORAGE_WRITE)
    p1 = np.array([[450.0, 0, 320, 0], [0, 450, 240, 0], [0, 0, 1, 0]])
    for name, value in {"image_width": 640, "image_height": 480, "P1": p1, "P2": p1 + np.eye(3, 4, 3) * -54.0}.items():
        storage.write(name, value)
    storage.release()
    rig = load_rig(tmp_path)
    assert (rig.left.fx, rig.left.cx, rig.left.size) == (450.0, 320.0, (640, 480))
    assert rig.baseline_m == pytest.approx(0.12)
    assert "rectified images" in rig.source


@pytest.mark.parametrize(
    ("name", "text", "lacks"),
    [
        ("a.json", json.dumps({name: [] for name in ("K1", "D1", "K2", "D2", "R")}), "OpenCV .* lacks T$"),
        ("a.yml", matrix("P2", 3, 4, "1"), "OpenCV .* lacks P1$"),
        ("a.yml", matrix("M1", 3, 3, "1") + matrix("D1", 1, 4, "1"), "M2, D2, R, T"),
        ("a.conf", "[LEFT_CAM_HD]\nfx=1\n[STEREO]\n", "ZED factory conf it lacks RIGHT_CAM$"),
        ("calib.txt", "cam0=[1]\ncam1=[1]\nwidth=1\nheight=1\n", "Middlebury calib.txt it lacks baseline$"),
        (
            "a.yaml",
            "camera_matrix:\ndistortion_model:\nrectification_matrix:\nprojection_matrix:\n",
            "left or right in",
        ),
    ],
)
def test_refusal_names_what_the_nearest_format_needs(name, text, lacks, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=lacks):
        load_rig(tmp_path / name)


def test_two_calibrations_in_a_folder_are_refused_unless_one_is_ours(tmp_path):
    write_rig(RIG, tmp_path / "a.yml")
    write_rig(RIG, tmp_path / "b.yaml")
    with pytest.raises(InputError, match=r"a\.yml, b\.yaml"):
        load_rig(tmp_path)
    write_rig(RIG, tmp_path / "rig.toml")
    assert load_rig(tmp_path).source == "test"


@pytest.mark.parametrize("names", [(DEPTHAI,), (KITTI,), EUROC, (MIDDLEBURY,)])
def test_format_that_is_only_read_gives_the_pair(names, tmp_path):
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(foreign_calibrations()[name])
    rig = load_rig(tmp_path)
    np.testing.assert_allclose(rig.right_SE3_left.translation, [-0.12, 0.0, 0.0], atol=1e-12)
    assert (rig.left.fx, rig.right.fy) == (230.0, 230.0)


def test_depthai_extrinsics_are_composed_along_the_chain(tmp_path):
    data = json.loads(foreign_calibrations()[DEPTHAI])
    left, right = (entry for _, entry in data["cameraData"])
    # left -> colour (socket 0) <- right, as an OAK-D writes it.
    for side, x_cm in ((left, -5.0), (right, 5.0)):
        shift = {"x": x_cm, "y": 0.0, "z": 0.0}
        side["extrinsics"] = {"rotationMatrix": np.eye(3).tolist(), "translation": shift, "toCameraSocket": 0}
    data["cameraData"] = [[0, {**left, "extrinsics": {"toCameraSocket": -1}}], [1, left], [2, right]]
    (tmp_path / "calib.json").write_text(json.dumps(data))
    np.testing.assert_allclose(load_rig(tmp_path).right_SE3_left.translation, [-0.1, 0.0, 0.0], atol=1e-12)


def zed(path: Path, **cameras: str) -> Path:
    """A file of the ZED: intrinsics of both cameras by resolution."""
    sides = [f"[{side}_CAM_{name}]\n{camera}" for name, camera in cameras.items() for side in ("LEFT", "RIGHT")]
    turns = "".join(f"CV_{name}={0.01 * i}\nRX_{name}=0\n" for i, name in enumerate(cameras, 1))
    path.write_text("".join(sides) + f"[STEREO]\nBaseline=120\n{turns}")
    return path


def test_zed_resolution_follows_the_images(tmp_path):
    camera = "fx={f}\nfy={f}\ncx={x}\ncy={y}\nk1=-0.17\nk2=0.02\np1=0\np2=0\n"
    zed(tmp_path / "SN1.conf", HD=camera.format(f=700, x=640, y=360), VGA=camera.format(f=350, x=336, y=188))
    assert load_rig(tmp_path, (672, 376)).left.fx == 350.0
    rig = load_rig(tmp_path, (1280, 720))
    np.testing.assert_allclose(rig.right_SE3_left.rotvec, [0.0, 0.01, 0.0], atol=1e-12)
    np.testing.assert_allclose(rig.right_SE3_left.translation, [-0.12, 0.0, 0.0])
    assert "the largest of 1280x720, 672x376" in load_rig(tmp_path).source


def test_zed_lens_with_k1_to_k4_alone_is_a_fisheye(tmp_path):
    camera = "fx=700\nfy=700\ncx=640\ncy=360\nk1=-0.04\nk2=0.03\nk3=-0.02\nk4=0.01\n"
    rig = load_rig(zed(tmp_path / "SN1.conf", HD=camera))
    assert rig.left.model == "fisheye"
    assert rig.left.distortion == (-0.04, 0.03, -0.02, 0.01)


def test_kitti_rectified_images_get_the_rectified_cameras(tmp_path):
    lines = []
    for name, shift in (("02", 0.06), ("03", -0.47)):
        lines += [
            f"S_{name}: 1392 512", f"K_{name}: 960 0 696 0 957 224 0 0 1", f"D_{name}: -0.37 0.2 0.001 0.002 -0.07",
            f"R_{name}: 1 0 0 0 1 0 0 0 1", f"T_{name}: {shift} 0 0", f"S_rect_{name}: 1242 375",
            f"P_rect_{name}: 720 0 610 {720 * shift} 0 720 173 0 0 0 1 0",
        ]  # fmt: skip
    (tmp_path / "calib_cam_to_cam.txt").write_text("calib_time: 09-Jan-2012 13:57:47\n" + "\n".join(lines))
    raw, rectified = load_rig(tmp_path), load_rig(tmp_path, (1242, 375))
    assert (raw.left.size, raw.left.fx, rectified.left.fx) == ((1392, 512), 960.0, 720.0)
    assert raw.baseline_m == pytest.approx(0.53)
    assert rectified.baseline_m == pytest.approx(0.53)


@pytest.mark.parametrize(
    "content",
    [
        "cam0: !!python/object/apply:os.system ['touch PWNED']\ncamera_model: x\n",
        "cam0: &a [*a]\ncamera_model: x\n",
        "%YAML:1.0\nM1: !!opencv-matrix {{{\nT: 1\n",
        "cam0: " + "[" * 5000 + "\ncamera_model: x\n",
        "cam0: 2001-99-99\ncamera_model: pinhole\n",
        '{"cameraData": ' + "[" * 100000,
        '{"cameraData": 3}',
        "[right_SE3_left]\nrotation = 3\n",
        "[LEFT_CAM_HD]\nfx\n",
        "K_00: 1\nT_00: 2\n",
        "cam0=[1 2 3]\n",
        "camera_model: x\ncam0:\n  intrinsics: 3\ncam1: 4\n",
        '<?xml version="1.0"?><!DOCTYPE l [<!ENTITY a "aa">]><opencv_storage><M1 type_id="opencv-matrix">&a;</M1><T>1'
        "</T></opencv_storage>",
    ],
)
def test_hostile_files_are_refused_in_one_sentence(content, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f").write_text(content)
    with pytest.raises(InputError, match="expected") as refusal:
        load_rig(tmp_path / "f")
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "PWNED").exists()


@pytest.mark.parametrize(
    ("name", "found"), [("none.yml", "no such file or folder"), ("", "calibration in it, found none")]
)
def test_absence_of_a_calibration_is_refused(name, found, tmp_path):
    with pytest.raises(InputError, match=found):
        load_rig(tmp_path / name)


MAX_PX = 1e-6
RIG_POSE = SE3.from_rotvec([0.01, -0.02, 0.005], [-0.12, 0.002, 0.001])
BROWN4 = Camera(1280, 720, 500.123456789, 501.5, 641.25, 359.75, "brown", (-0.3, 0.1, 0.001, -0.0005))
BROWN5 = Camera(1280, 720, 510.0, 509.0, 638.0, 361.0, "brown", (-0.25, 0.08, -0.001, 0.0005, 0.01))
RATIONAL8 = replace(BROWN5, model="rational", distortion=(0.1, 0.2, 0.001, 0.002, 0.03, 0.2, 0.1, 0.05))
RATIONAL14 = replace(RATIONAL8, distortion=(*RATIONAL8.distortion, 0.001, 2e-4, -0.001, 3e-4, 0.01, -0.02))
FISHEYE = Camera(1280, 720, 300.0, 301.0, 640.0, 360.0, "fisheye", (0.02, -0.01, 0.003, -0.0005))
LENSES = {"brown4": BROWN4, "brown5": BROWN5, "rational8": RATIONAL8, "rational14": RATIONAL14, "fisheye": FISHEYE}
HOLDS = {
    "rig": set(LENSES),
    "opencv": set(LENSES),
    "kalibr": {"brown4", "fisheye"},
    "ros": {"brown4", "brown5", "rational8", "fisheye"},
}


SUFFIXES = {form.key: form.suffix for form in WRITTEN}


def furthest_pixel(one: StereoRig, other: StereoRig) -> float:
    x, y, z = np.meshgrid(np.linspace(-0.5, 0.5, 7), np.linspace(-0.4, 0.4, 7), [0.8, 2.0, 10.0])
    points = np.stack([x * z, y * z, z], axis=-1).reshape(-1, 3)
    pixels = [[rig.left.project(points), rig.right.project(rig.right_SE3_left @ points)] for rig in (one, other)]
    return float(np.abs(np.subtract(*pixels)).max())


@pytest.mark.parametrize("key", HOLDS)
@pytest.mark.parametrize("lens", LENSES)
def test_format_keeps_every_reprojected_point_whatever_the_file_is_called_or_refuses(key, lens, tmp_path):
    rig = StereoRig(LENSES[lens], LENSES[lens], RIG_POSE, "test")
    if lens not in HOLDS[key]:
        with pytest.raises(InputError, match="can hold"):
            write_rig(rig, tmp_path / "out", key)
        return
    path = tmp_path / f"out{SUFFIXES[key]}"
    write_rig(rig, path, key)
    assert furthest_pixel(load_rig(path.rename(tmp_path / "x")), rig) < MAX_PX


def test_pair_of_opencv_files_is_read_back_from_its_folder_or_a_half(tmp_path):
    rig = StereoRig(BROWN4, BROWN5, RIG_POSE, "test")
    written = write_rig(rig, tmp_path / "pair", "opencv")
    assert [path.name for path in written] == ["intrinsics.yml", "extrinsics.yml"]
    assert furthest_pixel(load_rig(tmp_path / "pair"), rig) < MAX_PX
    assert furthest_pixel(load_rig(written[1]), rig) < MAX_PX


def test_opencv_reads_what_we_write(tmp_path):
    write_rig(StereoRig(RATIONAL14, RATIONAL14, RIG_POSE, ""), tmp_path / "rig.yml")
    storage = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("M1").mat(), RATIONAL14.matrix)
    np.testing.assert_array_equal(storage.getNode("D2").mat().ravel(), RATIONAL14.distortion)
    np.testing.assert_array_equal(storage.getNode("T").mat().ravel(), RIG_POSE.translation)


def stored_by_opencv(path: Path, rig: StereoRig, column: bool = False) -> Path:
    """The rig as OpenCV's FileStorage writes it, coefficients in a row or a column."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for number, camera in ((1, rig.left), (2, rig.right)):
        storage.write(f"M{number}", camera.matrix)
        storage.write(f"D{number}", camera.coefficients.reshape((-1, 1) if column else (1, -1)))
    storage.write("R", np.array(rig.right_SE3_left.rotation))
    storage.write("T", np.array(rig.right_SE3_left.translation).reshape(3, 1))
    storage.release()
    return path


@pytest.mark.parametrize("name", ["a.yml", "a.xml"])
def test_files_that_opencv_writes_are_read(name, tmp_path):
    rig = StereoRig(BROWN4, BROWN5, RIG_POSE, "")
    assert furthest_pixel(load_rig(stored_by_opencv(tmp_path / name, rig), (1280, 720)), rig) < MAX_PX


def test_column_of_four_coefficients_may_be_a_fisheye(tmp_path):
    column = stored_by_opencv(tmp_path / "a.yml", StereoRig(BROWN4, BROWN4, RIG_POSE, ""), column=True)
    with pytest.raises(InputError, match="fisheye"):
        load_rig(column, (1280, 720))


def test_camera_info_of_a_binned_region_of_interest():
    fields = {
        "width": 1280, "height": 960, "distortion_model": "plumb_bob", "D": [0.0] * 5, "R": np.eye(3).ravel().tolist(),
        "K": [400, 0, 640, 0, 400, 480, 0, 0, 1], "P": [400, 0, 640, -40, 0, 400, 480, 0, 0, 0, 1, 0],
        "roi": {"x_offset": 320, "y_offset": 240, "width": 640, "height": 480}, "binning_x": 2, "binning_y": 2,
    }  # fmt: skip
    camera, pose = camera_from(fields, "camera_info")
    assert (camera.size, camera.fx, camera.cx, camera.cy) == ((320, 240), 200.0, 160.0, 120.0)
    assert pose.translation.tolist() == pytest.approx([0.1, 0.0, 0.0])


def test_first_of_several_yaml_documents_is_read():
    assert parse_yaml("a: 1\n---\na: 2\n---\n") == {"a": 1}


@pytest.mark.parametrize(("y_m", "where"), [(-0.12, "below"), (0.12, "above")])
def test_cameras_one_above_the_other_are_refused_by_name(y_m, where):
    with pytest.raises(InputError, match=where):
        StereoRig(CAMERA, CAMERA, SE3(np.eye(3), np.array([0.0, y_m, 0.0])), "test").check("rig")
