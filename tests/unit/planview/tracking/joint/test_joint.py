"""The joint tracker."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace

import numpy as np
import pytest
from reference.explain import log_likelihood, patches_of
from toy_people import look_at, oblique_camera, observed

from planview.maps.colour import CODES
from planview.maps.view import SURFACE, UNKNOWN, View
from planview.tracking import body
from planview.tracking.base import Observation
from planview.tracking.joint import JointTracker
from planview.tracking.joint.births import Births
from planview.tracking.joint.explanation import Explanation, People, about, likelihood_of_ranges, upright
from planview.tracking.joint.identity import _log_odds, alike, colours_of
from planview.tracking.joint.params import JointParams
from planview.tracking.joint.person import Person
from planview.tracking.joint.samples import EX, EY, LAYERS, PARTS, THROUGH, SampleArrays
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState

CAMERA = oblique_camera()
Scene = Callable[[float], Sequence[tuple[float, ...]]]


def follow(
    scene: Scene,
    seconds: float,
    fps: float = 15.0,
    codes: Sequence[int] = (),
    table: body.BodyTable | None = None,
) -> list[tuple[TrackState, ...]]:
    tracker = JointTracker()
    times = np.arange(0.0, seconds, 1.0 / fps)
    return [tracker.update(observed(n, float(t), look_at(CAMERA, scene(t), codes, table))) for n, t in enumerate(times)]


def confirmed(states: Sequence[TrackState]) -> list[TrackState]:
    return [s for s in states if s.state == "confirmed"]


def test_nobody_is_found_in_an_empty_room_nor_in_a_low_box_that_stands():
    assert not any(follow(lambda t: [], 1.0))
    frames = follow(lambda t: [(0.0, 3.0, 0.8)] if t > 0.3 else [], 3.0)
    assert not any(confirmed(states) for states in frames)
    with pytest.raises(ValueError, match="pixels"):
        JointTracker().update(Observation(0, 0.0))


def test_what_never_changes_is_one_look_and_no_person():
    frames = follow(lambda t: [(0.0, 3.0, 1.75)] if t > 0.3 else [], 4.0)
    assert frames[-1] and not any(confirmed(states) for states in frames)


def test_a_thing_is_tried_once_as_long_as_it_does_not_change():
    tracker, spawned = JointTracker(), 0
    for n in range(60):
        tracker.update(observed(n, n / 15, look_at(CAMERA, [(0.0, 3.0, 0.8)] if n > 4 else [])))
        spawned += sum(d.kind == "spawned" for d in tracker.decisions)
    assert spawned <= 1


def test_who_stops_walking_stays_confirmed():
    frames = follow(lambda t: [(min(-1.0 + 1.2 * t, 0.0), 3.0, 1.75)], 4.0)
    assert len(confirmed(frames[-1])) == 1


@pytest.mark.parametrize(("height_m", "people"), [(1.75, 1), (1.1, 0)])
def test_what_moves_by_a_metre_is_a_person_when_tall_and_a_thing_when_low(height_m, people):
    frames = follow(lambda t: [(min(-0.6 + 1.2 * t, 0.4), 3.0, height_m)], 3.0)
    assert len(confirmed(frames[-1])) == people


@pytest.mark.parametrize("height_m", [0.9, 1.05, 1.3])
@pytest.mark.parametrize("width", [1, 2])
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


def test_a_person_behind_another_is_lost_and_found_with_the_same_id():
    level = oblique_camera(height_m=1.7, tilt_deg=88.0)
    tracker, seen = JointTracker(), []
    for n in range(52):
        front, hidden = (max(0.0, 0.72 - 0.06 * n), 2.0, 1.85), (-1.8 + 0.06 * n, 4.0, 1.65)
        seen.append(tracker.update(observed(n, n / 15, look_at(level, [front, hidden], (30, 160)))))
    before, behind, after = ({s.track_id: s.state for s in seen[n]} for n in (16, 30, 48))
    assert list(before.values()) == ["confirmed", "confirmed"]
    assert sorted(behind.values()) == ["confirmed", "lost"] and after == before


def newcomer(track_id: int, x_m: float, now_s: float, log_odds: float) -> Person:
    person = Person.born(upright((x_m, 3.0, 1.75)), 1e-3 * np.eye(2), 100.0, log_odds, now_s)
    person.track_id, person.proven, person.moved = track_id, log_odds, log_odds
    return person


def test_a_newcomer_who_may_be_nobody_claims_no_identity_before_one_who_is_reported():
    tracker = JointTracker()
    gone, sure, ghost = newcomer(1, 0.0, 0.0, 8.0), newcomer(2, 0.1, 0.5, 8.0), newcomer(3, 0.0, 0.5, -2.0)
    tracker._departed, tracker._people = [gone], [ghost, sure]
    tracker._log.begin(0.8)
    tracker._recognise(coloured=True)
    assert (sure.track_id, sure.confirmed, ghost.track_id, ghost.confirmed) == (1, True, 3, False)


def test_who_walks_out_is_expected_ahead_or_back_in_the_door_and_not_behind() -> None:
    # After 0.7 s a walker has gone on for 0.7 s (1 - 1/e), at 1 m/s 0.44 m.
    walker = newcomer(1, 0.0, 0.0, 3.0)
    walker.seen = FloorKalman(np.array([0.0, 3.0, 1.0, 0.0]), np.eye(4))
    found = [newcomer(-1, x_m, 0.7, 3.0) for x_m in (0.44, 0.0, -0.88)]  # -0.88 is three deviations from the door
    ahead, back, behind = (_log_odds(walker, person, [], 20.0, 0.1) for person in found)
    assert ahead > back > 2.0 > 0.0 > behind


def test_clothes_tell_people_apart_as_far_as_others_do_not_wear_them() -> None:
    def dressed(code: int) -> Person:
        person = newcomer(-1, 0.0, 0.0, 3.0)
        person.colours[:, code] = 5.0
        return person

    black, white = 0, CODES - 1
    blacks, whites = colours_of([dressed(black)]), colours_of([dressed(white)])
    assert alike(dressed(black), dressed(black), whites) == pytest.approx(6.0)  # the most of three parts
    assert alike(dressed(black), dressed(black), blacks) < 3.0
    assert alike(dressed(black), dressed(white), whites) == pytest.approx(-6.0)
    unseen = newcomer(-1, 0.0, 0.0, 3.0)
    assert alike(dressed(black), unseen, whites) == pytest.approx(0.0, abs=1e-6)


def test_a_newcomer_who_may_be_somebody_known_has_no_id_before_the_clothes_have_been_seen() -> None:
    tracker = JointTracker()
    gone, found = newcomer(1, 0.0, 0.0, 8.0), newcomer(-1, 0.4, 2.0, 8.0)
    tracker._departed, tracker._people = [gone], [found]
    tracker._log.begin(2.3)
    tracker._recognise(coloured=True)
    assert not found.confirmed
    for person in (gone, found):
        person.colours[:, 0], person.looks = 5.0, 5
    tracker._recognise(coloured=True)
    assert found.confirmed and found.track_id == 1


def test_of_whom_the_head_is_out_of_view_is_nobodys_height_and_no_stranger():
    tracker = JointTracker()
    gone, legs = newcomer(1, -0.5, 0.0, 8.0), newcomer(2, 0.0, 1.0, 8.0)
    gone.tall_m, legs.height_m, legs.inside = 1.9, 0.8, 0.4
    tracker._departed, tracker._people = [gone], [legs]
    tracker._log.begin(2.1)
    tracker._recognise(coloured=True)
    assert not legs.confirmed
    legs.inside = 0.9  # all but the head: a stranger now
    tracker._recognise(coloured=True)
    assert legs.confirmed and legs.track_id == 1


@pytest.mark.parametrize(("head_in_view", "std_m"), [(True, 0.02), (False, 0.2)])
def test_a_place_is_known_to_half_a_step_while_the_head_is_out_of_view(head_in_view, std_m):
    tracker, person = JointTracker(), newcomer(1, 0.0, 0.0, 4.0)
    person.kalman = FloorKalman.measured(np.zeros(2), 25.0 * np.eye(2), 1.0)  # hardly known before
    person.head_in_view = head_in_view
    samples = SimpleNamespace(noise=lambda pose, curvature: (0.02**2 * np.eye(2), 0.0))
    tracker._measure(person, samples, upright((0.1, 0.0, 1.7)), np.zeros(6), 0.1)
    assert person.kalman.position_std_m == pytest.approx(std_m, rel=0.02)


def test_legs_alone_are_as_tall_as_anybody():
    low = oblique_camera(height_m=1.0, tilt_deg=75.0)
    tracker = JointTracker()
    for n in range(12):
        states = tracker.update(observed(n, n / 15, look_at(low, [(-0.5 + 0.08 * n, 1.2, 1.75)] if n > 2 else [])))
    assert [s.height_m for s in states] == [pytest.approx(body.HEIGHT_MEAN_M)]


def test_height_shows_where_the_head_is_in_view_and_nobody_taller_could_be():
    view = look_at(oblique_camera(height_m=1.0, tilt_deg=75.0), [])
    frame = Explanation([view], likelihood_of_ranges(JointParams()))
    near, far = upright((0.0, 1.2, 0.8)), upright((0.0, 6.0, 0.8))
    assert frame.in_view(near) and not frame.shows_height(near, 1.7, 0.12)  # the head of 1.7 m would be above the view
    assert frame.shows_height(near, 0.85, 0.12)  # of somebody known to sit
    assert frame.shows_height(far, 1.7, 0.12)


def test_who_enters_far_from_where_another_left_is_someone_else():
    def scene(t: float) -> list[tuple[float, ...]]:
        if t < 1.0:
            return [(-1.0 - 0.8 * t, 3.0, 1.7)]
        return [(1.6 - 1.0 * (t - 1.8), 3.0, 1.7)] if t >= 1.8 else []

    frames = follow(scene, 3.0)
    assert len({s.track_id for states in frames for s in confirmed(states)}) == 2


def test_a_low_body_and_another_in_its_place_become_the_upright_person_that_explains_more():
    tracker, noise = JointTracker(), 0.05**2 * np.eye(2)
    tracker.update(observed(0, 0.0, look_at(CAMERA, [])))
    for pose in ((0.0, 2.95, 1.0), (0.0, 3.15, 1.7)):
        person = Person.born(upright(pose), noise, 100.0, 4.0, 0.0)
        person.track_id = len(tracker._people) + 1
        tracker._people.append(person)
    tracker._people[0].confirmed = True
    states = tracker.update(observed(1, 1 / 15, look_at(CAMERA, [(0.0, 3.0, 1.75)])))
    assert [(s.track_id, s.height_m > 1.6) for s in confirmed(states)] == [(1, True)]


def test_a_walker_keeps_existence_and_id_while_nothing_is_known():
    tracker, states, odds = JointTracker(), [], []
    for n in range(35):
        scene = look_at(CAMERA, [(-0.6 + 0.08 * n, 3.0, 1.75)])
        if 15 <= n < 23:
            scene.kind[:], scene.range_m[:] = UNKNOWN, 0.0
        states.append([(s.track_id, s.state) for s in tracker.update(observed(n, n / 15, scene))])
        odds.append(tracker._people[0].log_odds)
    assert states[14] == states[34] == [(1, "confirmed")] and states[15:23] == [[(1, "lost")]] * 8
    assert odds[22] == pytest.approx(odds[14], abs=1e-6)


def test_a_reset_ends_everybody_and_earlier_times_are_refused():
    tracker = JointTracker()
    for n in range(20):
        tracker.update(observed(n, n / 15, look_at(CAMERA, [(0.0, 3.0, 1.75)])))
    with pytest.raises(ValueError, match="time to advance"):
        tracker.update(observed(20, 0.0, look_at(CAMERA, [])))
    tracker.reset()
    assert tracker.update(observed(0, 0.0, look_at(CAMERA, []))) == ()


def test_every_frame_says_why_each_person_is_where_it_is_and_shows_the_owners_of_pixels():
    tracker = JointTracker()
    for n in range(10):
        tracker.update(observed(n, n / 15, look_at(CAMERA, [(0.0, 3.0, 1.75)])))
    (reason,) = (d.reason for d in tracker.decisions if d.kind == "matched")
    assert "evidence" in reason and "existence" in reason and "visible" in reason
    owners = tracker.debug().tiles["owners/0"]
    assert owners.shape == CAMERA.shape and (owners > 40).sum() > 300


PARAMS = JointParams()
ADULT = (0.0, 3.0, 1.75)
TALL = np.array([1.75, 0.12])
SAME = np.ones((PARTS, 200), np.float32)


def people_of(*poses: tuple[float, ...]) -> People:
    n = len(poses)
    ratios = np.ones((n, PARTS, 200), np.float32)
    return People(np.array([upright(pose) for pose in poses]).reshape(-1, 5), np.ones(n), np.tile(TALL, (n, 1)), ratios)


def plain(samples: SampleArrays) -> None:
    """Take every pixel for one patch, and the nearest table for each."""
    n = int(samples.size[0])
    samples.pixels["weight"][:n], samples.pixels["slant"][:n] = 1.0, 0.5
    samples.pixels["turn"][:n] = np.arctan2(samples.rays[EY, :n], samples.rays[EX, :n]) * body.TURNS_PER_RAD - 0.5


def explained(seen: View) -> Explanation:
    return Explanation((seen,), likelihood_of_ranges(PARAMS))


@pytest.mark.parametrize("other", [(0.3, 3.8, 1.6), (0.1, 5.4, 1.8)], ids=["in front", "behind"])
@pytest.mark.parametrize("unknown_rows", [0, 50])
def test_evidence_of_a_person_is_the_difference_of_two_likelihoods(other, unknown_rows):
    far = (0.0, 4.6, 1.75)
    seen = look_at(oblique_camera(), [far, other])
    seen.kind[:unknown_rows] = UNKNOWN
    every_pixel = JointParams(patch_m=0.011)
    dense = Explanation((seen,), likelihood_of_ranges(every_pixel)).around(upright(far), 0.4)
    plain(dense.arrays)
    dense.layer(people_of(far, other), np.array([1]))
    found = dense.log_ratio(upright(far), TALL, SAME)
    # Arms reach as far in both: what lies near one of the two lies near the other.
    without, both = (log_likelihood(seen, people, PARAMS, [other]) for people in ([other], [other, far]))
    assert found == pytest.approx(both - without, rel=0.03)


def test_the_surface_of_a_view_is_shared_out_and_lacks_an_explanation_where_nobody_owns_it():
    seen = look_at(oblique_camera(), [ADULT])
    (owned,), (alone,) = explained(seen).assign_pixels(people_of(ADULT)), explained(seen).assign_pixels(people_of())
    patches = patches_of(seen, seen.rays.pixel_sr / PARAMS.patch_m**2)
    np.testing.assert_array_equal(owned.pixels, np.flatnonzero(seen.kind == SURFACE))
    np.testing.assert_allclose(owned.patches, patches, rtol=1e-4)
    assert (owned.owner == 0).mean() > 0.95 and (owned.share > 0.8).mean() > 0.9
    per_patch = [float(o.lacking.sum() / patches.sum()) for o in (owned, alone)]
    assert abs(per_patch[0]) < 0.5 and per_patch[1] > 3.0


def test_pixels_that_show_nothing_are_no_evidence_and_not_in_the_visible_share():
    seen = look_at(oblique_camera(), [ADULT])
    shares, evidence = [], []
    for hidden in (slice(0), np.s_[:, :80], np.s_[:]):
        seen.kind[hidden] = UNKNOWN
        samples = explained(seen).around(upright(ADULT), 0.3)
        samples.layer(people_of(), np.zeros(0, np.int64))
        mine, known, total = samples.visible(upright(ADULT), TALL, SAME).tolist()
        shares.append((mine / max(known, 1e-9), known / total))
        evidence.append(samples.log_ratio(upright(ADULT), TALL, SAME))
    assert shares[0] == pytest.approx((shares[1][0], 1.0), abs=0.03) and 0.4 < shares[1][1] < 0.6
    assert shares[2] == (0.0, 0.0) and evidence[2] == 0.0 and evidence[0] > evidence[1] > 5.0


def test_of_five_people_on_a_ray_the_four_nearest_count_in_any_order():
    row = [(0.0, 2.0 + 0.9 * k, 1.7) for k in range(6)]
    frame = explained(look_at(oblique_camera(height_m=1.6, tilt_deg=88.0), row[:1]))
    found = []
    for order in ([1, 2, 3, 4, 5], [5, 4, 3, 2, 1]):
        samples = frame.around(upright(row[0]), 0.3)
        samples.layer(people_of(*row), np.array(order))
        n = samples.arrays.size[0]
        assert samples.arrays.counts[:n].max() == LAYERS
        past = np.arange(LAYERS + 1) > samples.arrays.counts[:n, None]
        found.append(np.where(past, 0.0, samples.arrays.layers[:n, THROUGH]))
        owned = frame.assign_pixels(people_of(*[row[k] for k in (0, *order)]))[0]
        found.append((owned.owner == 0).mean())
    np.testing.assert_allclose(found[0], found[2])
    assert found[1] == found[3] > 0.9


def test_a_person_where_the_background_is_seen_is_unlikely():
    frame = explained(look_at(oblique_camera(), []))
    samples = frame.around(upright(ADULT), 0.3)
    samples.layer(people_of(), np.zeros(0, np.int64))
    assert samples.log_ratio(upright(ADULT), TALL, SAME) < -50


def test_a_hidden_person_costs_nothing():
    front = (0.0, 2.4, 1.85)
    frame = explained(look_at(oblique_camera(tilt_deg=85.0), [front]))
    behind = upright((0.0, 3.1, 1.5))
    samples = frame.around(behind, 0.3)
    samples.layer(people_of(front), np.array([0]))
    assert samples.log_ratio(behind, TALL, SAME) > -3


def test_ascent_finds_a_person_from_a_walkers_error_of_prediction():
    frame = explained(look_at(oblique_camera(), [(*ADULT, np.pi / 2)]))
    start = upright((0.15, 2.85, 1.62))
    samples = frame.around(start, 0.3)
    samples.layer(people_of(), np.zeros(0, np.int64))
    loose = about(1.0, 1.0)
    samples.ascend(start, start.copy(), loose, TALL, SAME)
    assert start[:3] == pytest.approx(ADULT, abs=0.05)


@pytest.mark.parametrize(("height_m", "shape"), [(1.75, "body"), (1.15, "body"), (1.05, "box")])
def test_a_body_explains_a_body_better_than_a_box_and_a_box_a_box(height_m, shape):
    table = body.thing_tables()[1] if shape == "box" else None
    frame, pose = (
        explained(look_at(CAMERA, [(0.0, 3.0, height_m, np.pi / 2)], table=table)),
        upright((0.0, 3.0, height_m)),
    )
    samples = frame.around(pose, 0.3)
    samples.layer(people_of(), np.zeros(0, np.int64))
    samples.ascend(pose, pose.copy(), about(1.0, 1.0), TALL, SAME)
    ratio = samples.against_thing(pose, TALL)
    assert ratio > 0 if shape == "body" else ratio < -5


def test_bodies_do_not_stand_in_each_other():
    samples = explained(look_at(oblique_camera(), [])).around(upright(ADULT), 0.3)
    priors = []
    for y in (3.5, 3.1):
        samples.layer(people_of((0.0, y, 1.7)), np.array([0]))
        priors.append(samples.log_prior(upright(ADULT), TALL))
    assert priors[0] == pytest.approx(0.0, abs=0.01) and priors[1] < -8


STEEP = oblique_camera(height_m=3.5, tilt_deg=10.0)
ABOVE = (0.0, 0.6, 1.75)


@pytest.mark.parametrize("facing_deg", [0.0, 45.0, 90.0, 135.0])
@pytest.mark.parametrize("lean", [0.0, 0.2])
def test_a_search_finds_which_way_a_body_faces_and_with_a_lean_also_front_from_back(facing_deg, lean):
    facing = np.deg2rad(facing_deg)
    samples = explained(look_at(STEEP, [(*ABOVE, facing, lean)])).around(upright(ABOVE), 0.3)
    samples.layer(people_of(), np.zeros(0, np.int64))
    pose = upright(ABOVE)
    samples.ascend(pose, pose.copy(), about(0.2, 0.5), TALL, SAME)
    turns = 1 if lean else 2  # upright, front and back look the same
    off = turns * (pose[3] - facing)
    assert np.rad2deg(abs(np.arctan2(np.sin(off), np.cos(off)))) / turns < 25.0
    head = np.array(ABOVE[:2]) + lean * np.array([np.cos(facing), np.sin(facing)])
    assert pose[:2] + pose[4] * np.array([np.cos(pose[3]), np.sin(pose[3])]) == pytest.approx(head, abs=0.05)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_walker_faces_ahead(way):
    facing = 0.0 if way > 0 else np.pi
    tracker, last = JointTracker(), ()
    for n in range(24):
        person = (way * (-0.8 + 1.2 * n / 15), 0.6, 1.75, facing)
        last = tracker.update(observed(n, n / 15, look_at(STEEP, [person])))
    (walker,) = confirmed(last)
    assert abs(np.cos(np.deg2rad(walker.facing_deg)) - way) < 0.1


def test_which_way_somebody_faces_is_not_known_before_they_walk():
    person = Person.born(upright(ABOVE), 1e-3 * np.eye(2), 100.0, 4.0, 0.0)
    assert np.isnan(person.facing_deg)


def test_a_lean_moves_the_head_and_not_the_feet():
    person = Person.born(np.array([1.0, 2.0, 1.7, np.pi / 2, 0.2]), 1e-3 * np.eye(2), 100.0, 4.0, 0.0)
    assert person.at_m == pytest.approx((1.0, 2.0)) and person.head_m == pytest.approx((1.0, 2.2))


def test_a_lean_follows_what_is_seen_of_it():
    person = Person.born(np.array([0.0, 0.0, 1.7, 0.0, 0.0]), 1e-3 * np.eye(2), 100.0, 4.0, 0.0)
    leaning, as_before = np.array([0.0, 0.0, 1.7, 0.0, 0.15]), body.LEAN_STD_M**-2
    person.measure_facing(leaning, np.array([50.0, as_before]), 1.0)  # as well seen as it was known
    assert person.lean_m == pytest.approx(0.075)
    person.measure_facing(leaning, np.array([50.0, 0.0]), 1.0)  # not seen
    assert person.lean_m == pytest.approx(0.075)


def test_points_of_a_surface_are_fresh_until_they_are_tried_and_again_when_it_moves():
    seen = look_at(oblique_camera(), [ADULT])
    frame, births = explained(seen), Births(PARAMS)
    (owned,) = frame.assign_pixels(people_of())
    which, points = births._fresh(0, frame, owned)
    np.testing.assert_array_equal(which, np.arange(len(owned.pixels)))
    plain_points = seen.rays.centre_m + (seen.range_m[..., None] * seen.rays.direction).reshape(-1, 3)[owned.pixels]
    np.testing.assert_allclose(points[:3].T, plain_points, atol=1e-4)
    np.testing.assert_array_equal(points[3:], [owned.lacking, owned.colours])
    births._tried_m[seen.rays.key][:] = seen.range_m
    births._tried_m[seen.rays.key].reshape(-1)[owned.pixels[0]] -= 5.0
    assert births._fresh(0, frame, owned)[0].tolist() == [0]
