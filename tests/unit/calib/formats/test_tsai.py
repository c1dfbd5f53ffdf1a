from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.formats.tsai import load_tsai

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


def test_tsai_camera_above_the_floor_projects_as_by_hand(tmp_path: Path) -> None:
    # 5 m above the origin looking straight down; dpx = 0.0096 * 800 / 768 = 0.01 mm, so 800 px of focal length.
    camera = load_tsai(write(tmp_path))
    np.testing.assert_allclose(camera.centre_m, [0.0, 0.0, 5.0], atol=1e-12)
    np.testing.assert_allclose(camera.project([[1.0, 0.0, 0.0]]), [[384 + 160, 288]], atol=1e-9)
    np.testing.assert_allclose(camera.project([[0.0, 1.0, 0.0]]), [[384, 288 - 160]], atol=1e-9)


@pytest.mark.parametrize("kappa", ["0.01", "-0.005"])
def test_tsai_back_projection_inverts_projection(kappa: str, tmp_path: Path) -> None:
    camera = load_tsai(write(tmp_path, kappa=kappa, rx="2.2"))
    floor = np.array([[0.0, 0.5, 0.3], [0.4, -0.2, 0.3]])
    np.testing.assert_allclose(camera.back_project(camera.project(floor), 0.3), floor[:, :2], atol=1e-10)


def test_tsai_camera_at_another_resolution_sees_the_same(tmp_path: Path) -> None:
    path = write(tmp_path, kappa="0.01", rx="2.2")
    full, small = load_tsai(path), load_tsai(path, (384, 288))
    pixel = full.project([[0.3, 0.2, 0.0]])
    np.testing.assert_allclose(small.project([[0.3, 0.2, 0.0]]), (pixel + 0.5) / 2 - 0.5, atol=1e-9)


def test_tsai_ray_above_the_horizon_has_no_floor_point(tmp_path: Path) -> None:
    camera = load_tsai(write(tmp_path, rx="-1.5707963267948966"))
    assert np.isnan(camera.back_project([[384.0, 0.0]])).all()


@pytest.mark.parametrize(("field", "value"), [("focal", "nan"), ("focal", "-1"), ("focal", "x"), ("pitch", 'dpx="0"')])
def test_tsai_file_with_a_bad_number_is_refused(field: str, value: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"view.xml: expected a Tsai camera"):
        load_tsai(write(tmp_path, **{field: value}))
