"""Who a newcomer of the joint tracker is, and what is learned of a person."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from toy_people import look_at, oblique_camera

from planview.maps.view import CODES
from planview.tracking import body
from planview.tracking.explain.explanation import Explanation, upright
from planview.tracking.explain.identity import Exchanges, _log_odds, alike, colours_of
from planview.tracking.explain.person import SHAPE_STD_M, Person
from planview.tracking.joint import JointTracker
from planview.tracking.joint.ranges import JointParams
from planview.tracking.kalman import FloorKalman


def newcomer(track_id: int, x_m: float, now_s: float, log_odds: float) -> Person:
    person = Person.born(upright((x_m, 3.0, 1.75)), 1e-3 * np.eye(2), 100.0, log_odds, now_s)
    person.track_id, person.proven, person.moved = track_id, log_odds, log_odds
    return person


def recognising(departed: Sequence[Person], people: Sequence[Person], now_s: float) -> JointTracker:
    tracker = JointTracker()
    tracker._departed, tracker._people = list(departed), list(people)
    tracker._life.begin(now_s)
    tracker._recognise(coloured=True)
    return tracker


def test_a_newcomer_who_may_be_nobody_claims_no_identity_before_one_who_is_reported():
    gone, sure, ghost = newcomer(1, 0.0, 0.0, 8.0), newcomer(2, 0.1, 0.5, 8.0), newcomer(3, 0.0, 0.5, -2.0)
    recognising([gone], [ghost, sure], 0.8)
    assert (sure.track_id, sure.confirmed, ghost.track_id, ghost.confirmed) == (1, True, 3, False)


def test_one_tall_frame_does_not_make_a_person_of_a_low_thing() -> None:
    def seen(*heights_m: float) -> Person:
        person = newcomer(-1, 0.0, 0.5, 8.0)
        person.moved, person.share, person.patches = 0.0, 0.5, 20.0
        for person.height_m in heights_m:
            person.count_height(0.1)
        return person

    tall, stood_up, mostly_low = seen(1.7), seen(0.9, 1.7), seen(*[0.9] * 8, 1.7)
    assert stood_up.upright_density == pytest.approx(0.5 * tall.upright_density)
    claims = [JointTracker()._confidence(person) for person in (tall, stood_up, mostly_low)]
    assert claims == sorted(claims, reverse=True)
    assert claims[1] > JointTracker().params.report > claims[2]


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
    gone, found = newcomer(1, 0.0, 0.0, 8.0), newcomer(-1, 0.4, 2.0, 8.0)
    tracker = recognising([gone], [found], 2.3)
    assert not found.confirmed
    for person in (gone, found):
        person.colours[:, 0], person.coloured_frames = 5.0, 5
    tracker._recognise(coloured=True)
    assert found.confirmed and found.track_id == 1


def test_of_whom_the_head_is_out_of_view_is_nobodys_height_and_no_stranger():
    gone, legs = newcomer(1, -0.5, 0.0, 8.0), newcomer(2, 0.0, 1.0, 8.0)
    gone.tall_m, legs.height_m, legs.inside = 1.9, 0.8, 0.4
    tracker = recognising([gone], [legs], 2.1)
    assert not legs.confirmed
    legs.inside = 0.9  # all but the head: a stranger now
    tracker._recognise(coloured=True)
    assert legs.confirmed and legs.track_id == 1


@pytest.mark.parametrize(("tall_m", "confirmed"), [(1.9, False), (1.7, True)])
def test_before_the_head_shows_nobody_is_a_stranger_who_may_be_as_tall_as_somebody_who_left(tall_m, confirmed) -> None:
    gone, feet = newcomer(7, 0.0, 0.0, 8.0), newcomer(-1, 1.8, 2.0, 8.0)
    gone.tall_m, gone.tall_var, feet.inside = tall_m, 0.02**2, 0.9
    feet.coloured_frames = 5  # clothes that say nothing
    assert -1.0 < _log_odds(gone, feet, [], 20.0, 0.1) < -0.5  # a height of 1.9 m adds 1.0, one of 1.7 m 0.4
    tracker = recognising([gone], [feet], 2.5)
    assert feet.confirmed == confirmed
    feet.height_m, feet.head_in_view = 1.7, True
    tracker._recognise(coloured=True)
    assert feet.confirmed and gone in tracker._departed


def test_frames_without_colours_are_no_time_in_which_clothes_could_have_been_seen() -> None:
    person = newcomer(-1, 0.0, 0.0, 8.0)
    person.head_in_view = True
    assert person.shows_more_after(0.9, coloured=True) and not person.shows_more_after(1.1, coloured=True)
    person.blind_s = 0.5
    assert person.shows_more_after(1.4, coloured=True) and not person.shows_more_after(1.6, coloured=True)


def test_colours_that_have_shown_are_expected_again_for_three_seconds() -> None:
    tracker, rays = JointTracker(), oblique_camera()
    coloured = look_at(rays, [(0.0, 3.0, 1.75)], [CODES - 1])
    grey = replace(coloured, colour=None)
    expected = []
    for now_s, view in ((0.0, grey), (1.0, coloured), (3.9, grey), (4.1, grey)):
        tracker._life.begin(now_s)
        expected.append(tracker._expects_colours(Explanation([view], tracker._likelihood)))
    assert expected == [False, True, True, False]


def test_people_who_touch_while_there_are_no_colours_may_have_been_exchanged() -> None:
    exchanges = Exchanges(JointParams())
    exchanges.update([newcomer(1, 0.0, 0.0, 8.0), newcomer(2, 0.5, 0.0, 8.0), newcomer(3, 2.0, 0.0, 8.0)], (), 0.0)
    assert exchanges._evidence == {(1, 2): 0.0}


@pytest.mark.parametrize(("head_in_view", "std_m"), [(True, 0.02), (False, 0.2)])
def test_a_place_is_known_to_half_a_step_while_the_head_is_out_of_view(head_in_view, std_m):
    tracker, person = JointTracker(), newcomer(1, 0.0, 0.0, 4.0)
    person.kalman = FloorKalman.measured(np.zeros(2), 25.0 * np.eye(2), 1.0)  # hardly known before
    person.head_in_view = head_in_view
    samples = SimpleNamespace(noise=lambda pose, curvature: (0.02**2 * np.eye(2), 0.0))
    tracker._measure(person, samples, upright((0.1, 0.0, 1.7)), np.zeros(6), np.zeros(8), 0.1)
    assert person.kalman.position_std_m == pytest.approx(std_m, rel=0.02)


def test_which_way_somebody_faces_is_not_known_before_a_silhouette_is_seen():
    person = Person.born(upright((0.0, 0.6, 1.75)), 1e-3 * np.eye(2), 100.0, 4.0, 0.0)
    assert np.isnan(person.faces).all()


def test_a_lean_moves_the_head_and_not_the_feet():
    person = Person.born(np.array([1.0, 2.0, 1.7, np.pi / 2, 0.2]), 1e-3 * np.eye(2), 100.0, 4.0, 0.0)
    assert person.at_m == pytest.approx((1.0, 2.0)) and person.head_m == pytest.approx((1.0, 2.2))


def test_a_lean_follows_what_is_seen_of_it():
    person = Person.born(np.array([0.0, 0.0, 1.7, 0.0, 0.0]), 1e-3 * np.eye(2), 100.0, 4.0, 0.0)
    leaning, as_before = np.array([0.0, 0.0, 1.7, 0.0, 0.15]), body.LEAN_STD_M**-2
    along_x = -50.0 * np.sin(np.arange(8) * np.pi / 8) ** 2
    person.measure_facing(leaning, along_x, np.array([50.0, as_before]), 1.0)  # as well seen as it was known
    assert person.lean_m == pytest.approx(0.075)
    person.measure_facing(leaning, along_x, np.array([50.0, 0.0]), 1.0)  # not seen
    assert person.lean_m == pytest.approx(0.075)


def test_the_deviation_of_a_place_holds_the_lean_and_what_all_pixels_share():
    person = newcomer(1, 0.0, 0.0, 4.0)
    person.kalman = FloorKalman.measured(np.zeros(2), 0.03**2 * np.eye(2))
    person.height_m, person.tall_m, person.shared_m = 1.7, 1.7, 0.04
    upright_m = person.head_std_m
    assert upright_m == pytest.approx(np.hypot(0.05, SHAPE_STD_M))
    person.height_m, person.lean_m = 1.6, 0.1  # bent
    assert person.head_std_m == pytest.approx(np.hypot(upright_m, 0.7 * 0.2))
