"""A thing that was put down stays a thing while others pass before it."""

from types import SimpleNamespace

import numpy as np
import pytest

from planview.maps.builder import CameraViewpoint
from planview.maps.grid import Grid
from planview.tracking.harville.params import TemplateTrackerParams
from planview.tracking.harville.separate import Separate

VIEW = CameraViewpoint(np.array([0.0, 0.0, 2.75]), 0.002, np.eye(3, 4), (640, 480))


def at(x_m, y_m, height_m, spawned_m=None):
    place = x_m, y_m
    return SimpleNamespace(at_m=place, spawned_m=spawned_m or place, height_m=height_m, alone_s=-np.inf)


@pytest.fixture
def separate():
    grid = Grid(-4.0, 0.0, 0.1, 80, 80)
    maps = SimpleNamespace(grid=grid, occupancy=np.zeros((80, 80), np.float32), view=VIEW)
    return Separate(maps, TemplateTrackerParams(), 10.0)


def test_box_that_slid_in_full_view_is_a_body_of_its_own(separate):
    assert separate(at(0.0, 5.4, 1.17, spawned_m=(0.4, 5.4)), [])


def test_box_that_slid_while_hidden_in_part_begins_its_way_again(separate):
    box = at(0.0, 5.4, 1.17, spawned_m=(0.4, 5.4))
    assert not separate(box, [at(0.1, 3.0, 1.76)])
    assert box.spawned_m == box.at_m


def test_person_behind_a_person_is_a_body_of_its_own(separate):
    assert separate(at(0.0, 5.4, 1.7), [at(0.1, 3.0, 1.76)])


def test_person_beside_the_line_of_sight_hides_nothing(separate):
    box = at(0.0, 5.4, 1.17, spawned_m=(0.4, 5.4))
    assert separate(box, [at(1.5, 3.0, 1.76)])
    assert box.spawned_m == (0.4, 5.4)
