import numpy as np
import pytest

from calib.types import F64
from planview.maps.builder import CameraViewpoint, FloorPoints
from planview.tracking.base import Observation
from planview.tracking.body_axis import BodyAxis
from planview.tracking.harville import TemplateTracker
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState
from tests.unit.planview.tracking.overhead import Person, observe


def follow(tracker: TemplateTracker, frames: list[list[Person]], start: int = 0) -> list[tuple[TrackState, ...]]:
    return [tracker.update(observe(start + i, people)) for i, people in enumerate(frames)]


def walk(x0: float, x1: float, y: float, n: int, height: float = 1.75) -> list[Person]:
    return [(x, y, height) for x in np.linspace(x0, x1, n)]


def confirmed(tracks: tuple[TrackState, ...]) -> list[TrackState]:
    return [track for track in tracks if track.state == "confirmed"]


def kinds(tracker: TemplateTracker) -> set[str]:
    return {decision.kind for decision in tracker.decisions}


def test_somebody_new_is_tentative_then_confirmed() -> None:
    results = follow(TemplateTracker(), [[p] for p in walk(-1.0, 0.0, 0.0, 8)])
    assert [tracks[0].state for tracks in results] == ["tentative"] * 4 + ["confirmed"] * 4


def test_tracker_reports_head_position_height_and_velocity() -> None:
    results = follow(TemplateTracker(), [[p] for p in walk(-1.0, 1.0, 0.3, 20)])
    (track,) = results[-1]
    assert (track.x_m, track.y_m) == pytest.approx((1.0, 0.3), abs=0.06)
    assert track.height_m == pytest.approx(1.75, abs=0.05)
    assert (track.vx_mps, track.vy_mps) == pytest.approx((2.0 / 1.9, 0.0), abs=0.15)


def test_tracker_keeps_ids_when_two_people_pass_each_other() -> None:
    pairs = zip(walk(-1.2, 1.2, -0.3, 30, 1.6), walk(1.2, -1.2, 0.3, 30, 1.85), strict=True)
    results = follow(TemplateTracker(), [list(pair) for pair in pairs])
    ends = {track.track_id: (track.x_m, track.height_m) for track in results[-1]}
    assert len(ends) == 2
    for track in results[6]:
        assert np.sign(track.x_m) == -np.sign(ends[track.track_id][0])


def test_lost_person_who_comes_back_keeps_his_id() -> None:
    tracker = TemplateTracker()
    seen = [[p] for p in walk(-0.8, 0.0, 0.0, 10)]
    results = follow(tracker, seen + [[]] * 8)
    assert results[-1][0].state == "lost"
    back = follow(tracker, [[p] for p in walk(0.5, 0.9, 0.2, 4)], start=18)
    assert [track.track_id for track in confirmed(back[-1])] == [results[0][0].track_id]


def test_lost_person_is_removed_after_four_seconds() -> None:
    tracker = TemplateTracker()
    results = follow(tracker, [[p] for p in walk(-0.4, 0.0, 0.0, 10)] + [[]] * 41)
    assert results[-2][0].state == "lost"
    assert results[-1] == ()
    assert kinds(tracker) == {"pruned"}


def test_who_enters_where_a_person_left_the_view_is_not_that_person_for_the_place() -> None:
    tracker = TemplateTracker()
    first = follow(tracker, [[p] for p in walk(0.5, 1.6, 0.0, 12)] + [[]] * 12)
    assert first[-1][0].state == "lost"
    entered = follow(tracker, [[(1.6, 0.0, 1.75)]], start=24)[0]
    states = {track.track_id: track.state for track in entered}
    assert states == {1: "lost", 2: "tentative"}


def test_person_hidden_at_the_border_for_a_moment_is_matched_there() -> None:
    tracker = TemplateTracker()
    follow(tracker, [[p] for p in walk(0.5, 1.5, 0.0, 12)] + [[]] * 6)
    back = follow(tracker, [[(1.55, 0.0, 1.75)]], start=18)[0]
    assert [track.track_id for track in confirmed(back)] == [1]


def test_newcomer_taller_than_the_lost_person_is_somebody_else() -> None:
    tracker = TemplateTracker()
    first = follow(tracker, [[p] for p in walk(-0.8, 0.0, 0.0, 10, 1.5)] + [[]] * 8)
    back = follow(tracker, [[p] for p in walk(0.5, 0.9, 0.2, 8, 1.9)], start=18)
    assert {track.track_id for track in confirmed(back[-1])}.isdisjoint({first[0][0].track_id})


def test_tentative_track_is_dropped_at_its_first_miss() -> None:
    results = follow(TemplateTracker(), [[(0.0, 0.0, 1.75)], []])
    assert results[1] == ()


def test_what_is_lower_than_a_small_child_is_never_tracked() -> None:
    results = follow(TemplateTracker(), [[p] for p in walk(-1.0, 1.0, 0.0, 20, 0.75)])
    assert all(tracks == () for tracks in results)


def test_chair_that_stands_still_is_never_confirmed() -> None:
    results = follow(TemplateTracker(), [[(0.2, 0.1, 1.05)]] * 30)
    assert not any(confirmed(tracks) for tracks in results)


def test_child_that_walks_is_a_person() -> None:
    results = follow(TemplateTracker(), [[p] for p in walk(-1.0, 1.0, 0.0, 20, 1.05)])
    assert [track.height_m for track in confirmed(results[-1])] == [pytest.approx(1.05, abs=0.08)]


def test_chair_that_a_person_pushes_and_leaves_is_never_confirmed() -> None:
    pushing = [[p, (p[0] + 0.6, 0.0, 1.05)] for p in walk(-1.4, 0.0, 0.0, 20)]
    leaving = [[p, (0.6, 0.0, 1.05)] for p in walk(0.0, -1.4, 0.0, 20)]
    results = follow(TemplateTracker(), pushing + leaving)
    assert all(len(confirmed(tracks)) <= 1 for tracks in results)


def test_person_who_sits_down_stays_tracked() -> None:
    heights = np.r_[np.full(8, 1.75), np.linspace(1.75, 1.3, 8), np.full(8, 1.3)]
    results = follow(TemplateTracker(), [[(0.2, 0.1, float(h))] for h in heights])
    assert [track.state for track in results[-1]] == ["confirmed"]
    assert results[-1][0].height_m == pytest.approx(1.3, abs=0.08)


def test_every_decision_has_a_reason() -> None:
    tracker = TemplateTracker()
    told = set()
    for i, people in enumerate([[p] for p in walk(-0.4, 0.0, 0.0, 10)] + [[]] * 41):
        tracker.update(observe(i, people))
        told |= kinds(tracker)
        assert all(decision.reason for decision in tracker.decisions)
    assert told == {"spawned", "matched", "confirmed", "lost", "pruned"}


def test_ids_start_again_after_reset() -> None:
    tracker = TemplateTracker()
    follow(tracker, [[(0.0, 0.0, 1.75)]])
    tracker.reset()
    assert follow(tracker, [[(0.5, 0.5, 1.75)]])[0][0].track_id == 1


def test_debug_shows_search_and_templates() -> None:
    tracker = TemplateTracker()
    follow(tracker, [[(0.0, 0.0, 1.75)]] * 3)
    debug = tracker.debug()
    assert {drawing.name for drawing in debug.drawings} == {"search", "template"}
    assert set(debug.tiles) == {"template/1/height", "template/1/occupancy"}


def test_tracker_refuses_an_observation_without_maps() -> None:
    with pytest.raises(ValueError, match="plan-view maps"):
        TemplateTracker().update(Observation(0, 0.0))


def test_tracker_refuses_time_that_runs_backwards() -> None:
    tracker = TemplateTracker()
    follow(tracker, [[(0.0, 0.0, 1.75)]], start=5)
    with pytest.raises(ValueError, match="time to advance"):
        tracker.update(observe(2, []))


def _camera_at(place_m: F64) -> CameraViewpoint:
    return CameraViewpoint(place_m, 0.01, np.eye(3, 4), (160, 120))


def test_axis_lies_behind_the_visible_half_of_a_head() -> None:
    """A sphere of radius 0.095 m at 3 m, seen horizontally: its visible half is centred 6.3 cm too near."""
    rng = np.random.default_rng(0)
    radius, centre, camera = 0.095, np.array([0.0, 3.0, 1.6]), np.array([0.0, 0.0, 1.6])
    offset = rng.uniform(-radius, radius, (20000, 2))
    offset = offset[(offset**2).sum(axis=1) < radius**2]
    near = np.sqrt(radius**2 - (offset**2).sum(axis=1))
    xyz = (centre + np.column_stack([offset[:, 0], -near, offset[:, 1]])).astype(np.float32)
    area = np.full(len(xyz), np.pi * radius**2 / len(xyz), np.float32)
    points = FloorPoints(xyz, area, np.arange(len(xyz), dtype=np.int32))
    (measured,) = BodyAxis(_camera_at(camera), 2.4)(points, np.array([[0.0, 2.95]]), 0.5)
    assert measured.from_head
    assert (measured.x_m, measured.y_m) == pytest.approx((0.0, 3.0), abs=0.005)
    assert measured.height_m == pytest.approx(1.695, abs=0.015)


def test_axis_of_nobody_seen_is_unknown() -> None:
    nothing = FloorPoints(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int32))
    (measured,) = BodyAxis(_camera_at(np.array([0.0, 0.0, 2.5])), 2.4)(nothing, np.array([[0.0, 1.0]]), 0.5)
    assert np.isnan(measured.x_m) and np.isnan(measured.height_m)


def test_kalman_learns_a_constant_velocity() -> None:
    state = FloorKalman.at(0.0, 0.0, 0.05, 1.0)
    for i in range(1, 40):
        state = state.predicted(0.1, 0.5).updated(0.1 * i, -0.05 * i, 0.05)
    assert (state.vx_mps, state.vy_mps) == pytest.approx((1.0, -0.5), abs=0.02)
    assert state.position_std_m < 0.05


def test_kalman_grows_uncertain_without_measurements() -> None:
    state = FloorKalman.at(0.0, 0.0, 0.05, 0.0)
    assert state.predicted(0.5, 2.0).position_std_m == pytest.approx(np.hypot(0.05, 2.0 * 0.5**2 / 2))


def test_match_score_is_the_sum_of_the_terms_kept_with_its_decision() -> None:
    tracker = TemplateTracker()
    follow(tracker, [[p] for p in walk(-1.0, 0.0, 0.0, 8)])
    (matched,) = (decision for decision in tracker.decisions if decision.kind == "matched")
    assert sum(matched.terms) == pytest.approx(matched.value)
    assert matched.terms.height > 0
