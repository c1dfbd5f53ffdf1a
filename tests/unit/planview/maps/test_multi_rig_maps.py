"""Maps of several heads: whose surface counts, and how they view a place together."""

import math

import numpy as np
import pytest

from calib.pose import SE3
from calib.types import F64
from planview.maps.builder import CameraViewpoint, FloorPoints, MapParams
from planview.maps.grid import Grid
from planview.maps.multi_rig import MultiRigMapBuilder, MultiRigViewpoint
from stereo.depth import RectifiedGeometry

GRID = Grid(-2.0, -2.0, 0.04, 100, 100)
GEOMETRY = RectifiedGeometry(320, 240, 230.0, 230.0, 159.5, 119.5, 0.15)
PARAMS = MapParams(smoothing_m=0.0)


def looking(at_m: tuple[float, float], heading_deg: float, height_m: float = 1.6) -> CameraViewpoint:
    """A level camera."""
    a = math.radians(heading_deg)
    ahead, right = np.array([math.cos(a), math.sin(a), 0.0]), np.array([math.sin(a), -math.cos(a), 0.0])
    pose = SE3(np.column_stack([right, [0.0, 0.0, -1.0], ahead]), np.array([*at_m, height_m]))
    return CameraViewpoint(pose.translation, 0.01, GEOMETRY.matrix @ pose.inverse().matrix[:3], GEOMETRY.size)


SOUTH, NORTH, WEST = looking((0.0, -3.0), 90), looking((0.0, 3.0), -90), looking((-3.0, 0.0), 0)


def points(xy: F64, area_m2: float = 0.5) -> FloorPoints:
    """An upright surface over some floor positions."""
    z = np.linspace(0.2, 1.7, len(xy))
    xyz = np.column_stack([xy, z]).astype(np.float32)
    return FloorPoints(xyz, np.full(len(xy), area_m2 / len(xy), np.float32), np.arange(len(xy), dtype=np.int32))


def side(x: float, y: float) -> FloorPoints:
    """What shows of a body: a line of cells."""
    return points(np.column_stack([np.linspace(x - 0.2, x + 0.2, 400), np.full(400, y)]))


def build(*heads: FloorPoints | None, views: tuple[CameraViewpoint, ...] = (SOUTH, NORTH)) -> MultiRigMapBuilder:
    return MultiRigMapBuilder([GRID] * len(heads), views, PARAMS)


def test_surface_of_one_head_counts_whole() -> None:
    alone = side(0.3, -0.1)
    maps = build(alone, None)([alone, None])
    assert maps.occupancy_raw.sum() == pytest.approx(0.5, rel=1e-4)
    np.testing.assert_array_equal(maps.points.area, alone.area)


def test_two_sides_of_a_body_count_as_the_side_that_shows_most() -> None:
    front, back = side(0.0, -0.12), side(0.0, 0.12)
    back.area[:] *= 0.5
    maps = build(front, back)([front, back])
    assert maps.occupancy_raw.sum() == pytest.approx(0.5, rel=0.01)
    rows = maps.occupancy_raw.sum(axis=1)
    assert (rows > 0).sum() == 2
    assert rows.max() == pytest.approx(2 * rows[rows > 0].min(), rel=0.05)


def test_bodies_that_different_heads_see_do_not_share() -> None:
    here, there = side(-1.0, 0.0), side(1.0, 0.0)
    maps = build(here, there)([here, there])
    assert maps.occupancy_raw.sum() == pytest.approx(1.0, rel=1e-4)


def test_a_body_hidden_from_one_head_keeps_its_surface() -> None:
    seen, rest = side(0.0, -0.12), side(0.0, 0.12)
    rest.area[:] *= 0.01
    maps = build(seen, rest)([seen, rest])
    assert maps.occupancy_raw.sum() == pytest.approx(0.5, rel=0.01)


def test_heights_are_the_highest_of_all_heads() -> None:
    low, high = side(0.0, 0.0), side(0.0, 0.0)
    low.xyz[:, 2] *= 0.5
    assert build(low, high)([low, high]).height_raw.max() == pytest.approx(1.7, abs=1e-6)


def test_offsets_of_opposite_heads_cancel() -> None:
    shares = np.full((2, *GRID.shape), 0.5, dtype=np.float32)
    view = MultiRigViewpoint((SOUTH, NORTH), GRID, shares)
    away, depression = view.viewing(np.array([[0.0, 0.0]]))
    assert away == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    assert depression == pytest.approx([0.0])


def test_offset_is_that_of_the_head_that_shows_a_person() -> None:
    shares = np.zeros((2, *GRID.shape), dtype=np.float32)
    shares[1] = 1.0
    view = MultiRigViewpoint((SOUTH, NORTH), GRID, shares)
    np.testing.assert_allclose(view.viewing(np.array([[0.3, 0.5]]))[0], NORTH.viewing(np.array([[0.3, 0.5]]))[0])


def test_footprint_covers_the_noise_along_both_rays() -> None:
    view = MultiRigViewpoint((SOUTH, WEST), GRID, np.zeros((2, *GRID.shape), dtype=np.float32))
    single = SOUTH.footprint(0.0, 0.0, 0.1)
    across, along, _ = view.footprint(0.0, 0.0, 0.1)
    assert single[1] > 1.5 * single[0]
    assert (across, along) == pytest.approx((single[1], single[1]), rel=1e-6)


def test_a_place_is_in_view_when_one_head_sees_it() -> None:
    view = MultiRigViewpoint((SOUTH, NORTH), GRID, np.zeros((2, *GRID.shape), dtype=np.float32))
    assert view.sees(0.0, -2.0, 1.6)
    assert view.sees(0.0, 2.5, 1.6)
    assert not view.sees(5.0, 0.0, 1.6)
