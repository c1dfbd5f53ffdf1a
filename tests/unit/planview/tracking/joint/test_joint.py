"""The joint tracker."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from toy_people import confirmed, look_at, oblique_camera, observed

from planview.maps.view import SURFACE, UNKNOWN
from planview.tracking import body
from planview.tracking.base import Observation
from planview.tracking.explain.explanation import upright_pose
from planview.tracking.explain.person import Glimpse, Person
from planview.tracking.joint import JointTracker
from planview.tracking.joint.ranges import hide_outlines
from planview.trajectories.state import TrackState

CAMERA = oblique_camera()
Scene = Callable[[float], Sequence[tuple[float, ...]]]


def follow(
    scene: Scene, seconds: float, fps: float = 15.0, codes: Sequence[int] = (), table: body.BodyTable | None = None
) -> list[tuple[TrackState, ...]]:
    tracker = JointTracker()
    times = np.arange(0.0, seconds, 1.0 / fps)
    return [tracker.update(observed(n, float(t), look_at(CAMERA, scene(t), codes, table))) for n, t in enumerate(times)]


def show(tracker: JointTracker, frame: int, *people: tuple[float, ...]) -> tuple[TrackState, ...]:
    """The states after a frame, at 15 per second, that shows people."""
    return tracker.update(observed(frame, frame / 15, look_at(CAMERA, people)))


def test_nobody_is_found_in_an_empty_room():
    assert not any(follow(lambda t: [], 1.0))


def test_observation_without_pixels_is_refused():
    with pytest.raises(ValueError, match="pixels"):
        JointTracker().update(Observation(0, 0.0))


def test_what_never_changes_is_no_person():
    frames = follow(lambda t: [(0.0, 3.0, 1.75)] if t > 0.3 else [], 4.0)
    assert frames[-1] and not any(confirmed(states) for states in frames)


def test_surface_beside_somebody_nearer_is_no_evidence():
    view = look_at(CAMERA, [(0.0, 2.0, 1.75)])
    person = view.kind == SURFACE
    strip = np.roll(person, 2, axis=1) & ~person
    view.range_m[strip] = 6.0
    kind = hide_outlines(replace(view, kind=np.where(strip, SURFACE, view.kind))).kind
    assert ((kind == UNKNOWN) == strip).all()


def test_a_thing_is_tried_once_as_long_as_it_does_not_change():
    tracker, spawned = JointTracker(), 0
    for n in range(60):
        show(tracker, n, *[(0.0, 3.0, 0.8)] * (n > 4))
        spawned += sum(d.kind == "spawned" for d in tracker.decisions)
    assert spawned <= 1


def test_who_stops_walking_stays_confirmed():
    frames = follow(lambda t: [(min(-1.0 + 1.2 * t, 0.0), 3.0, 1.75)], 4.0)
    assert len(confirmed(frames[-1])) == 1


@pytest.mark.parametrize(("height_m", "people"), [(1.75, 1), (1.1, 0)])
def test_what_moves_by_a_metre_is_a_person_when_tall(height_m, people):
    frames = follow(lambda t: [(min(-0.6 + 1.2 * t, 0.4), 3.0, height_m)], 3.0)
    assert len(confirmed(frames[-1])) == people


@pytest.mark.parametrize("height_m", [0.9, 1.05, 1.3, 1.75])
@pytest.mark.parametrize("width", [1, 2, 4, 5])
def test_a_pushed_box_is_no_person_of_any_height(height_m, width):
    table = body.thing_tables()[width]
    frames = follow(lambda t: [(min(-1.0 + 0.8 * t, 1.0), 3.2, height_m)], 4.0, table=table)
    assert frames[-1] and not any(confirmed(states) for states in frames)


@pytest.mark.parametrize("fps", [3.0, 15.0, 60.0])
def test_a_walker_is_one_person_at_any_frame_rate(fps):
    frames = follow(lambda t: [(-1.0 + 1.2 * t, 3.0, 1.75)], 1.6, fps)
    last = confirmed(frames[-1])
    assert len({s.track_id for states in frames for s in confirmed(states)}) == 1
    t = (len(frames) - 1) / fps
    assert (last[0].x_m, last[0].y_m, last[0].height_m) == pytest.approx((-1.0 + 1.2 * t, 3.0, 1.75), abs=0.08)


def test_two_people_who_pass_keep_their_ids():
    frames = follow(lambda t: [(-1.0 + t, 2.6, 1.8), (1.0 - t, 3.3, 1.65)], 2.0, codes=(30, 160))
    first = {s.track_id: s.x_m for s in confirmed(frames[8])}
    last = {s.track_id: s.x_m for s in confirmed(frames[-1])}
    assert len(first) == 2 and set(first) == set(last) and all(first[i] * last[i] < 0 for i in first)


def test_a_person_behind_another_keeps_the_id():
    level = oblique_camera(height_m=1.7, tilt_deg=88.0)
    tracker, seen = JointTracker(), []
    for n in range(52):
        front, hidden = (max(0.0, 0.72 - 0.06 * n), 2.0, 1.85), (-1.8 + 0.06 * n, 4.0, 1.65)
        seen.append(tracker.update(observed(n, n / 15, look_at(level, [front, hidden], (30, 160)))))
    before, behind, after = ({s.track_id: s.state for s in seen[n]} for n in (16, 30, 48))
    assert list(before.values()) == ["confirmed", "confirmed"]
    assert sorted(behind.values()) == ["confirmed", "lost"] and after == before


def test_legs_alone_are_as_tall_as_anybody():
    low = oblique_camera(height_m=1.0, tilt_deg=75.0)
    tracker = JointTracker()
    for n in range(12):
        states = tracker.update(observed(n, n / 15, look_at(low, [(-0.5 + 0.08 * n, 1.2, 1.75)] if n > 2 else [])))
    assert [s.height_m for s in states] == [pytest.approx(body.HEIGHT_MEAN_M)]


def test_who_enters_far_from_where_another_left_is_someone_else():
    def scene(t):
        if t < 1.0:
            return [(-1.0 - 0.8 * t, 3.0, 1.7)]
        return [(1.6 - 1.0 * (t - 1.8), 3.0, 1.7)] if t >= 1.8 else []

    frames = follow(scene, 3.0)
    assert len({s.track_id for states in frames for s in confirmed(states)}) == 2


def test_bodies_in_one_place_become_the_upright_person_that_explains_more():
    tracker, noise = JointTracker(), 0.05**2 * np.eye(2)
    show(tracker, 0)
    for pose in ((0.0, 2.95, 1.0), (0.0, 3.15, 1.7)):
        person = Person.newcomer(upright_pose(pose), noise, 100.0, Glimpse(0.0, 1.0), 0.0)
        person.log_odds = 4.0
        person.track_id = len(tracker._people) + 1
        tracker._people.append(person)
    tracker._people[0].confirmed = True
    states = show(tracker, 1, (0.0, 3.0, 1.75))
    assert [(s.track_id, s.height_m > 1.6) for s in confirmed(states)] == [(1, True)]


@pytest.mark.parametrize(("turn_rad", "farther_m"), [(1.2, 0.25), (1.57, 0.0), (2.0, 0.25), (2.5, 0.0)])
def test_somebody_who_turns_while_bending_makes_no_newcomer(turn_rad, farther_m):
    tracker, spawned = JointTracker(), 0
    camera = oblique_camera(3.3, tilt_deg=0.0)
    for n in range(40):
        x_m = -1.0 + 0.04 * n
        pose = (x_m, 0.2, 1.75) if n < 30 else (x_m + farther_m, 0.2, 1.75, turn_rad, body.LEAN_M)
        tracker.update(observed(n, n / 15, look_at(camera, [pose])))
        spawned += sum(decision.kind == "spawned" for decision in tracker.decisions)
    assert spawned == 1


def test_a_walker_keeps_existing_while_nothing_is_known():
    tracker, states, odds = JointTracker(), [], []
    for n in range(35):
        scene = look_at(CAMERA, [(-0.6 + 0.08 * n, 3.0, 1.75)])
        if 15 <= n < 23:
            scene.kind[:], scene.range_m[:] = UNKNOWN, 0.0
        states.append([(s.track_id, s.state) for s in tracker.update(observed(n, n / 15, scene))])
        odds.append(tracker._people[0].log_odds)
    assert states[14] == states[34] == [(1, "confirmed")] and states[15:23] == [[(1, "lost")]] * 8
    assert odds[22] == pytest.approx(odds[14], abs=1e-6)


def test_nobody_is_confirmed_while_images_lack_the_colours_that_they_had():
    tracker, first = JointTracker(), {}
    for n in range(40):
        scene = look_at(CAMERA, [(0.8, 2.5, 1.75), (-1.2 + 0.06 * n, 3.5, 1.75)] if n > 4 else [], (30, 160))
        lost = 6 <= n < 26
        states = tracker.update(observed(n, n / 15, replace(scene, colour=None) if lost else scene))
        first |= {s.track_id: n for s in confirmed(states) if s.track_id not in first}
    assert min(first.values()) >= 26


def test_who_turns_round_while_nothing_is_known_is_not_the_thing_that_stands_ahead():
    tracker, states = JointTracker(), ()
    for n in range(34):
        walker, thing = (-1.0 + 0.06 * min(n, 44 - n), 3.0, 1.75), (0.8, 3.0, 1.0)
        scene = look_at(CAMERA, [walker, thing] if n >= 32 else [walker], (30, 160))
        if 15 <= n < 32:
            scene.kind[:], scene.range_m[:] = UNKNOWN, 0.0
        states = tracker.update(observed(n, n / 15, scene))
    assert [(s.track_id, s.x_m) for s in confirmed(states)] == [(1, pytest.approx(-0.34, abs=0.08))]


@pytest.mark.parametrize("time_s", [0.0, 1.0, np.nan])
def test_times_that_do_not_advance_are_refused(time_s):
    tracker = JointTracker()
    tracker.update(observed(0, 1.0, look_at(CAMERA, [])))
    with pytest.raises(ValueError, match="time to advance"):
        tracker.update(observed(1, time_s, look_at(CAMERA, [])))


def test_a_reset_ends_everybody():
    tracker = JointTracker()
    for n in range(20):
        show(tracker, n, (0.0, 3.0, 1.75))
    tracker.reset()
    assert show(tracker, 0) == ()


def test_every_frame_says_why_each_person_is_where_it_is():
    tracker = JointTracker()
    for n in range(10):
        show(tracker, n, (0.0, 3.0, 1.75))
    (reason,) = (d.reason for d in tracker.decisions if d.kind == "matched")
    assert "evidence" in reason and "existence" in reason and "visible" in reason


def test_debug_shows_the_owners_of_pixels():
    tracker = JointTracker()
    for n in range(10):
        show(tracker, n, (0.0, 3.0, 1.75))
    owners = tracker.debug().tiles["owners/0"]
    assert owners.shape == CAMERA.shape and (owners > 40).sum() > 300


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_walker_faces_ahead(way):
    steep, facing = oblique_camera(height_m=3.5, tilt_deg=10.0), 0.0 if way > 0 else np.pi
    tracker, last = JointTracker(), ()
    for n in range(24):
        person = (way * (-0.8 + 1.2 * n / 15), 0.6, 1.75, facing)
        last = tracker.update(observed(n, n / 15, look_at(steep, [person])))
    (walker,) = confirmed(last)
    assert abs(np.cos(np.deg2rad(walker.facing_deg)) - way) < 0.1
