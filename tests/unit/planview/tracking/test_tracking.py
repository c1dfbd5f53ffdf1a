"""What all trackers share."""

import json
import math

import numpy as np
import pytest
from toy_people import confirmed

from calib.errors import InputError
from planview.tracking.base import LifeCycle, Observation
from planview.tracking.detections import DetectionParams, DetectionTracker
from planview.tracking.kalman import FloorKalman
from planview.trajectories.detections import Detections, load_detections
from planview.trajectories.state import TrackState
from tests.human_model_world import CAMERA


def test_correlated_noise_gives_the_matrix_equations():
    kalman = FloorKalman.from_measurement(np.zeros(2), np.array([[0.04, 0.01], [0.01, 0.09]]), 1.5)
    state, covariance = np.zeros(4), np.diag([0.04, 0.09, 2.25, 2.25])
    covariance[0, 1] = covariance[1, 0] = 0.01
    dt, noise = 0.1, np.array([[0.05, -0.02], [-0.02, 0.03]])
    forward, push = np.eye(4), np.vstack([np.eye(2) * dt**2 / 2, np.eye(2) * dt])
    forward[0, 2] = forward[1, 3] = dt
    for k in range(1, 20):
        measured = np.array([0.1 * k, -0.05 * k])
        state, covariance = forward @ state, forward @ covariance @ forward.T + 4.0 * push @ push.T
        gain = covariance[:, :2] @ np.linalg.inv(covariance[:2, :2] + noise)
        state, covariance = state + gain @ (measured - state[:2]), covariance - gain @ covariance[:2]
        kalman = kalman.predict(dt, 2.0).correct(measured, noise)
    np.testing.assert_allclose(kalman.mean, state, atol=1e-12)
    np.testing.assert_allclose(kalman.covariance, covariance, atol=1e-12)


def test_certain_direction_follows_the_measurement():
    kalman = FloorKalman.from_measurement(np.zeros(2), np.eye(2), 0.0)
    found = kalman.correct(np.ones(2), np.diag([1e-9, 1e9]))
    assert found.at_m == pytest.approx((1.0, 0.0), abs=1e-6)


def test_kalman_grows_uncertain_without_measurements():
    state = FloorKalman.from_measurement(np.zeros(2), 0.05**2 * np.eye(2), 0.0)
    assert state.predict(0.5, 2.0).position_std_m == pytest.approx(np.hypot(0.05, 2.0 * 0.5**2 / 2))


def test_the_place_that_a_search_found_is_that_of_the_posterior():
    noise, start = np.array([[0.05, -0.02], [-0.02, 0.03]]), np.array([[0.04, 0.01], [0.01, 0.02]])
    kalman = FloorKalman.from_measurement(np.array([1.0, 2.0]), start, 1.0).predict(0.1, 2.0)
    measured = kalman.correct(np.array([1.2, 1.9]), noise)
    found = kalman.correct_to(measured.mean[:2], noise)
    np.testing.assert_allclose(found.mean, measured.mean)


@pytest.mark.parametrize("speed_mps", [1.0, 3.0, 5.0])
def test_a_runner_has_the_own_speed_after_half_a_second(speed_mps):
    kalman = FloorKalman.at(0.0, 0.0, 0.05)
    for n in range(1, 9):
        kalman = kalman.predict(1 / 15, 2.0).update(n / 15 * speed_mps, 0.0, 0.03)
    assert kalman.velocity_mps == pytest.approx((speed_mps, 0.0), rel=0.1)


def test_ids_are_given_in_order_of_confirmation():
    life = LifeCycle()
    life.begin(0.0)
    first, second, third = (life.spawn("a head") for _ in range(3))
    life.confirm(third, "tracked")
    life.confirm(first, "tracked")
    assert [who.track_id for who in (first, second, third)] == [2, -2, 1]
    given = [(d.track_id, d.was, d.reason) for d in life.decisions if d.kind == "confirmed"]
    assert given == [(1, -3, "was -3; tracked"), (2, -1, "was -1; tracked")]


def test_whoever_is_recognised_keeps_the_former_id():
    life = LifeCycle()
    life.begin(0.0)
    left, back, stranger = (life.spawn("a head") for _ in range(3))
    life.confirm(left, "tracked")
    back.track_id, was = left.track_id, back.track_id
    life.recognise(back, was, "the same clothes")
    life.confirm(stranger, "tracked")
    assert (back.track_id, back.state, stranger.track_id) == (1, "confirmed", 2)
    assert [d.reason for d in life.decisions if d.kind == "reacquired"] == ["was -2; the same clothes"]


def test_life_cycle_gives_the_reason_of_every_state():
    life = LifeCycle()
    life.begin(0.0)
    who = life.spawn("a head")
    assert who.state == "tentative"
    life.begin(1.0)
    life.confirm(who, "tracked")
    life.miss(who, "nothing there")
    assert who.state == "lost" and life.unobserved_s(who) == 1.0
    life.begin(2.0)
    life.observe(who, "found")
    assert who.state == "confirmed"
    assert [(d.kind, d.reason) for d in life.decisions] == [("reacquired", "found")]


FPS = 10.0


def box(x_m: float, y_m: float, height_m: float = 1.75, score: float = 1.0) -> list[float]:
    """Of a cylinder on the floor."""
    ring = [(x_m + 0.2 * math.cos(a), y_m + 0.2 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 32)]
    pixels = CAMERA.project(np.array([(x, y, z) for x, y in ring for z in (0.0, height_m)]))
    (left, top), (right, bottom) = pixels.min(axis=0), pixels.max(axis=0)
    return [left, top, right - left, bottom - top, score]


def track(frames: list[list[list[float]]]) -> list[tuple[TrackState, ...]]:
    tracker = DetectionTracker(Detections.of(frames), DetectionParams(), CAMERA)
    return [tracker.update(Observation(i, i / FPS)) for i in range(len(frames))]


def test_boxes_of_a_walker_are_one_person_where_it_walks():
    rows = [confirmed(states) for states in track([[box(-1.5 + 0.1 * i, 6.0)] for i in range(30)])]
    assert len(rows[-1]) == 1 and {state.track_id for row in rows for state in row} == {1}
    last = rows[-1][0]
    assert (last.x_m, last.y_m) == pytest.approx((1.4, 6.0), abs=0.15)
    assert (last.vx_mps, last.vy_mps) == pytest.approx((1.0, 0.0), abs=0.3)
    assert last.height_m == pytest.approx(1.75, abs=0.08)
    assert last.box_px == pytest.approx(tuple(box(1.4, 6.0)[:4]), abs=1e-9)


def test_people_who_cross_keep_their_ids():
    frames = [[box(-1.5 + 0.1 * i, 6.0), box(1.5 - 0.1 * i, 7.0)] for i in range(30)]
    states = track(frames)
    early, late = ({s.track_id: s.y_m for s in confirmed(states[i])} for i in (12, 29))
    assert early.keys() == late.keys() == {1, 2} and all(abs(early[i] - late[i]) < 0.4 for i in early)


def test_false_boxes_that_come_once_are_nobody():
    rng = np.random.default_rng(0)
    frames = [[box(rng.uniform(-2, 2), rng.uniform(4, 9))] if i % 4 == 0 else [] for i in range(40)]
    assert not any(confirmed(states) for states in track(frames))


def test_two_boxes_on_one_person_are_one():
    left, *rest = box(0.0, 6.0)
    assert len(track([[[left, *rest], [left + 1.5, *rest]]] * 20)[-1]) == 1


def test_a_person_without_boxes_is_lost_before_being_forgotten():
    states = track([[box(0.0, 6.0)] for _ in range(20)] + [[] for _ in range(60)])
    assert [s.state for s in states[22]] == ["lost"] and states[-1] == ()


def test_a_person_hidden_behind_another_is_kept():
    both = [[box(0.0, 5.0), box(0.9 - 0.03 * i, 6.0)] for i in range(28)]
    states = track(both + [[box(0.0, 5.0)]] * 25)  # two and a half seconds behind the one in front
    assert {s.track_id for s in states[-1]} == {1, 2}


def test_low_scores_confirm_nobody():
    sure = [[box(0.0, 6.0, score=0.9)] for _ in range(8)] + [[box(0.0, 6.0, score=0.2)]]
    doubted = [[box(0.0, 6.0, score=0.05)] for _ in range(8)] + [[box(0.0, 6.0, score=0.9)]]
    assert confirmed(track(sure)[-2]) and not confirmed(track(doubted)[-2])


def test_boxes_of_another_shape_are_refused():
    with pytest.raises(InputError, match="frame 1"):
        Detections.of([np.zeros((0, 4)), np.zeros((2, 3))])


def test_boxes_of_a_detector_are_read_from_every_format(tmp_path):
    (tmp_path / "det.txt").write_text("2,-1,10,20,30,60,0.9,-1,-1,-1\n1,-1,11,21,31,61,0.5\n")
    entries = [
        {"image_id": 2, "category_id": 1, "bbox": [10, 20, 30, 60], "score": 0.9},
        {"image_id": 1, "category_id": 1, "bbox": [11, 21, 31, 61], "score": 0.5},
        {"image_id": 1, "category_id": 3, "bbox": [0, 0, 9, 9], "score": 0.5},  # a car
    ]
    (tmp_path / "det.json").write_text(json.dumps(entries))
    expected = [np.array([[11, 21, 31, 61, 0.5]]), np.array([[10, 20, 30, 60, 0.9]])]
    for name in ("det.txt", "det.json"):
        found = load_detections(tmp_path / name)
        assert found.scored and len(found.frames) == 2
        for frame, boxes in zip(found.frames, expected, strict=True):
            np.testing.assert_array_equal(frame, boxes)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.txt", "-1,-1,10,20,30,60,1\n", "frame -1 10,20,30,60"),
        ("a.txt", "1,-1,10,20,-30,60,1\n", "frame 1 10,20,-30,60"),
        ("a.txt", "", "found none"),
        ("a.json", '[{"image_id": 1, "bbox": [1, 2, 3]}]', "entry 1"),
        ("a.json", '[{"image_id": 1,\n "bbox": [1, 2', "line 2"),
        ("a.json", '[{"image_id": 1, "bbox": [1, 2, 3, ' + "9" * 400 + "]}]", "entry 1"),
        ("a.json", "{}", "found an object"),
    ],
)
def test_a_bad_file_is_refused_with_the_place(tmp_path, name, text, expected):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as error:
        load_detections(tmp_path / name)
    assert expected in str(error.value) and "\n" not in str(error.value)
