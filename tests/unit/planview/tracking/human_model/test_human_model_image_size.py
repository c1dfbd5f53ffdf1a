"""How large people of other heights are in the image, beside the camera's own projection."""

import math

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from planview.tracking.human_model.image_size import ImageSizes
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.human_model.params import HumanMatchParams
from planview.tracking.human_model.scene import ModelScene
from tests.reference import human_model as reference

LOW = build_model_map(GroundCamera(160, 120, 85.0, 2.4, math.radians(5)), params=HumanModelMapParams(min_height_px=12))
HIGH = build_model_map(GroundCamera(160, 120, 120.0, 4.0, math.radians(62)), params=HumanModelMapParams())


@pytest.mark.parametrize("scale", [0.77, 0.9, 1.1])
def test_distance_of_head_and_foot_is_the_camera_s_where_it_hangs_low(scale: float) -> None:
    sizes, camera = ImageSizes(LOW), LOW.camera
    for entry in range(0, len(LOW), 97):
        head = camera.project(np.append(LOW.floor_m[entry], scale * LOW.model.height_m))
        average = math.dist(LOW.head_px[entry], LOW.foot_px[entry])
        if average > 5.0:
            expected = math.dist(head, LOW.foot_px[entry]) / average
            assert sizes.at(entry, scale) == pytest.approx(expected, rel=0.01)


def test_sizes_are_in_proportion_where_the_camera_hangs_high() -> None:
    assert ImageSizes(HIGH).at(50, 0.9) == 0.9


def test_tenth_of_the_height_is_a_third_of_the_size_under_a_camera_just_above_the_heads() -> None:
    scene = ModelScene(LOW, HumanMatchParams())
    below = LOW.camera.project(np.array([0.0, 0.0, 0.0]))
    # 0.9 (2.4 - 1.76) / (2.4 - 0.9 1.76), nearly straight down.
    assert scene.size(below, 0.9) == pytest.approx(0.71, abs=0.01)
    assert scene.size(below, 1.0) == 1.0


def test_height_is_told_from_the_size() -> None:
    sizes = ImageSizes(LOW)
    assert sizes.height_of(50, sizes.at(50, 0.9)) == pytest.approx(0.9)


def test_shorter_person_is_in_the_image_where_the_average_one_is_cut() -> None:
    scene = ModelScene(LOW, HumanMatchParams())
    cut = next(k for k in range(len(LOW)) if 0.85 < LOW.visibility[k] < 0.95)
    assert scene.visibility(LOW.foot_px[cut].astype(np.float64), 0.85) == 1.0


def test_part_of_a_taller_person_inside_the_image_is_that_of_the_outline() -> None:
    scene, scale = ModelScene(LOW, HumanMatchParams()), 1.02
    cut = next(k for k in range(len(LOW)) if 0.4 < LOW.visibility[k] < 0.6)
    foot = LOW.foot_px[cut].astype(np.float64)
    assert scene.visibility(foot, scale) == pytest.approx(float(LOW.visibility[cut]), abs=0.1)


@pytest.mark.parametrize(("u", "v", "scale"), [(80.0, 60.0, 0.85), (41.0, 30.0, 1.1), (120.0, 95.0, 0.77)])
def test_painted_model_under_a_low_camera_is_the_polygon(u: float, v: float, scale: float) -> None:
    scene, image = ModelScene(LOW, HumanMatchParams()), np.zeros((120, 160), np.uint8)
    scene.paint(image, np.array([u, v]), scale, 1)
    np.testing.assert_array_equal(image > 0, reference.model_mask(LOW, u, v, scale))
