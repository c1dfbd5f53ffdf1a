"""The floor through clicked points, which refuses those off the plane of the others."""

import numpy as np
import pytest

from calib.errors import InputError
from planview.calibration.page.solution import fit_plane, floor_assessment

FLOOR = np.array([(-1.0, 2.0, 3.0), (1.0, 2.0, 3.0), (0.0, 2.0, 5.0), (1.5, 2.0, 4.0), (-1.5, 2.0, 4.5)])
"""On a floor 2 m below a level camera (x right, y down, z forward)."""
LIMIT = np.full(6, 0.06)


def test_point_off_the_plane_is_refused_with_its_height() -> None:
    points = np.vstack([FLOOR[:4], [(0.5, 1.6, 4.0)]])
    fit = fit_plane(points, LIMIT[:5])
    assert fit.used.tolist() == [True, True, True, True, False]
    assert fit.distance_m[4] == pytest.approx(0.4)
    assert fit.floor.height_m == pytest.approx(2.0)


def test_first_point_off_the_plane_is_refused_once_the_others_agree() -> None:
    points = np.vstack([[(0.0, 1.0, 3.0)], FLOOR])
    assert fit_plane(points, LIMIT).used.tolist() == [False, True, True, True, True, True]


def test_points_on_a_line_are_refused() -> None:
    with pytest.raises(InputError, match="on one line"):
        fit_plane(np.array([(0.0, 2.0, z) for z in (3.0, 4.0, 5.0)]), LIMIT[:3])


def test_three_points_are_not_enough_and_four_on_a_plane_are() -> None:
    three, four = (floor_assessment(fit_plane(FLOOR[:n], LIMIT[:n])) for n in (3, 4))
    assert not three.enough and "fourth" in three.sentence
    assert four.enough
