"""Which pixels the tracker protects or gives back, on an image of one row."""

import numpy as np
import pytest

from planview.engine.config import FeedbackParams
from planview.engine.stereo import Feedback
from planview.foreground.params import BACKGROUND, NO_FEEDBACK, PERSON
from planview.maps.builder import FloorPoints
from planview.trajectories.state import State, TrackState

SHAPE = (1, 40)


def point(x_m: float, z_m: float, pixel: int) -> FloorPoints:
    xyz = np.array([[x_m, 0.0, z_m]], dtype=np.float32)
    return FloorPoints(xyz, np.ones(1, dtype=np.float32), np.array([pixel], dtype=np.int32))


def person(x_m: float, state: State = "confirmed", track_id: int = 1) -> TrackState:
    return TrackState(track_id, state, x_m, 0.0, 0.0, 0.0, 1.7)


def mask_after(feedback: Feedback, points: FloorPoints, *tracks: TrackState) -> list[int]:
    mask = feedback(points, tracks, SHAPE)
    assert mask is not None
    return [int(v) for v in mask[0]]


def walked(spread_px: int = 2) -> Feedback:
    feedback = Feedback(FeedbackParams(spread_px=spread_px))
    mask_after(feedback, point(0.0, 1.0, 20), person(0.0))
    return feedback


def test_body_of_a_track_that_has_walked_is_protected_and_widened():
    mask = mask_after(walked(), point(1.0, 1.0, 20), person(1.0))
    assert mask[18:23] == [PERSON] * 5
    assert mask.count(PERSON) == 5
    assert mask.count(NO_FEEDBACK) == 35


@pytest.mark.parametrize(
    ("where", "who", "expected"),
    [
        (point(0.2, 1.0, 20), person(0.2), {NO_FEEDBACK}),
        (point(1.0, 1.0, 20), person(1.0, "lost"), {NO_FEEDBACK}),
        (point(3.0, 1.0, 20), person(1.0), {NO_FEEDBACK}),
        (point(3.0, 0.05, 20), person(1.0), {NO_FEEDBACK, BACKGROUND}),
        (point(1.0, 0.05, 20), person(1.0), {NO_FEEDBACK, PERSON}),
    ],
    ids=["has not moved", "lost", "high, away from people", "low, away from people", "feet of a person"],
)
def test_foreground_is_a_persons_the_floors_or_left_to_the_model(where, who, expected):
    mask = mask_after(walked(), where, who)
    assert set(mask) == expected
    assert mask[20] == max(expected, key=lambda label: label != NO_FEEDBACK)
    assert mask.count(BACKGROUND) == (BACKGROUND in expected)


def test_track_that_comes_back_under_its_id_must_walk_again():
    feedback = walked()
    mask_after(feedback, point(1.0, 1.0, 20), person(1.0))
    mask_after(feedback, point(1.0, 1.0, 20))
    assert PERSON not in mask_after(feedback, point(1.0, 1.0, 20), person(1.0))


def test_reset_forgets_which_tracks_have_walked():
    feedback = walked()
    mask_after(feedback, point(1.0, 1.0, 20), person(1.0))
    feedback.reset()
    assert PERSON not in mask_after(feedback, point(1.0, 1.0, 20), person(1.0))


def test_ground_is_what_no_person_is_near_of_several():
    xyz = np.array([[1.0, 0.0, 0.05], [2.5, 0.0, 0.05], [4.0, 0.0, 0.05], [4.0, 0.0, 1.0]], dtype=np.float32)
    points = FloorPoints(xyz, np.ones(4, dtype=np.float32), np.array([5, 15, 25, 35], dtype=np.int32))
    feedback = Feedback(FeedbackParams(spread_px=0))
    mask_after(feedback, points, person(0.0), person(4.0, track_id=2))
    mask = mask_after(feedback, points, person(1.0), person(4.0, track_id=2))
    assert [mask[i] for i in (5, 15, 25, 35)] == [PERSON, BACKGROUND, NO_FEEDBACK, NO_FEEDBACK]


def test_feedback_that_is_off_gives_no_mask():
    assert Feedback(FeedbackParams(enabled=False))(point(0, 1, 2), [], SHAPE) is None
