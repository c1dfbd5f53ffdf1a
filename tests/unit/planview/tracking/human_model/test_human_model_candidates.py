"""Where new people are looked for: bodies of which only every second row is foreground."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from planview.foreground.blobs import find_blobs
from planview.tracking.human_model.candidates import CandidateFinder, ModelCandidate
from planview.tracking.human_model.frame import SALIENT, ModelFrame
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.unclaimed import Unclaimed

PARAMS = HumanModelParams(map=HumanModelMapParams(min_height_px=12))
FROM_ABOVE = GroundCamera(160, 120, 100.0, 4.0, math.radians(3))
FROM_THE_SIDE = GroundCamera(160, 120, 120.0, 4.0, math.radians(62))


def _found(
    camera: GroundCamera, y_m: float, beside_m: float | None = None, times_s: Sequence[float] = (0.0,)
) -> list[ModelCandidate]:
    """What is found last of a body with gaps at (0, y_m), a known person so far beside it whose blob it touches."""
    scene = ModelScene(build_model_map(camera, params=PARAMS.map), PARAMS.match)
    evidence = np.zeros((120, 160), np.uint8)
    foot = camera.project((0.0, y_m, 0.0))
    scene.paint(evidence, foot, 1.0, int(SALIENT))
    evidence[1::2] = 0
    evidence[np.any(evidence > 0, axis=1).argmax() : round(foot[1]), round(foot[0])] = SALIENT
    if beside_m is not None:
        other = camera.project((beside_m, y_m, 0.0))
        scene.paint(scene.claimed, other, 1.0, 1)
        scene.paint(scene.cover, other, 1.0, 1)
        evidence[scene.claimed > 0] = SALIENT
    finder, unclaimed, motion = CandidateFinder(scene, PARAMS), Unclaimed(scene, PARAMS), np.full_like(evidence, 255)
    for now_s in times_s:
        frame = ModelFrame(now_s, None, evidence, motion, find_blobs(evidence))
        unclaimed.update(frame, 0.1)
        found = finder(frame, unclaimed)
    return found


def test_body_with_gaps_is_a_person_from_above() -> None:
    (candidate,) = _found(FROM_ABOVE, 0.5)
    assert 0.45 <= candidate.precision < 0.6


def test_body_with_gaps_that_lasts_may_be_a_person_from_the_side_too() -> None:
    (candidate,) = _found(FROM_THE_SIDE, 6.0, times_s=np.arange(0.0, 0.95, 0.1).tolist())
    assert not candidate.whole
    assert _found(FROM_THE_SIDE, 6.0, times_s=(0.0, 0.9)) == []


@pytest.mark.parametrize(("camera", "y_m", "beside_m"), [(FROM_THE_SIDE, 6.0, None), (FROM_ABOVE, 0.5, 0.35)])
def test_body_with_gaps_is_none_at_once_from_the_side_nor_beside_a_known_person(
    camera: GroundCamera, y_m: float, beside_m: float | None
) -> None:
    assert _found(camera, y_m, beside_m) == []
