"""Who a newcomer of the joint tracker is, and what is learned of a person."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from toy_people import look_at, oblique_camera

from planview.maps.view import CODES
from planview.tracking import body
from planview.tracking.explain.clothes import Clothes, stranger_colours
from planview.tracking.explain.explanation import Explanation, upright_pose
from planview.tracking.explain.facing import Gait, Stance
from planview.tracking.explain.identity import Exchanges, _log_odds
from planview.tracking.explain.person import Glimpse, Person, Proof, Sighting, Stature
from planview.tracking.joint import JointTracker
from planview.tracking.joint.ranges import JointParams
from planview.tracking.kalman import FloorKalman


def seen_at(pose: np.ndarray, now_s: float = 0.0) -> Person:
    return Person.newcomer(pose, 1e-3 * np.eye(2), 100.0, Glimpse(0.0, 1.0), now_s)


def newcomer(track_id: int, x_m: float, now_s: float, log_odds: float) -> Person:
    person = seen_at(upright_pose((x_m, 3.0, 1.75)), now_s)
    person.track_id = track_id
    person.log_odds = person.proof.log_odds = person.identity.walk.evidence = log_odds
    return person


def see(person: Person, **glimpse: float) -> None:
    person.glimpse = person.glimpse._replace(**glimpse)


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


def test_somebody_known_again_stays_as_surely_a_person():
    gone, back = newcomer(1, 0.0, 0.0, 8.0), newcomer(2, 0.0, 0.5, 8.0)
    back.proof.shape -= 8.0
    recognising([gone], [back], 0.8)
    assert JointTracker()._confidence(back) > 0.99


def test_one_tall_frame_does_not_make_a_person_of_a_low_thing():
    def seen(*heights_m):
        person = newcomer(-1, 0.0, 0.5, 8.0)
        person.identity.walk.evidence = 0.0
        see(person, visible_share=0.5, patches=20.0)
        for height_m in heights_m:
            person.proof.count_height(height_m, person.glimpse, 0.1)
        return person

    tall, stood_up, mostly_low = seen(1.7), seen(0.9, 1.7), seen(*[0.9] * 8, 1.7)
    assert stood_up.proof.upright_density == pytest.approx(0.5 * tall.proof.upright_density)
    assert [JointTracker()._is_sure(person) for person in (tall, stood_up, mostly_low)] == [True, True, False]


def test_somebody_just_born_is_as_likely_as_not():
    assert JointTracker()._confidence(seen_at(upright_pose((0.0, 3.0, 1.7)))) == pytest.approx(0.5 * 0.9)


def test_somebody_may_carry_something_above_the_head():
    proof = Proof()
    proof.count_height(2.1, Glimpse(0.0, 1.0, patches=20.0), 0.1)
    assert proof.upright_density > 0.05


def test_who_walks_out_is_expected_ahead_or_back_in_the_door():
    # After 0.7 s a walker has gone on for 0.7 s (1 - 1/e), at 1 m/s 0.44 m.
    walker = newcomer(1, 0.0, 0.0, 3.0)
    walker.last_seen = Sighting(0.0, FloorKalman(np.array([0.0, 3.0, 1.0, 0.0]), np.eye(4)))
    found = [newcomer(-1, x_m, 0.7, 3.0) for x_m in (0.44, 0.0, -0.88)]  # -0.88 is three deviations from the door
    ahead, back, behind = (_log_odds(walker, person, [], 20.0, 0.1) for person in found)
    assert ahead > back > 2.0 > 0.0 > behind


def test_clothes_tell_people_apart_as_far_as_others_do_not_wear_them():
    def dressed(code):
        clothes = Clothes()
        clothes.histograms[:, code] = 5.0
        return clothes

    black, white = 0, CODES - 1
    blacks, whites = stranger_colours([dressed(black)]), stranger_colours([dressed(white)])
    assert dressed(black).log_odds_same(dressed(black), whites) == pytest.approx(6.0)  # the most of three parts
    assert dressed(black).log_odds_same(dressed(black), blacks) < 3.0
    assert dressed(black).log_odds_same(dressed(white), whites) == pytest.approx(-6.0)
    assert dressed(black).log_odds_same(Clothes(), whites) == pytest.approx(0.0, abs=1e-6)


def test_a_newcomer_who_may_be_somebody_known_has_no_id_before_the_clothes_have_been_seen():
    gone, found = newcomer(1, 0.0, 0.0, 8.0), newcomer(-1, 0.4, 2.0, 8.0)
    tracker = recognising([gone], [found], 2.3)
    assert not found.confirmed
    for person in (gone, found):
        person.identity.clothes.histograms[:, 0] = 5.0
        person.identity.clothes.frames = 5
    tracker._recognise(coloured=True)
    assert found.confirmed and found.track_id == 1


def test_somebody_whose_head_is_out_of_view_is_no_stranger():
    gone, legs = newcomer(1, -0.5, 0.0, 8.0), newcomer(2, 0.0, 1.0, 8.0)
    gone.identity.stature.mean_m, legs.height_m = 1.9, 0.8
    see(legs, inside_share=0.4)
    tracker = recognising([gone], [legs], 2.1)
    assert not legs.confirmed
    see(legs, inside_share=0.9)  # all but the head: a stranger now
    tracker._recognise(coloured=True)
    assert legs.confirmed and legs.track_id == 1


@pytest.mark.parametrize(("tall_m", "confirmed"), [(1.9, False), (1.7, True)])
def test_before_the_head_shows_nobody_is_a_stranger_who_may_be_as_tall_as_somebody_who_left(tall_m, confirmed):
    gone, feet = newcomer(7, 0.0, 0.0, 8.0), newcomer(-1, 1.8, 2.0, 8.0)
    gone.identity.stature = Stature(tall_m, 0.02**2)
    see(feet, inside_share=0.9)
    feet.identity.clothes.frames = 5  # clothes that say nothing
    assert -1.0 < _log_odds(gone, feet, [], 20.0, 0.1) < -0.5  # a height of 1.9 m adds 1.0, one of 1.7 m 0.4
    tracker = recognising([gone], [feet], 2.5)
    assert feet.confirmed == confirmed
    feet.height_m = 1.7
    see(feet, head_in_view=True)
    tracker._recognise(coloured=True)
    assert feet.confirmed


def test_frames_without_colours_are_no_time_in_which_clothes_could_have_been_seen():
    person = newcomer(-1, 0.0, 0.0, 8.0)
    see(person, head_in_view=True)
    assert person.will_show_more(0.9, coloured=True) and not person.will_show_more(1.1, coloured=True)
    person.blind_s = 0.5
    assert person.will_show_more(1.4, coloured=True) and not person.will_show_more(1.6, coloured=True)


def test_colours_that_have_shown_are_expected_again_for_three_seconds():
    tracker, rays = JointTracker(), oblique_camera()
    coloured = look_at(rays, [(0.0, 3.0, 1.75)], [CODES - 1])
    grey = replace(coloured, colour=None)
    expected = []
    for now_s, view in ((0.0, grey), (1.0, coloured), (3.9, grey), (4.1, grey)):
        tracker._life.begin(now_s)
        expected.append(tracker._expects_colours(Explanation([view], tracker._likelihood)))
    assert expected == [False, True, True, False]


def test_people_who_touch_while_there_are_no_colours_may_have_been_exchanged():
    exchanges = Exchanges(JointParams())
    exchanges.update([newcomer(1, 0.0, 0.0, 8.0), newcomer(2, 0.5, 0.0, 8.0), newcomer(3, 2.0, 0.0, 8.0)], (), 0.0)
    assert exchanges._evidence == {(1, 2): 0.0}


@pytest.mark.parametrize(("head_in_view", "std_m"), [(True, 0.02), (False, 0.2)])
def test_a_place_is_known_to_half_a_step_while_the_head_is_out_of_view(head_in_view, std_m):
    tracker, person = JointTracker(), newcomer(1, 0.0, 0.0, 4.0)
    person.kalman = FloorKalman.from_measurement(np.zeros(2), 25.0 * np.eye(2), 1.0)  # hardly known before
    see(person, head_in_view=head_in_view)
    samples = SimpleNamespace(precision=lambda pose, curvature: (0.02**2 * np.eye(2), 0.0))
    tracker._measure(person, samples, upright_pose((0.1, 0.0, 1.7)), np.zeros(6), np.zeros(8), 0.1)
    assert person.kalman.position_std_m == pytest.approx(std_m, rel=0.02)


def test_which_way_somebody_faces_is_not_known_before_a_silhouette_is_seen():
    person = seen_at(upright_pose((0.0, 0.6, 1.75)))
    assert np.isnan(person.stance.reported_facing).all()


def test_a_lean_moves_the_head_alone():
    person = seen_at(np.array([1.0, 2.0, 1.7, np.pi / 2, 0.2]))
    assert person.at_m == pytest.approx((1.0, 2.0)) and person.head_m == pytest.approx((1.0, 2.2))


def test_a_lean_follows_what_is_seen_of_it():
    stance, standing = Stance(), Gait.of(FloorKalman.at(0.0, 0.0, 0.1))
    leaning, as_before = np.array([0.0, 0.0, 1.7, 0.0, 0.15]), body.LEAN_STD_M**-2
    along_x = -50.0 * np.sin(np.arange(8) * np.pi / 8) ** 2
    stance.measure(leaning, along_x, np.array([50.0, as_before]), 1.0, standing)  # as well seen as it was known
    assert stance.lean_m == pytest.approx(0.075)
    stance.measure(leaning, along_x, np.array([50.0, 0.0]), 1.0, standing)  # not seen
    assert stance.lean_m == pytest.approx(0.075)


def test_the_deviation_of_a_place_holds_errors_that_all_pixels_share():
    person = newcomer(1, 0.0, 0.0, 4.0)
    person.kalman = FloorKalman.from_measurement(np.zeros(2), 0.03**2 * np.eye(2))
    person.height_m = person.identity.stature.mean_m = 1.7
    see(person, shared_std_m=0.04)
    assert person.head_std_m == pytest.approx(0.05)
    person.stance.lean_m = 0.2
    assert person.head_std_m == pytest.approx(np.hypot(0.05, body.LEAN_ERROR * 0.2))
