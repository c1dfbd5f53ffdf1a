"""Feet and heads that tell where people are and how tall, on drawn silhouettes."""

import math

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from calib.types import F64
from planview.tracking.human_model import HumanModelParams
from planview.tracking.human_model.measurement import Extent
from planview.tracking.human_model.model_map import build_model_map
from planview.tracking.human_model.params import HumanMatchParams
from planview.tracking.human_model.refining import Ends, Refiner
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.target import Build, Target
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import LifeCycle

PARAMS = HumanModelParams(match=HumanMatchParams())
CAMERAS = {
    "kiosk": (GroundCamera(320, 240, 250.0, 1.3, math.radians(83)), (0.0, 4.0)),
    "lobby": (GroundCamera(320, 240, 250.0, 2.6, math.radians(72)), (0.3, 5.0)),
    "street": (GroundCamera(640, 480, 600.0, 7.0, math.radians(72)), (1.0, 20.0)),
}


def _refiner(camera: GroundCamera) -> Refiner:
    return Refiner(PARAMS, camera, ModelScene(build_model_map(camera, params=PARAMS.map), PARAMS.match))


def _target(camera: GroundCamera, xy_m: tuple[float, float]) -> Target:
    life = LifeCycle()
    life.begin(0.0)
    kalman = FloorKalman.at(*xy_m, 0.3, 1.0)
    return Target(life.spawn("test"), kalman, Build(1.0, np.array(xy_m)), camera.project((*xy_m, 0.0)))


def _head(camera: GroundCamera, x: float, y: float, scale: float) -> F64:
    return camera.project((x, y, scale * PARAMS.height_m))


@pytest.mark.parametrize("height", [0.95, 1.0, 1.03])
@pytest.mark.parametrize("name", CAMERAS)
def test_ends_tell_the_place_and_the_height(name: str, height: float) -> None:
    """Of a person 2 % farther away than the model."""
    camera, (x, y) = CAMERAS[name]
    foot, head = camera.project((x, y, 0.0)), _head(camera, x, y, 1.0)
    true_foot, true_head = camera.project((1.02 * x, 1.02 * y, 0.0)), _head(camera, 1.02 * x, 1.02 * y, height)
    axis = head - foot
    low, high = ((end @ axis) / (axis @ axis) for end in (true_foot - foot, true_head - head))
    ends = _refiner(camera)._ends(foot, Extent(axis, low, high, high, 1.0 + high - low), Build(1.0, np.array([x, y])))
    assert ends.height == pytest.approx(height, abs=3e-3)
    if height == 1.0:
        assert ends.shift == pytest.approx(low, abs=2e-3)


def test_feet_alone_place_people_before_a_camera_at_the_height_of_heads() -> None:
    camera = GroundCamera(320, 240, 250.0, PARAMS.height_m, math.radians(89.9))
    foot, head = camera.project((0.0, 4.0, 0.0)), _head(camera, 0.0, 4.0, 1.0)
    found = Extent(head - foot, 0.1, 0.02, 0.02, 0.92)
    assert _refiner(camera)._ends(foot, found, Build(1.0, np.zeros(2))) == pytest.approx(Ends(0.1, 1.02), abs=2e-3)


@pytest.mark.parametrize("name", CAMERAS)
def test_a_model_that_is_too_near_finds_the_person(name: str) -> None:
    camera, (x, y) = CAMERAS[name]
    refiner = _refiner(camera)
    evidence = np.zeros(camera.size[::-1], np.uint8)
    refiner.scene.paint(evidence, camera.project((x, y, 0.0)), 0.95, 2)
    target = _target(camera, (0.97 * x, 0.97 * y))
    position = target.foot_px.copy()
    target.stability = "stable"
    for _ in range(20):
        refiner.scene.clear()
        refiner.scene.paint(refiner.scene.cover, position, target.build.scale, 1)
        assert refiner(target, position, evidence, 0.1)
    off_m = math.dist(camera.back_project(position), (x, y))
    assert off_m < 0.02 * y
    assert target.build.scale == pytest.approx(0.95, abs=0.025)


@pytest.mark.parametrize(("height", "found"), [(0.97, True), (0.88, False)])
def test_a_model_that_has_left_its_body_returns_to_one_as_long_as_the_person(height: float, found: bool) -> None:
    """The feet are a third of the model below its own; a shadow or another person is seldom as long as the person."""
    camera, (x, y) = CAMERAS["kiosk"]
    refiner = _refiner(camera)
    evidence = np.zeros(camera.size[::-1], np.uint8)
    refiner.scene.paint(evidence, camera.project((x, y, 0.0)), height, 2)
    target = _target(camera, (1.32 * x, 1.32 * y))
    position = target.foot_px.copy()
    refiner.scene.paint(refiner.scene.cover, position, target.build.scale, 1)
    refiner(target, position, evidence, 0.1)
    assert (math.dist(camera.back_project(position), (x, y)) < 0.1 * y) == found
