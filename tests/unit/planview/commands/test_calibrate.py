"""The calibrate commands."""

import math
from pathlib import Path

import numpy as np
import pytest

from calib.camera import Camera
from calib.formats import load_rig, write_rig
from calib.ground_camera import GroundCamera, load_ground_camera
from calib.people.samples import HumanSample, read_image_size, write_samples
from calib.pose import SE3
from calib.rig import StereoRig
from planview.calibration.people import usual_sizes
from planview.foreground.bodies import bodies_of
from tests.people import standing_people

CAMERA = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, "brown", (-0.1, 0.01, 0.0, 0.0))
RIG = StereoRig(CAMERA, CAMERA, SE3.from_rotvec([0.0, 0.01, 0.0], [-0.1, 0.0, 0.0]), "test")


CONVERT = ("calibrate", "convert")


def test_convert_writes_the_format_of_the_suffix(tmp_path, json_of):
    write_rig(RIG, tmp_path / "rig.toml")
    assert json_of(*CONVERT, tmp_path / "rig.toml", tmp_path / "chain.yaml")["baseline_m"] == pytest.approx(0.1)
    assert "T_cn_cnm1" in (tmp_path / "chain.yaml").read_text()


def test_convert_writes_pairs_into_a_folder(tmp_path, succeed):
    write_rig(RIG, tmp_path / "rig.toml")
    succeed(*CONVERT, tmp_path / "rig.toml", tmp_path / "ros", "--to", "ros")
    assert load_rig(tmp_path / "ros").baseline_m == pytest.approx(0.1)


def test_convert_corrects_a_calibration_on_request(tmp_path, cli, succeed):
    moved = SE3(RIG.right_SE3_left.rotation.T, -1000 * RIG.right_SE3_left.translation)
    write_rig(StereoRig(CAMERA, CAMERA, moved, ""), tmp_path / "mm.yml")
    words = (*CONVERT, tmp_path / "mm.yml", tmp_path / "rig.toml")
    assert cli(*words)[0] == cli(*words, "--unit", "mm")[0] == 2
    succeed(*words, "--unit", "mm", "--swap", "--size", "320x240")
    rig = load_rig(tmp_path / "rig.toml")
    assert rig.baseline_m == pytest.approx(0.1)
    assert rig.left.size == (320, 240)


def test_convert_writes_the_calibration_of_rectified_images_on_request(tmp_path, succeed):
    write_rig(RIG, tmp_path / "raw.toml")
    succeed(*CONVERT, tmp_path / "raw.toml", tmp_path / "rig.toml", "--rectified")
    rig = load_rig(tmp_path / "rig.toml")
    assert rig.baseline_m == pytest.approx(RIG.baseline_m)
    assert np.array_equal(rig.right_SE3_left.rotation, np.eye(3))
    assert not any(rig.left.distortion)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("out.bla",), "--to"),
        (("out.toml", "--to", "nothing"), "expected a format of"),
        (("out.toml", "--size", "big"), "--size: expected WIDTHxHEIGHT"),
        (("out.toml", "--unit", "5 parsec"), "--unit: expected a length"),
        (("out.toml", "--cameras", "one"), "--cameras: expected two different names"),
        (("rig.toml/out.toml",), "expected a place to write to"),
    ],
)
def test_convert_refuses_nonsense_in_one_sentence(arguments, expected, tmp_path, refused):
    write_rig(RIG, tmp_path / "rig.toml")
    assert expected in refused(*CONVERT, tmp_path / "rig.toml", tmp_path / arguments[0], *arguments[1:])


def test_convert_refuses_to_write_over_the_calibration_it_reads(tmp_path, refused):
    write_rig(RIG, tmp_path / "pair", "opencv")
    before = (tmp_path / "pair" / "extrinsics.yml").read_text()
    printed = refused(*CONVERT, tmp_path / "pair", tmp_path / "pair", "--to", "opencv", "--unit", "2m")
    assert "expected another place than the calibration read" in printed
    assert (tmp_path / "pair" / "extrinsics.yml").read_text() == before


GROUND_CAMERA = GroundCamera(640, 480, 500.0, 4.0, math.radians(45), "normal-wide")


@pytest.fixture
def people(tmp_path) -> Path:
    path = tmp_path / "people.json"
    write_samples(standing_people(GROUND_CAMERA, 8, seed=1), path, GROUND_CAMERA.size)
    return path


HUMAN = ("calibrate", "human")


def test_camera_is_written_for_the_image_size_of_the_file(people, json_of):
    out = people.parent / "out" / "camera.toml"
    printed = json_of(*HUMAN, people, "--lens", "normal-wide", "--out", out)
    camera = load_ground_camera(out)
    assert camera.std.from_camera == printed["from_camera_std"]
    assert camera.size == (640, 480)
    assert printed["height_m"] == camera.height_m == pytest.approx(4.0, rel=0.01)
    assert sorted(p.name for p in out.parent.iterdir()) == ["camera.png", "camera.toml"]


def test_camera_that_does_not_predict_how_large_people_are_is_not_written(tmp_path, cli):
    street = GroundCamera(480, 360, 740.0, 7.0, math.radians(73.5))
    people = sorted(standing_people(street, 300, 0, 2.0), key=lambda person: person.foot_px[1])
    write_samples(people[150:156], tmp_path / "people.json", street.size)
    status, printed = cli(*HUMAN, tmp_path / "people.json", "--lens", "pinhole", "--out", tmp_path / "camera.toml")
    assert status == 1
    assert "not enough: " in printed
    assert "give focal length" in printed
    assert [path.name for path in tmp_path.iterdir()] == ["people.json"]


def test_image_size_must_be_that_of_the_file(people, refused):
    printed = refused(*HUMAN, people, "--image-size", "1280x960", "--out", people.parent / "camera.toml")
    assert "640x480, found 1280x960" in printed


def test_image_size_must_be_known(refused, tmp_path):
    path = tmp_path / "people.json"
    write_samples(standing_people(GROUND_CAMERA, 8, seed=1), path)
    assert read_image_size(path) is None
    assert "--image-size: expected WxH" in refused(*HUMAN, path, "--out", tmp_path / "camera.toml")


@pytest.mark.parametrize("size", ["[640]", "[640, -1]", '"640x480"'])
def test_image_size_that_is_none_is_refused_by_name(size, tmp_path, refused):
    path = tmp_path / "people.json"
    path.write_text(f'{{"image_size": {size}, "samples": []}}')
    assert "image_size" in refused(*HUMAN, path)


def body(mask: np.ndarray, left: int, top: int = 40, height: int = 50) -> None:
    """A body of 20 columns with a narrower head."""
    mask[top + 10 : top + height, left : left + 20] = 255
    mask[top : top + 10, left + 6 : left + 14] = 255


def test_body_in_two_pieces_is_no_sample():
    mask = np.zeros((120, 160), np.uint8)
    body(mask, 60, height=60)
    mask[70:80] = 0
    assert bodies_of(mask, 7) == []


def test_whole_bodies_apart_are_samples():
    mask = np.zeros((120, 160), np.uint8)
    body(mask, 60)
    (sample,) = bodies_of(mask, 7)
    assert (sample.box_px, sample.frame) == ((59.5, 39.5, 20, 50), 7)
    body(mask, 120)
    assert len(bodies_of(mask, 7)) == 2


def test_parts_of_people_are_not_of_the_usual_size():
    def standing(u, v, height):
        return HumanSample((u - 10, v - height, 20, height), (u, v - height), (u, v))

    people = [standing(u, v, 0.3 * v) for u in range(50, 300, 50) for v in range(100, 220, 20)]
    people += [standing(80, 150, 80), standing(120, 170, 25)]
    usual = usual_sizes(people)
    assert usual[:-2].all()
    assert not usual[-2:].any()
