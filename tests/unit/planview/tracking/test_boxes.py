"""Boxes tracked in the image alone."""

import math

import numpy as np
import pytest

from planview.tracking.base import Observation
from planview.tracking.detections import BoxTracker
from planview.tracking.matching import overlaps
from planview.trajectories.detections import Detections
from planview.trajectories.state import TrackState

FPS = 10.0


def box(left: float, score: float = 0.9, height: float = 100.0) -> list[float]:
    return [left, 50.0, 0.4 * height, height, score]


def track(frames: list[list[list[float]]]) -> list[tuple[TrackState, ...]]:
    tracker = BoxTracker(Detections.of(frames), edge=0.05)
    return [tracker.update(Observation(i, i / FPS)) for i in range(len(frames))]


def ids(states: tuple[TrackState, ...]) -> set[int]:
    return {state.track_id for state in states if state.state == "confirmed"}


def test_overlap_is_intersection_over_union():
    boxes = np.array([[5.0, 5.0, 10.0, 10.0]])
    others = np.array([[5.0, 5.0, 10.0, 10.0], [10.0, 5.0, 10.0, 10.0], [50.0, 5.0, 10.0, 10.0]])
    np.testing.assert_allclose(overlaps(boxes, others), [[1.0, 50 / 150, 0.0]])


def test_a_walker_has_a_box_without_a_place():
    states = track([[box(10.0 * i)] for i in range(20)])
    assert set().union(*map(ids, states)) == {1}
    (last,) = states[-1]
    assert math.isnan(last.x_m) and last.box_px == pytest.approx((190.0, 50.0, 40.0, 100.0), abs=5.0)


def test_a_person_who_is_being_hidden_keeps_the_id_by_boxes_of_low_score():
    frames = [[box(5.0 * i, 0.3 if 10 <= i < 25 else 0.9)] for i in range(35)]
    assert all(ids(states) == {1} for states in track(frames))


def test_boxes_of_low_score_are_nobody():
    assert not any(track([[box(5.0 * i, score)] for i, score in enumerate([0.3, 0.35] * 10)]))


def test_box_that_comes_once_is_nobody():
    states = track([[box(0.0)], [box(0.0), box(300.0)], [box(0.0)], [box(0.0)]])
    assert [ids(s) for s in states] == [{1}] * 4 and len(states[-1]) == 1


@pytest.mark.parametrize(("back", "same"), [(17, True), (25, False)])
def test_a_person_without_a_box_is_the_same_again_within_a_second(back, same):
    states = track([[box(5.0 * i)] if i < 10 or i >= back else [] for i in range(30)])
    assert states[12] == () and len(ids(states[29])) == 1 and (ids(states[29]) == ids(states[9])) == same


def test_scores_without_meaning_count_as_sure():
    assert ids(track([[box(5.0 * i, 0.2)] for i in range(5)])[-1]) == {1}


def test_boxes_are_tracked_as_well_as_by_the_trackers_package():
    """In a development environment with ``pip install --no-deps trackers supervision``."""
    trackers = pytest.importorskip("trackers", reason="the package trackers is not installed")
    supervision = pytest.importorskip("supervision", reason="the package supervision is not installed")
    rng = np.random.default_rng(3)
    starts, speeds = rng.uniform(0, 400, 8), rng.uniform(-4, 4, 8)
    frames = [
        [box(start + i * speed + rng.normal()) for start, speed in zip(starts, speeds, strict=True)] for i in range(60)
    ]
    theirs, other = trackers.ByteTrackTracker(frame_rate=FPS), set()
    for frame in frames:
        rows = np.array(frame)
        corners = np.column_stack([rows[:, :2], rows[:, :2] + rows[:, 2:4]])
        found = theirs.update(supervision.Detections(xyxy=corners, confidence=rows[:, 4]))
        other |= {int(i) for i in found.tracker_id if i >= 0}
    assert len(set().union(*map(ids, track(frames)))) <= len(other)


@pytest.mark.parametrize(
    ("scores", "said"),
    [
        ((1, 1), ""),
        ((0.2, 0.9), "; scores count as probabilities"),
        ((3, 40), "; scores are not between 0 and 1, and are ignored"),
    ],
)
def test_boxes_are_summed_up_with_their_scores_where_they_have_some(scores, said):
    frames = [np.array([[10.0, 10.0, 20.0, 60.0, score]]) for score in scores]
    assert Detections.of(frames, "a/det.txt").summary == f"2 boxes in 2 frames of det.txt{said}"
