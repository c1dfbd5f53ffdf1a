"""The assignment of places to people, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from planview.tracking.assignment import assign


def test_rows_take_the_columns_of_the_smallest_sum() -> None:
    assert assign(np.array([[1.0, 2.0], [1.0, 9.0]])) == [1, 0]


def test_more_columns_than_rows_leave_columns_free() -> None:
    assert assign(np.array([[5.0, 4.0, 3.0]])) == [2]


@pytest.mark.parametrize("shape", [(1, 1), (4, 4), (3, 7), (12, 12), (20, 25)])
def test_the_sum_is_that_of_scipy(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(sum(shape))
    for _ in range(20):
        cost = rng.normal(0, 5, shape)
        assert assign(cost) == linear_sum_assignment(cost)[1].tolist()


def test_more_rows_than_columns_are_refused() -> None:
    with pytest.raises(ValueError, match="2x1"):
        assign(np.zeros((2, 1)))
