"""Parts of people on the floor, on maps of people seen from above."""

import pytest

from planview.tracking.newcomers import is_part_of, top_height_m, visible_area_m2
from tests.unit.planview.tracking.overhead import observe

HERE, ARM, AWAY = (0.0, 0.0), (0.42, 0.0), (3.0, 0.0)


@pytest.fixture
def maps():
    found = observe(0, [(0.0, 0.0, 1.7)]).maps
    assert found is not None
    return found


def test_visible_area_is_summed_about_a_place(maps):
    assert visible_area_m2(maps, HERE, 1.0) == pytest.approx(float(maps.occupancy.sum()), rel=1e-3)
    assert visible_area_m2(maps, AWAY, 0.2) == 0.0


def test_top_height_is_that_of_the_highest_point_near_a_place(maps):
    assert top_height_m(maps, HERE, 0.13) == pytest.approx(1.7, abs=0.1)
    assert top_height_m(maps, (100.0, 0.0), 0.13) == 0.0


def test_small_surface_is_a_part_of_a_person_within_an_arms_length_only(maps):
    assert is_part_of(maps, ARM, HERE, 0.35, 0.9, 0.2)
    assert not is_part_of(maps, ARM, HERE, 0.35, 0.3, 0.2)
    assert not is_part_of(maps, HERE, HERE, 0.35, 0.9, 0.2)
