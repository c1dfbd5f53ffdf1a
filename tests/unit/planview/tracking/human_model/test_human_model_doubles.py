"""Two models on one person, and two people who hide one another, on drawn silhouettes."""

import math

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from calib.types import U8
from planview.tracking.human_model.doubles import Doubles
from planview.tracking.human_model.model_map import build_model_map
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.target import Build, Motion, Target
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import LifeCycle
from tests.human_model_world import CAMERA, MAP, PARAMS

DT_S = 0.1
SCENE = ModelScene(MAP, PARAMS.match)


def _targets(*places: tuple[float, float], motion: Motion = "moving", camera: GroundCamera = CAMERA) -> list[Target]:
    """Walkers at floor points [m], whose models share pixels."""
    life = LifeCycle()
    found = []
    for k, (x, y) in enumerate(places):
        life.begin(DT_S * k)
        kalman = FloorKalman.at(x, y, 0.1, 1.0)
        foot_px = camera.project((x, y, 0.0))
        found.append(Target(life.spawn("test"), kalman, Build(1.0, np.array([x, y])), foot_px, motion=motion))
        found[-1].shared = 0.3
    return found


def _people(*places: tuple[float, float]) -> U8:
    """(H, W) evidence of people at floor points [m]."""
    evidence = np.zeros((120, 160), np.uint8)
    for x, y in places:
        one = np.zeros_like(evidence)
        SCENE.paint(one, CAMERA.project((x, y, 0.0)), 1.0, 1)
        evidence[one > 0] = 2
    return evidence


def _found_after_s(targets: list[Target], evidence: U8, doubles: Doubles | None = None) -> float:
    """Time after which one is found to be the other's double [s], infinity if not within ten seconds."""
    doubles = doubles or Doubles(SCENE, PARAMS)
    for k in range(1, 101):
        found = doubles.find(targets, evidence, DT_S, lambda a, b: True)
        if found:
            assert found == [(targets[1], targets[0])]
            return k * DT_S
    return float("inf")


def test_two_models_on_one_person_become_the_older() -> None:
    targets = _targets((-0.12, 6.0), (0.12, 6.0))
    assert _found_after_s(targets, _people((0.0, 6.0))) == pytest.approx(PARAMS.settle_s, abs=DT_S)


def test_two_people_side_by_side_stay_two() -> None:
    places = (-0.2, 6.0), (0.2, 6.0)
    assert _found_after_s(_targets(*places), _people(*places)) == float("inf")


def test_those_who_have_been_apart_are_not_one_soon() -> None:
    targets, evidence = _targets((-0.12, 6.0), (0.12, 6.0)), _people((0.0, 6.0))
    doubles = Doubles(SCENE, PARAMS)
    targets[0].shared = 0.0
    assert _found_after_s(targets, evidence, doubles) == float("inf")
    targets[0].shared = 0.3
    after_s = PARAMS.settle_s + PARAMS.existence.patience_s
    assert _found_after_s(targets, evidence, doubles) == pytest.approx(after_s, abs=2 * DT_S)


def test_people_in_file_stay_two() -> None:
    assert _found_after_s(_targets((0.0, 6.0), (0.0, 7.2)), _people((0.0, 6.0))) == float("inf")


def test_people_who_stand_do_not_become_one() -> None:
    targets = _targets((-0.12, 6.0), (0.12, 6.0), motion="stopped")
    assert _found_after_s(targets, _people((0.0, 6.0))) == float("inf")


def test_an_arm_is_no_newcomer_and_who_is_beside_it_is() -> None:
    """Under a camera at the height of elbows, where an arm 2 m away is as large as a person 7 m away."""
    camera = GroundCamera(320, 240, 250.0, 1.3, math.radians(85))
    scene = ModelScene(build_model_map(camera, params=PARAMS.map), PARAMS.match)
    near = _targets((0.0, 2.0), camera=camera)
    doubles, everywhere = Doubles(scene, PARAMS), np.full((240, 320), 2, np.uint8)

    def is_limb(x: float, y: float) -> bool:
        return doubles.is_limb(np.array([*camera.project((x, y, 0.0)), 1.0]), near, everywhere)

    assert is_limb(0.33 * 3.5, 7.0)
    assert not is_limb(0.7 * 3.5, 7.0)
    assert not is_limb(0.6, 2.2)


def test_a_leg_behind_is_no_newcomer_and_who_follows_is() -> None:
    """Seen from above, where a stride reaches far out of an upright model."""
    camera = GroundCamera(320, 240, 200.0, 4.0, math.radians(30))
    scene = ModelScene(build_model_map(camera, params=PARAMS.map), PARAMS.match)
    first, second = _targets((0.0, 2.0), (0.0, 1.3), camera=camera)
    doubles, evidence = Doubles(scene, PARAMS), np.zeros((240, 320), np.uint8)
    scene.paint(evidence, first.foot_px, 1.0, 2)
    leg = np.array([first.foot_px, camera.project((0.0, 1.6, 0.0))]).round().astype(int)
    evidence[leg[0, 1] : leg[1, 1], leg[0, 0] - 4 : leg[0, 0] + 4] = 2
    assert doubles.is_limb(np.array([*second.foot_px, 1.0]), [first], evidence)
    scene.paint(evidence, second.foot_px, 1.0, 2)
    assert not doubles.is_limb(np.array([*second.foot_px, 1.0]), [first], evidence)
