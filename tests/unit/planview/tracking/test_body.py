"""How a body looks along rays."""

import math

import numpy as np
import pytest

from calib.types import F64
from planview.tracking.body import CHEST_DEPTH, FACINGS, LEAN_M, TORSO, body_table, enter_cylinders, thing_tables

TABLE = body_table()
LEVEL, DOWN = (round((math.radians(deg) - TABLE.angle_min_rad) / TABLE.angle_step_rad) for deg in (0.0, 90.0))
CHEST = ((0.0, 1.0, TORSO.torso_radius_m, CHEST_DEPTH),)


def middle(cover: F64) -> F64:
    """(2,) centre of what is covered, to the left and up [m]."""
    u, w = (TABLE.cell_m * (np.arange(n) + 0.5 - n / 2) for n in cover.shape)
    return np.array([(cover.sum(axis=1) * u).sum(), (cover.sum(axis=0) * w).sum()]) / cover.sum()


@pytest.mark.parametrize(("turn", "before_m"), [(0.0, CHEST_DEPTH), (math.pi / 2, 1.0), (math.pi, CHEST_DEPTH)])
def test_a_level_ray_enters_a_chest_its_half_depth_or_half_breadth_before_the_axis(turn, before_m):
    enter = enter_cylinders(0.0, np.zeros((1, 1)), np.zeros((1, 1)), CHEST, turn)
    assert -enter == pytest.approx(before_m * TORSO.torso_radius_m)


def test_a_ray_misses_a_chest_seen_from_the_side_where_it_hits_one_seen_from_the_front():
    beside = np.full((1, 1), 0.9 * TORSO.torso_radius_m)
    front, side = (enter_cylinders(0.0, beside, np.zeros((1, 1)), CHEST, turn) for turn in (0.0, math.pi / 2))
    assert np.isfinite(front) and not np.isfinite(side)


def test_a_chest_that_leans_is_half_as_far_ahead_as_the_head():
    above = np.full((1, 1), (0.9 - 0.5) * TORSO.height_m)
    head = ((0.85, 1.0, 0.08, 1.0),)
    upright, leant = (enter_cylinders(0.0, np.zeros((1, 1)), above, head, 0.0, lean) for lean in (0.0, 0.2))
    assert leant - upright == pytest.approx(0.2)
    chest = ((0.7, 0.8, 0.2, 1.0),)
    upright, leant = (enter_cylinders(0.0, np.zeros((1, 1)), above - 0.25, chest, 0.0, lean) for lean in (0.0, 0.2))
    assert leant - upright == pytest.approx(0.1)


def test_from_above_a_body_is_twice_as_broad_as_deep_whichever_way_it_faces():
    across, along = (TABLE.cover[way, DOWN] > 0.5 for way in (0, FACINGS // 4))
    assert across.any(axis=1).sum() > 1.5 * across.any(axis=0).sum()
    np.testing.assert_array_equal(across.any(axis=1).sum(), along.any(axis=0).sum())


def test_a_body_that_faces_left_is_the_mirror_image_of_one_that_faces_right():
    for way in range(FACINGS):
        np.testing.assert_array_equal(TABLE.cover[way], TABLE.cover[-way % FACINGS][:, ::-1])


def test_a_lean_moves_what_is_seen_towards_where_the_person_faces():
    ahead = middle(TABLE.cover[FACINGS, DOWN]) - middle(TABLE.cover[0, DOWN])
    left = middle(TABLE.cover[FACINGS + FACINGS // 4, DOWN]) - middle(TABLE.cover[FACINGS // 4, DOWN])
    assert ahead[1] == pytest.approx(left[0], abs=0.01) and 0.15 * LEAN_M < ahead[1] < LEAN_M
    assert abs(ahead[0]) < 0.01 and abs(left[1]) < 0.01


def test_from_above_the_head_is_a_head_higher_than_the_shoulders():
    row = TABLE.front[0, DOWN, :, TABLE.front.shape[3] // 2]
    head, shoulder = row[len(row) // 2], row[len(row) // 2 + 5]
    assert head == pytest.approx(TORSO.height_m / 2, abs=0.03)
    assert shoulder == pytest.approx((0.8 - 0.5) * TORSO.height_m, abs=0.05)
    assert ((np.abs(row - head) < 0.03) | (row < shoulder + 0.05)).all()


def test_the_body_table_is_a_head_over_shoulders_over_legs():
    def width(rel):
        w = int(((rel - 0.5) * TORSO.height_m - TABLE.w_min_m) / TABLE.cell_m)
        return float(TABLE.cover[0, LEVEL, :, w].sum()) * TABLE.cell_m

    assert width(0.92) == pytest.approx(0.15, abs=0.02) and 0.42 < width(0.65) < 0.52
    assert 0.24 < width(0.2) < 0.35  # legs, and the stride that is now and then next to them
    assert width(1.1) < 0.02


def test_things_are_as_wide_to_the_left_as_to_the_right():
    for table in thing_tables():
        np.testing.assert_allclose(table.cover[0], table.cover[0, :, ::-1], atol=1e-6)


def test_a_flat_thing_is_narrow_from_its_edge():
    flat = thing_tables()[-1]
    ahead, edge = (flat.cover[way, 6].sum() for way in (0, FACINGS // 4))
    assert edge < 0.5 * ahead


def test_nothing_is_below_a_carried_thing():
    level = thing_tables()[-2].cover[0, 6]
    assert level[:, :44].max() < 0.01
