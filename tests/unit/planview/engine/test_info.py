"""The outline of a camera's view on the floor."""

import math

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from planview.engine.info import ground_camera_info


def test_view_with_the_horizon_in_the_image_reaches_far_in_its_directions() -> None:
    camera = GroundCamera(640, 480, 500.0, 3.0, math.radians(80))
    outline = np.array(ground_camera_info(camera).view_m)
    far = outline[np.hypot(*outline.T) > 40]
    half_angle = np.degrees(np.arctan2(far[:, 0], far[:, 1]))
    assert (half_angle.min(), half_angle.max()) == pytest.approx((-32.6, 32.6), abs=3)
    assert np.hypot(*outline.T).max() == pytest.approx(1.7 * 500 / 20)


def test_view_straight_down_is_the_image_on_the_floor() -> None:
    camera = GroundCamera(641, 481, 500.0, 3.0, 0.0)
    outline = np.array(ground_camera_info(camera).view_m)
    assert np.abs(outline).max(axis=0) == pytest.approx([3 * 320 / 500, 3 * 240 / 500])
