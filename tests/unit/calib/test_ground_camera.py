import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import InputError
from calib.ground_camera import LENS_K_320, GroundCamera, load_ground_camera, save_ground_camera


def test_roll_turns_the_image_clockwise_about_its_centre() -> None:
    level = GroundCamera(641, 481, 500.0, 4.0, math.radians(60))
    rolled = GroundCamera(641, 481, 500.0, 4.0, math.radians(60), roll_rad=math.radians(30))
    point = [1.0, 6.0, 0.0]
    right, low = level.project(point) - [320.0, 240.0]
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    np.testing.assert_allclose(rolled.project(point) - [320.0, 240.0], [c * right - s * low, s * right + c * low])


@given(
    tilt=st.floats(0, 75), roll=st.floats(-20, 20), x=st.floats(-2, 2), y=st.floats(1, 8),
    lens=st.sampled_from(sorted(LENS_K_320)),
)  # fmt: skip
def test_floor_positions_come_back_from_their_pixels(tilt: float, roll: float, x: float, y: float, lens: str) -> None:
    camera = GroundCamera(640, 480, 500.0, 4.0, math.radians(tilt), lens, math.radians(roll))
    pixel = camera.project([x, y, 0.0])
    if np.isfinite(pixel).all():
        np.testing.assert_allclose(camera.back_project(pixel), [x, y], atol=1e-6)


def test_what_is_higher_than_the_camera_is_ahead_of_it_or_nowhere() -> None:
    camera = GroundCamera(640, 480, 500.0, 1.2, math.radians(85))
    pixel = camera.project([0.5, 4.0, 1.7])
    np.testing.assert_allclose(camera.back_project(pixel, 1.7), [0.5, 4.0])
    below_the_horizon = camera.project([0.5, 4.0, 1.0])
    assert np.isnan(camera.back_project(below_the_horizon, 1.7)).all()
    assert np.isnan(camera.back_project(pixel, 1.2)).all()


@pytest.mark.parametrize("lens", sorted(LENS_K_320))
def test_one_point_is_projected_to_the_bit_as_many_are(lens: str) -> None:
    rng, camera = np.random.default_rng(1), GroundCamera(640, 480, 300.0, 4.0, math.radians(65), lens, 0.1)
    pixels = np.vstack([rng.uniform(-600, 1200, (300, 2)), [[319.5, 239.5], [np.nan, 3.0]]])
    points = np.vstack([rng.uniform((-9, -9, 0), (9, 30, 2), (300, 3)), [[np.nan, 1.0, 0.0]]])
    for height_m in (1.1, 5.0):
        many = camera.back_project(pixels, height_m)
        assert np.isnan(many).any()
        np.testing.assert_array_equal([camera.back_project(p, height_m) for p in pixels], many)
    np.testing.assert_array_equal([camera.project(p) for p in points], camera.project(points))


def test_camera_survives_saving_and_files_without_roll_have_none(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    camera = GroundCamera(640, 480, 512.3, 4.1, math.radians(61), "normal", math.radians(-2.5))
    save_ground_camera(camera, path)
    loaded = load_ground_camera(path)
    assert loaded.roll_rad == pytest.approx(camera.roll_rad)
    lines = [line for line in path.read_text().splitlines() if not line.startswith("roll")]
    path.write_text("\n".join(lines))
    assert load_ground_camera(path).roll_rad == 0.0


def test_camera_on_its_side_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    save_ground_camera(GroundCamera(640, 480, 500.0, 4.0, 1.0), path)
    path.write_text(path.read_text().replace("roll_deg = 0.0", "roll_deg = 90"))
    with pytest.raises(InputError, match="roll within"):
        load_ground_camera(path)
