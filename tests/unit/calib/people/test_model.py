"""The cylinder person and its projection."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.ground_camera import GroundCamera
from calib.people.model import HULL_POINTS, HumanModel
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map, visible_fraction

OBLIQUE = GroundCamera(160, 120, 150.0, 4.0, math.radians(60))
OVERHEAD = GroundCamera(160, 120, 100.0, 4.0, 0.0)
COARSE = HumanModelMapParams(step_px=8)


def test_model_has_the_papers_sizes() -> None:
    model = HumanModel()
    assert model.height_m == pytest.approx(1.76)
    assert model.planes == ((0.0, 0.12), (0.79, 0.21), (pytest.approx(1.49), 0.21), (pytest.approx(1.76), 0.09))


def test_scaled_model_keeps_its_proportions() -> None:
    model = HumanModel().scaled(0.88)
    assert model.height_m == pytest.approx(0.88)
    assert model.torso_radius_m == pytest.approx(0.105)


def test_model_refuses_sizes_that_are_not_positive() -> None:
    with pytest.raises(ValueError, match="positive"):
        HumanModel(head_m=0.0)


def test_straight_down_view_of_a_person_below_is_the_shoulder_circle() -> None:
    # Shoulders at 1.49 m are 2.51 m below the camera: radius 100 * 0.21 / 2.51 = 8.37 px.
    box = HumanModel().boxes(OVERHEAD, (0.0, 0.0))
    np.testing.assert_allclose(box, [79.5 - 8.367, 59.5 - 8.367, 16.733, 16.733], atol=1e-3)


def test_head_is_above_the_foot_in_an_oblique_view() -> None:
    model = HumanModel()
    head, foot = model.head(OBLIQUE, (0.5, 6.0)), model.foot(OBLIQUE, (0.5, 6.0))
    np.testing.assert_allclose(foot, OBLIQUE.project((0.5, 6.0, 0.0)))
    assert head[1] < foot[1] - 20


def test_hull_is_the_convex_hull_of_the_circles() -> None:
    model = HumanModel()
    points = model.outline_points(OBLIQUE, (0.5, 6.0)).astype(np.float32)
    exact = cv2.contourArea(cv2.convexHull(points))
    hull = model.hull(OBLIQUE, 0.5, 6.0).astype(np.float32)
    assert hull.shape == (HULL_POINTS, 2)
    assert 0.99 * exact <= cv2.contourArea(hull) <= exact


def test_hulls_of_many_positions_equal_single_ones() -> None:
    model, xy = HumanModel(), np.array([[[0.0, 5.0], [1.0, 7.0]]])
    hulls = model.hulls(OBLIQUE, xy)
    assert hulls.shape == (1, 2, HULL_POINTS, 2)
    np.testing.assert_array_equal(hulls[0, 1], model.hull(OBLIQUE, 1.0, 7.0))


def test_hull_of_a_person_behind_the_camera_is_nan() -> None:
    assert np.isnan(HumanModel().hull(OBLIQUE, 0.0, -9.0)).all()


@given(
    st.floats(-1.4, 1.4), st.floats(2.2, 8.0), st.floats(-20, 20), st.floats(-20, 40), st.sampled_from([0.9, 1.76, 2.1])
)
def test_box_encloses_hull_head_and_foot(tilt: float, height: float, x: float, y: float, person: float) -> None:
    camera = GroundCamera(320, 240, 300.0, height, tilt)
    model = HumanModel().scaled(person)
    hull = model.hull(camera, x, y)
    if np.isfinite(hull).all():
        left, top, width, high = model.boxes(camera, (x, y))
        points = np.vstack([hull, model.head(camera, (x, y)), model.foot(camera, (x, y))])
        slack = 1e-6 * (1 + np.abs(hull).max())
        assert (points >= [left - slack, top - slack]).all()
        assert (points <= [left + width + slack, top + high + slack]).all()


def test_visible_fraction_of_squares() -> None:
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    shifts = np.array([[2, 2], [-2.5, 2], [-2.5, -2.5], [-9, 2], [9.5, 5.5]])
    fractions = visible_fraction(square + shifts[:, None], 12, 8)
    np.testing.assert_allclose(fractions, [1.0, 0.5, 0.25, 0.0, 0.25])


def test_map_has_entries_only_on_the_visible_floor() -> None:
    model_map = build_model_map(OBLIQUE, params=COARSE)
    horizon = 59.5 - 150.0 / math.tan(math.radians(60))
    assert model_map.foot_px[:, 1].min() > horizon
    assert (np.linalg.norm(model_map.floor_m, axis=1) <= 60.0).all()
    assert (model_map.visibility > 0.05).all()
    assert model_map.entry_at((80.0, horizon - 9.0)) == -1


def test_map_entries_are_the_model_at_the_pixel() -> None:
    model_map = build_model_map(OBLIQUE, params=COARSE)
    entry = int(model_map.entry_at((83.0, 66.0)))
    u, v = model_map.foot_px[entry]
    assert abs(u - 83) <= 4 and abs(v - 66) <= 4
    floor = OBLIQUE.back_project((u, v))
    np.testing.assert_allclose(model_map.floor_m[entry], floor, rtol=1e-5)
    np.testing.assert_allclose(model_map.head_px[entry], HumanModel().head(OBLIQUE, floor), rtol=1e-5)
    np.testing.assert_allclose(model_map.hull_px[entry], HumanModel().hull(OBLIQUE, *floor), rtol=1e-4)


def test_map_reaches_feet_outside_the_image() -> None:
    model_map = build_model_map(OBLIQUE, params=COARSE)
    assert model_map.foot_px[:, 1].max() > 130
    assert model_map.visibility.max() == 1.0


def test_map_refuses_a_grid_beyond_its_limit() -> None:
    with pytest.raises(ValueError, match="enlarge step_px"):
        build_model_map(GroundCamera(4000, 3000, 3000.0, 4.0, 1.0), params=HumanModelMapParams(step_px=1))
