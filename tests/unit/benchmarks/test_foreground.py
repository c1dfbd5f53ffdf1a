"""Pixels of foreground masks against exact ones."""

import numpy as np

from benchmarks.foreground import pixel_counts


def test_counts_leave_out_pixels_of_moving_things():
    owner = np.array([[0, 0, 0, 0], [1, 1, 2, -1]], np.int32)
    found = np.array([[True, False, False, False], [True, False, True, True]])
    assert pixel_counts(found, owner).tolist() == [1, 3, 1, 4]
