"""Image boxes of people, with numbers that can be checked by hand."""

import math

import numpy as np
import pytest

from calib.pose import SE3
from planview.engine.stereo import BODY_RADIUS_M, BodyBoxes
from planview.trajectories.state import TrackState
from stereo.depth import RectifiedGeometry

GEOMETRY = RectifiedGeometry(320, 240, 100.0, 100.0, 160.0, 120.0, 0.1)
LEVEL = SE3(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.array([0.0, 0.0, 1.0]))
"""A camera 1 m above the floor that looks along y."""
DOWN = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 3.0]))
"""A camera 3 m above the floor that looks straight down."""


def box(world_SE3_left: SE3, x_m: float, y_m: float, height_m: float) -> tuple[float, float, float, float]:
    track = TrackState(1, "confirmed", x_m, y_m, 0.0, 0.0, height_m)
    return BodyBoxes(GEOMETRY, world_SE3_left)(track).box_px


def test_box_of_a_person_ahead_spans_head_to_feet_of_the_near_side() -> None:
    r, near = BODY_RADIUS_M, 4.25 - BODY_RADIUS_M  # 4 m: 25 px per metre
    assert near == 4.0
    assert box(LEVEL, 0.0, 4.25, 2.0) == pytest.approx((160 - 25 * r, 120 - 25, 50 * r, 50))


def test_box_of_a_person_below_is_as_large_as_the_top_of_the_head() -> None:
    # The top is 1 m below the camera: 100 px per metre.
    assert box(DOWN, 0.0, 0.0, 2.0) == pytest.approx((160 - 25, 120 - 25, 50, 50))


def test_box_is_clipped_to_the_outer_edges_of_the_image() -> None:
    left, top, width, height = box(DOWN, 0.0, 0.0, 2.9)
    assert (left, top, width, height) == pytest.approx((-0.5, -0.5, 320, 240))


@pytest.mark.parametrize(("x_m", "y_m"), [(0.0, -5.0), (40.0, 5.0)])
def test_somebody_out_of_view_has_no_box(x_m: float, y_m: float) -> None:
    assert all(math.isnan(side) for side in box(LEVEL, x_m, y_m, 1.8))


def test_unknown_height_or_place_gives_no_box() -> None:
    for track in (TrackState(1, "lost"), TrackState(1, "confirmed", 0.0, 4.0)):
        assert BodyBoxes(GEOMETRY, LEVEL)(track) is track
