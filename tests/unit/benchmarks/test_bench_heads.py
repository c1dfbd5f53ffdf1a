"""Truth of several heads together, and how far an alignment is off."""

import math

import numpy as np
import pytest

from benchmarks.heads import AlignmentError, alignment_error, common_truth
from calib.pose import SE3
from calib.rig import world_from_plane
from calib.world import RigEntry
from planview.trajectories.table import positions_table

OWN = world_from_plane(np.array([0.0, -0.9, -0.4]), 2.4)


def head(name: str, heading_deg: float, x_m: float, y_m: float, start_s: float = 0.0) -> RigEntry:
    """A head whose own world lies in the common one."""
    turn = SE3.from_rotvec([0.0, 0.0, math.radians(heading_deg)], [x_m, y_m, 0.0])
    return RigEntry(name, turn @ OWN, start_s)


def test_alignment_error_is_that_of_place_heading_and_clock() -> None:
    true = [head("a", 0, 0, 0), head("b", 170, 3, 4, 1.0)]
    error = alignment_error([head("a", 0, 0, 0), head("b", -179, 3.03, 4.04, 1.02)], true)
    assert (error.position_m, math.degrees(error.heading_rad), error.clock_s) == pytest.approx((0.05, 11.0, 0.02))
    assert not error.ok
    assert AlignmentError(0.05, math.radians(-0.5), -0.03).ok


def test_truth_of_two_heads_is_one_row_a_person_in_the_common_world() -> None:
    frames, ones = np.arange(3), np.ones(3, dtype=np.int64)
    walk = np.column_stack([0.1 * frames, np.ones(3)])
    first = positions_table(frames, ones, walk, np.full(3, 1.7), visible=np.full(3, 0.4))
    # The second head began 0.1 s later, turned by 90 degrees, and sees a second person too.
    later = np.column_stack([np.ones(3), -0.1 * (frames + 1)])
    both = np.concatenate([later, later + 1])
    second = positions_table(
        np.concatenate([frames, frames]), np.repeat([1, 2], 3), both, np.full(6, 1.7), visible=np.full(6, 0.9)
    )
    entries = [head("a", 0, 0, 0), head("b", 90, 0, 0, 0.1)]
    truth = common_truth([first, second], entries, 10.0, np.array([0.0, 0.15, 0.2, 9.0]))
    assert list(zip(truth.frame, truth.track_id, strict=True)) == [(0, 1), (1, 1), (1, 2), (2, 1), (2, 2)]
    np.testing.assert_allclose(truth.x_m[[0, 1, 3]], [0.0, 0.15, 0.2], atol=1e-9)
    np.testing.assert_allclose(truth.y_m[[0, 1, 3]], [1.0, 1.0, 1.0], atol=1e-9)
    assert list(truth.visible[[0, 1]]) == pytest.approx([0.4, 0.9])
