"""Single cameras above the floor in files of other programs."""

import math
from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.formats import base
from calib.formats.one_camera import holds_one_camera, load_one_camera
from calib.formats.tsai import load_tsai
from calib.ground_camera import GroundCamera
from calib.pose import SE3

XML = """<?xml version="1.0" encoding="UTF-8"?>
<Camera name="test">
  <Geometry width="768" height="576" ncx="800" nfx="768" dx="0.0096" dy="0.01" {pitch} dpy="0.01"/>
  <Intrinsic focal="{focal}" kappa1="{kappa}" cx="384" cy="288" sx="1.0"/>
  <Extrinsic tx="0" ty="0" tz="5000" rx="{rx}" ry="0" rz="0"/>
</Camera>
"""


def write(folder: Path, focal: str = "8", kappa: str = "0", rx: str = "3.141592653589793", pitch: str = "") -> Path:
    (folder / "view.xml").write_text(XML.format(focal=focal, kappa=kappa, rx=rx, pitch=pitch))
    return folder / "view.xml"


def test_tsai_camera_projects_as_by_hand_and_nothing_above_the_horizon(tmp_path):
    # 5 m above the origin looking straight down; dpx = 0.0096 * 800 / 768 = 0.01 mm, so 800 px of focal length.
    camera = load_tsai(write(tmp_path))
    np.testing.assert_allclose(camera.centre_m, [0.0, 0.0, 5.0], atol=1e-12)
    np.testing.assert_allclose(camera.project([[1.0, 0.0, 0.0]]), [[384 + 160, 288]], atol=1e-9)
    np.testing.assert_allclose(camera.project([[0.0, 1.0, 0.0]]), [[384, 288 - 160]], atol=1e-9)
    camera = load_tsai(write(tmp_path, rx="-1.5707963267948966"))
    assert np.isnan(camera.back_project([[384.0, 0.0]])).all()


@pytest.mark.parametrize("kappa", ["0.01", "-0.005"])
def test_tsai_back_projection_inverts_projection(kappa: str, tmp_path: Path) -> None:
    camera = load_tsai(write(tmp_path, kappa=kappa, rx="2.2"))
    floor = np.array([[0.0, 0.5, 0.3], [0.4, -0.2, 0.3]])
    np.testing.assert_allclose(camera.back_project(camera.project(floor), 0.3), floor[:, :2], atol=1e-10)


@pytest.mark.parametrize(("field", "value"), [("focal", "nan"), ("focal", "-1"), ("focal", "x"), ("pitch", 'dpx="0"')])
def test_tsai_file_with_a_bad_number_is_refused(field: str, value: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"view.xml: expected a Tsai camera"):
        load_tsai(write(tmp_path, **{field: value}))


def tsai_of(camera: GroundCamera) -> str:
    """A Tsai XML of an upright camera that looks along +y, in millimetres, without distortion."""
    turn = math.pi - camera.tilt_rad  # about x
    y, z = (SE3.from_rotvec([turn, 0.0, 0.0]).rotation @ [0.0, 0.0, -1000.0 * camera.height_m])[1:]
    return (
        f'<Camera><Geometry width="{camera.width}" height="{camera.height}" dpx="0.01" dpy="0.01"/>'
        f'<Intrinsic focal="{0.01 * camera.focal_px}" kappa1="0" cx="{(camera.width - 1) / 2}" '
        f'cy="{(camera.height - 1) / 2}" sx="1"/>'
        f'<Extrinsic tx="0" ty="{y}" tz="{z}" rx="{turn}" ry="0" rz="0"/></Camera>'
    )


STREET = GroundCamera(768, 576, 1100.0, 7.0, math.radians(70))


def test_tsai_camera_is_the_same_camera_above_the_floor_at_the_size_of_the_images(tmp_path: Path) -> None:
    (tmp_path / "view.xml").write_text(tsai_of(STREET))
    assert holds_one_camera(tmp_path / "view.xml")
    found, expected = load_one_camera(tmp_path / "view.xml", (384, 288)), STREET.scaled(384, 288)
    assert (found.size, found.lens) == ((384, 288), "pinhole")
    assert found.height_m == pytest.approx(7.0) and found.focal_px == pytest.approx(expected.focal_px, rel=1e-3)
    assert math.degrees(found.tilt_rad) == pytest.approx(70.0, abs=0.05)
    with pytest.raises(InputError, match=r"expected a camera for images of 640x360 px, found one for 768x576 px"):
        load_one_camera(tmp_path / "view.xml", (640, 360))


@pytest.mark.parametrize(
    ("name", "text", "lens"),
    [
        (
            "opencv.yml",
            "%YAML:1.0\n---\ncamera_matrix: {data: [700., 0, 320, 0, 701, 240, 0, 0, 1]}\n",
            "focal length 700",
        ),
        ("cameras.txt", "# Camera list\n1 PINHOLE 640 480 512.5 512.5 320 240\n", "COLMAP, PINHOLE, focal length 512"),
        (
            "kalibr.yaml",
            "cam0:\n  intrinsics: [458.6, 457.2, 367.2, 248.3]\n  resolution: [752, 480]\n",
            "focal length 459",
        ),
        (
            "room.pet",
            '<PETRACK><OLD_MODEL CX="1" CY="2" FX="842.5" FY="842.7"/></PETRACK>',
            "PeTrack .*focal length 842",
        ),
    ],
)
def test_lens_without_a_place_is_refused_with_its_focal_length(name, text, lens, tmp_path):
    (tmp_path / name).write_text(text)
    assert holds_one_camera(tmp_path / name)
    with pytest.raises(InputError, match=rf"found only a lens \(.*{lens}"):
        load_one_camera(tmp_path / name)


def test_transposed_camera_matrix_is_named() -> None:
    with pytest.raises(ValueError, match="for M1, found it transposed"):
        base.camera((640, 480), np.array([500.0, 0, 0, 0, 500, 0, 320, 240, 1]), np.zeros(5), name="M1")
