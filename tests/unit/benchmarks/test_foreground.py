"""Pixels of foreground masks against exact ones."""

import numpy as np
import pytest

from benchmarks.foreground import PixelTally


def test_shares_leave_out_pixels_of_moving_things():
    owner = np.array([[0, 0, 0, 0], [1, 1, 2, -1]], np.int32)
    found = np.array([[True, False, False, False], [True, False, True, True]])
    tally = PixelTally()
    tally.add(found, owner)
    score = tally.score("mall", 0, "as drawn", "planview")
    assert (score.wrong, score.missed, score.false) == pytest.approx((2 / 7, 1 / 3, 1 / 4))
