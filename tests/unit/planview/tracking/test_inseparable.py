"""Which floor positions may be one body."""

import numpy as np

from planview.maps.builder import CameraViewpoint
from planview.tracking.newcomers import inseparable

VIEW = CameraViewpoint(np.array([0.0, 0.0, 2.5]), 0.01, np.eye(3, 4), (640, 480))


def test_depth_noise_stretches_along_the_ray_only():
    assert inseparable(VIEW, (0.0, 6.0), (0.0, 7.0), 0.5)
    assert not inseparable(VIEW, (0.0, 6.0), (1.0, 6.0), 0.5)
