"""Rigid transforms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.pose import SE3


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.3, 3.0])
def test_the_angle_of_a_rotation_is_known_at_any_size(angle: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    rotation = Rotation.from_rotvec(angle * axis).as_matrix()
    assert SE3(rotation, np.zeros(3)).angle_rad == pytest.approx(angle, abs=1e-9)
