"""People near a point are found by cells of the floor."""

import numpy as np
import pytest

from planview.tracking._near_kernels import CELLS_MAX, cell_of, near_people
from tests.reference import near as reference


def listed(people: np.ndarray, reach_m: float, x_m: float, y_m: float) -> list[int]:
    near = near_people(people, reach_m)
    cell = cell_of(near, x_m, y_m)
    return [] if cell < 0 else near.people[near.starts[cell] : near.starts[cell + 1]].tolist()


@pytest.mark.parametrize(("extent_m", "count"), [(2.0, 12), (30.0, 50), (500.0, 20)])
def test_cell_lists_all_people_within_reach_once_and_in_order(extent_m: float, count: int) -> None:
    rng = np.random.default_rng(count)
    people = rng.uniform(-extent_m / 2, extent_m / 2, (count, 3))
    for x, y in [*rng.uniform(-extent_m, extent_m, (200, 2)), *people[:, :2]]:
        found = listed(people, 0.6, x, y)
        assert found == sorted(set(found))
        assert set(reference.people_within(people, 0.6, x, y)) <= set(found)


def test_people_far_away_are_not_listed() -> None:
    people = np.array([[0.0, 0.0], [5.0, 0.0], [0.1, 0.2]])
    assert listed(people, 0.5, 0.2, 0.0) == [0, 2]
    assert listed(people, 0.5, 2.5, 0.0) == []
    assert listed(people, 0.5, -40.0, 0.0) == []


def test_nobody_gives_no_cells() -> None:
    assert listed(np.empty((0, 2)), 0.5, 0.0, 0.0) == []


def test_wide_floor_has_wide_cells() -> None:
    near = near_people(np.array([[0.0, 0.0], [1000.0, 0.0]]), 0.5)
    assert near.cols <= CELLS_MAX
