"""Seated models laid on foreground of which the lower part is hidden, and people who are found again on a seat."""

import math

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from calib.types import U8
from planview.foreground.blobs import find_blobs
from planview.tracking.base import Observation
from planview.tracking.human_model import HumanModelParams, HumanModelTracker
from planview.tracking.human_model.frame import ModelFrame
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.human_model.params import NewTargetParams
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.sitters import SitterFinder
from planview.tracking.human_model.unclaimed import Unclaimed

CAMERA = GroundCamera(160, 120, 120.0, 3.0, math.radians(62))
PARAMS = HumanModelParams(map=HumanModelMapParams(min_height_px=12), spawn=NewTargetParams(min_height_px=12))
MAP = build_model_map(CAMERA, params=PARAMS.map)
SITTING = PARAMS.posture.sitting
NONE = np.zeros((120, 160), np.uint8)
FRONT, BACK = (0.0, 4.0), (0.25, 5.6)
"""Two seats, the second behind the first [m]."""


def _sitter(xy: tuple[float, float], shown: float, scale: float = SITTING) -> U8:
    """(H, W) evidence of the upper part of a person at a floor point."""
    scene, image = ModelScene(MAP, PARAMS.match), NONE.copy()
    scene.paint(image, CAMERA.project((*xy, 0.0)), scale, 2)
    rows = np.flatnonzero(image.any(axis=1))
    image[rows[0] + round(shown * len(rows)) :] = 0
    return image


def _finder() -> SitterFinder:
    return SitterFinder(ModelScene(MAP, PARAMS.match), PARAMS)


@pytest.mark.parametrize("shown", [0.4, 0.6, 1.0])
def test_sitter_is_found_where_the_head_tells_however_much_is_hidden(shown: float) -> None:
    evidence = _sitter(BACK, shown)
    sitter = _finder().on_region(evidence, NONE, find_blobs(evidence), 1)
    assert sitter is not None
    np.testing.assert_allclose(CAMERA.back_project(sitter.foot_px), BACK, atol=0.8)


def test_thing_in_the_open_is_no_sitter() -> None:
    scene, evidence = ModelScene(MAP, PARAMS.match), _sitter(FRONT, 0.5)
    finder = SitterFinder(scene, PARAMS)
    assert finder.on_region(evidence, NONE, find_blobs(evidence), 1) is not None
    for x in np.linspace(-0.4, 0.4, 9):
        foot = CAMERA.project((x, FRONT[1], 0.0))
        scene.clear()
        scene.paint(scene.cover, foot, 1.0, 1)
        scene.learn_hiding(scene.cover, foot, 1.0, 0.1)
    assert finder.on_region(evidence, NONE, find_blobs(evidence), 1) is None


def test_two_sitters_account_for_more_than_a_standing_model_over_both() -> None:
    evidence = np.maximum(_sitter(FRONT, 0.7), _sitter(BACK, 0.5))
    found = _finder().instead(CAMERA.project((0.1, 4.4, 0.0)), 1.0, evidence, NONE)
    assert found is not None
    assert found.back is not None
    assert found.gain > 0.15
    for sitter, place in ((found.front, FRONT), (found.back, BACK)):
        np.testing.assert_allclose(CAMERA.back_project(sitter.foot_px), place, atol=0.8)


@pytest.mark.parametrize("shown", [0.5, 0.7, 1.0])
def test_standing_person_is_no_pair_of_sitters_whatever_hides_the_legs(shown: float) -> None:
    evidence = _sitter(FRONT, shown, 1.0)
    found = _finder().instead(CAMERA.project((*FRONT, 0.0)), 1.0, evidence, NONE)
    assert found is None or found.gain <= 0.1


def test_region_that_moves_is_lively_and_one_without_motion_is_not() -> None:
    scene = ModelScene(MAP, PARAMS.match)
    unclaimed, evidence, motion = Unclaimed(scene, PARAMS), NONE.copy(), NONE.copy()
    evidence[20:40, 20:40] = evidence[20:40, 80:100] = 2
    motion[22, 22:27] = 255
    for k in range(30):
        unclaimed.update(ModelFrame(k / 10, None, evidence, motion, find_blobs(evidence)), 0.1)
    assert unclaimed.lively[unclaimed.blobs.labels[30, 30]]
    assert not unclaimed.lively[unclaimed.blobs.labels[30, 90]]
    stays, regions = unclaimed.resting()
    np.testing.assert_array_equal(stays, evidence)
    assert len(regions) == 3
    assert unclaimed.moves_on(regions.labels == regions.labels[30, 30])
    assert not unclaimed.moves_on(regions.labels == regions.labels[30, 90])


def test_what_a_person_left_has_not_moved_since_it_stays() -> None:
    unclaimed, evidence, motion = Unclaimed(ModelScene(MAP, PARAMS.match), PARAMS), NONE.copy(), NONE.copy()
    evidence[20:40, 20:40] = 2
    for k in range(30):
        motion[20:40, 20:40] = 255 * (k < 5)
        unclaimed.update(ModelFrame(k / 10, None, evidence, motion, find_blobs(evidence)), 0.1)
    assert unclaimed.lively[unclaimed.blobs.labels[30, 30]]
    assert not unclaimed.moves_on(evidence > 0)


def _sits_in_view(k: int) -> U8:
    """A person who walks in from the left and sits down at 2.5 s, with nothing hidden."""
    if k < 15:
        return _sitter((-2.5 + 0.1 * k, 4.5), 1.0, 1.0)
    return _sitter((-1.0, 4.5), 1.0, float(np.interp(k, (25, 35), (1.0, SITTING))))


def _enter_and_sit(k: int, seat: U8) -> U8:
    """A person who walks in for 2.5 s, is hidden for 4 s, and then sits with the legs hidden."""
    if k < 0 or 25 <= k < 65:
        return NONE
    return _sitter((2.5 - 0.08 * k, 5.6), 1.0, 1.0) if k < 25 else seat


def test_person_who_was_lost_is_found_again_on_a_seat_where_another_sits() -> None:
    tracker, seat, ids = HumanModelTracker(PARAMS, CAMERA, MAP), _sitter(BACK, 0.5), set()
    last, turned = NONE, NONE.copy()
    turned[np.nonzero(seat)[0][:20], np.nonzero(seat)[1][:20]] = 255
    for k in range(200):
        mask = np.maximum(_sits_in_view(k), _enter_and_sit(k - 90, seat))
        motion = np.where((mask != last) | (turned * (k % 5 == 0) > 0), 255, 0).astype(np.uint8)
        foreground, last = np.where(mask > 0, 255, 0).astype(np.uint8), mask
        states = tracker.update(Observation(k, k / 10, None, foreground, motion))
        ids |= {s.track_id for s in states if s.state == "confirmed"}
    assert len(ids) == 2
    assert [s.state for s in states] == ["confirmed", "confirmed"]
    assert min(math.hypot(s.x_m - BACK[0], s.y_m - BACK[1]) for s in states) < 0.8
