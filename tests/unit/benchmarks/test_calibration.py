"""The calibration benchmark: what a figure must keep, and how far an alignment of rigs is off."""

import math

import numpy as np
import pytest

from benchmarks.calibration import Row, alignment_error
from calib.pose import SE3
from calib.rig import world_from_plane
from calib.world import RigEntry

OWN = world_from_plane(np.array([0.0, -0.9, -0.4]), 2.4)


def rig(name: str, heading_deg: float, x_m: float, y_m: float, start_s: float = 0.0) -> RigEntry:
    """A rig whose own world lies in the common one."""
    turn = SE3.from_rotvec([0.0, 0.0, math.radians(heading_deg)], [x_m, y_m, 0.0])
    return RigEntry(name, turn @ OWN, start_s)


def test_alignment_error_is_that_of_place_heading_and_clock() -> None:
    true = [rig("a", 0, 0, 0), rig("b", 170, 3, 4, 1.0)]
    error = alignment_error([rig("a", 0, 0, 0), rig("b", -179, 3.03, 4.04, 1.02)], true)
    assert error == pytest.approx((5.0, 11.0, 20.0))


def test_figure_without_a_limit_is_always_kept() -> None:
    assert [Row("a", value, "cm", 2.0).ok for value in (2.0, 2.1, math.inf)] == [True, False, False]
    assert Row("a", 5.0, "cm").ok
