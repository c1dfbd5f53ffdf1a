"""``planview calibrate convert``: formats, units, swaps and refusals."""

import pytest

from calib.camera import Camera
from calib.formats import load_rig, write_rig
from calib.pose import SE3
from calib.rig import StereoRig

CAMERA = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, "brown", (-0.1, 0.01, 0.0, 0.0))
RIG = StereoRig(CAMERA, CAMERA, SE3.from_rotvec([0.0, 0.01, 0.0], [-0.1, 0.0, 0.0]), "test")


CONVERT = ("calibrate", "convert")


def test_convert_writes_the_format_the_suffix_tells(tmp_path, json_of):
    write_rig(RIG, tmp_path / "rig.toml")
    assert json_of(*CONVERT, tmp_path / "rig.toml", tmp_path / "chain.yaml")["baseline_m"] == pytest.approx(0.1)
    assert "T_cn_cnm1" in (tmp_path / "chain.yaml").read_text()


def test_convert_writes_pairs_into_a_folder(tmp_path, say):
    write_rig(RIG, tmp_path / "rig.toml")
    assert say(*CONVERT, tmp_path / "rig.toml", tmp_path / "ros", "--to", "ros")[0] == 0
    assert load_rig(tmp_path / "ros").baseline_m == pytest.approx(0.1)


def test_convert_mends_units_and_swapped_cameras_when_told(tmp_path, say):
    moved = SE3(RIG.right_SE3_left.rotation.T, -1000 * RIG.right_SE3_left.translation)
    write_rig(StereoRig(CAMERA, CAMERA, moved, ""), tmp_path / "mm.yml")
    assert say(*CONVERT, tmp_path / "mm.yml", tmp_path / "rig.toml")[0] == 2
    assert say(*CONVERT, tmp_path / "mm.yml", tmp_path / "rig.toml", "--unit", "mm")[0] == 2
    assert (
        say(*CONVERT, tmp_path / "mm.yml", tmp_path / "rig.toml", "--unit", "mm", "--swap", "--size", "320x240")[0] == 0
    )
    rig = load_rig(tmp_path / "rig.toml")
    assert rig.baseline_m == pytest.approx(0.1)
    assert rig.left.size == (320, 240)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("out.bla",), "--to"),
        (("out.toml", "--to", "nothing"), "expected a format of"),
        (("out.toml", "--size", "big"), "--size: expected WIDTHxHEIGHT"),
        (("out.toml", "--unit", "5 parsec"), "--unit: expected a length"),
        (("out.toml", "--cameras", "one"), "--cameras: expected two different names"),
        (("rig.toml/out.toml",), "expected a place to write to"),
    ],
)
def test_convert_refuses_nonsense_in_one_sentence(arguments, said, tmp_path, refused):
    write_rig(RIG, tmp_path / "rig.toml")
    assert said in refused(*CONVERT, tmp_path / "rig.toml", tmp_path / arguments[0], *arguments[1:])


def test_convert_refuses_to_write_over_the_calibration_it_reads(tmp_path, refused):
    write_rig(RIG, tmp_path / "pair", "opencv")
    before = (tmp_path / "pair" / "extrinsics.yml").read_text()
    told = refused(*CONVERT, tmp_path / "pair", tmp_path / "pair", "--to", "opencv", "--unit", "2m")
    assert "expected another place than the calibration read" in told
    assert (tmp_path / "pair" / "extrinsics.yml").read_text() == before
