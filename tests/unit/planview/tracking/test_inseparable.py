"""Which floor positions may be one body."""

import numpy as np

from planview.maps.builder import CameraViewpoint
from planview.tracking.detection import inseparable, inseparable_pairs

VIEW = CameraViewpoint(np.array([0.0, 0.0, 2.5]), 0.01, np.eye(3, 4), (640, 480))


def test_depth_noise_stretches_along_the_ray_only():
    assert inseparable(VIEW, (0.0, 6.0), (0.0, 7.0), 0.5)
    assert not inseparable(VIEW, (0.0, 6.0), (1.0, 6.0), 0.5)


def test_pairs_are_those_that_are_inseparable_one_by_one():
    places = np.random.default_rng(1).uniform(-3, 8, (40, 2))
    one_by_one = [
        (i, j)
        for i in range(len(places))
        for j in range(i + 1, len(places))
        if inseparable(VIEW, tuple(places[i]), tuple(places[j]), 0.5)
    ]
    assert len(one_by_one) > 10
    assert inseparable_pairs(VIEW, places, 0.5) == one_by_one


def test_no_people_have_no_pairs():
    assert inseparable_pairs(VIEW, np.empty((0, 2)), 0.5) == []
