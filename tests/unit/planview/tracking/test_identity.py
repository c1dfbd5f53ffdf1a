import numpy as np
import pytest

from planview.tracking.appearance_model import Appearance
from planview.tracking.identity import IdentityLayer, IdentityParams
from planview.tracking.lifecycle import Existence, LifeCycle

RED = Appearance(np.array([[1.0, 0.0, 0.0]], np.float32), 1.70)
BLUE = Appearance(np.array([[0.0, 0.0, 1.0]], np.float32), 1.70)
GREY = Appearance(np.zeros((1, 3), np.float32), 1.70)


def two_people(first: Appearance, second: Appearance, params: IdentityParams | None = None):
    """A layer that knows two people, who are in contact at 1 s."""
    layer = IdentityLayer(params or IdentityParams())
    one, two = Existence(1, 0.0, 1.0, True), Existence(2, 0.0, 1.0, True)
    for _ in range(10):
        layer.learn(one, first)
        layer.learn(two, second)
    layer.contact(one, two, 1.0)
    return layer, one, two


def measure(layer: IdentityLayer, *looks: tuple[Existence, Appearance]) -> None:
    for _ in range(5):
        for who, appearance in looks:
            layer.learn(who, appearance)


def test_two_people_who_took_each_others_place_are_exchanged() -> None:
    layer, one, two = two_people(RED, BLUE)
    measure(layer, (one, BLUE), (two, RED))
    (exchange,) = layer.exchanges([one, two], 2.0)
    assert exchange.places == (one, two) and exchange.identities == (two, one)
    assert exchange.confidence > 0.95


def test_two_people_who_stayed_are_left_alone() -> None:
    layer, one, two = two_people(RED, BLUE)
    measure(layer, (one, RED), (two, BLUE))
    assert layer.exchanges([one, two], 2.0) == []
    assert not layer.in_doubt(one)


def test_two_people_in_the_same_clothes_are_never_exchanged() -> None:
    layer, one, two = two_people(RED, RED)
    measure(layer, (one, RED), (two, RED))
    assert layer.exchanges([one, two], 2.0) == []


def test_a_contact_stays_in_doubt_until_everybody_has_been_measured() -> None:
    layer, one, two = two_people(RED, BLUE)
    measure(layer, (one, RED))
    assert layer.exchanges([one, two], 2.0) == []
    assert layer.in_doubt(one) and layer.in_doubt(two)


def test_one_clear_measurement_series_is_enough_to_mend_an_exchange() -> None:
    layer, one, two = two_people(RED, BLUE)
    measure(layer, (one, BLUE))
    assert len(layer.exchanges([one, two], 2.0)) == 1


def test_a_newcomer_who_looks_like_an_absent_person_is_known() -> None:
    layer, one, two = two_people(RED, BLUE)
    newcomer = Existence(3, 5.0, 5.0)
    measure(layer, (newcomer, BLUE))
    assert layer.known_as(newcomer, [one, two]) == (two, pytest.approx(0.99, abs=0.01))
    assert layer.known_as(newcomer, [one]) is None


def test_a_track_on_another_person_takes_the_identity_of_the_one_that_was_lost() -> None:
    layer, one, two = two_people(RED, BLUE)
    two.observed = False
    measure(layer, (one, BLUE))
    (exchange,) = layer.exchanges([one, two], 2.0)
    assert exchange.places == (one, two) and exchange.identities == (two, one)


def test_three_people_who_moved_round_are_put_back_jointly() -> None:
    looks = [Appearance(row[None].astype(np.float32)) for row in np.eye(3)]
    layer = IdentityLayer(IdentityParams())
    people = [Existence(i + 1, 0.0, 1.0, True) for i in range(3)]
    for who, look in zip(people, looks, strict=True):
        measure(layer, (who, look))
    layer.contact(people[0], people[1], 1.0)
    layer.contact(people[1], people[2], 1.0)
    measure(layer, *zip(people, [looks[1], looks[2], looks[0]], strict=True))
    (exchange,) = layer.exchanges(people, 2.0)
    assert exchange.identities == (people[1], people[2], people[0])


def test_body_height_tells_apart_where_there_is_no_colour() -> None:
    tall = Appearance(GREY.colours, 1.95)
    layer, one, two = two_people(GREY, tall)
    measure(layer, (one, tall), (two, GREY))
    assert len(layer.exchanges([one, two], 2.0)) == 1


def test_a_contact_too_old_is_settled_as_it_is() -> None:
    layer, one, two = two_people(RED, BLUE)
    measure(layer, (one, BLUE), (two, RED))
    assert layer.exchanges([one, two], 1.0 + IdentityParams().doubt_s + 0.1) == []
    assert not layer.in_doubt(one)


def test_only_people_who_are_tracked_stay_remembered() -> None:
    layer, one, two = two_people(RED, BLUE)
    layer.retain([one])
    assert layer.remembered(one) is not None and layer.remembered(two) is None


def test_identity_layer_that_is_off_finds_nothing() -> None:
    layer, one, two = two_people(RED, BLUE, IdentityParams(enabled=False))
    measure(layer, (one, BLUE), (two, RED))
    assert layer.exchanges([one, two], 2.0) == []


def test_unlikelihood_tells_the_same_person_from_another() -> None:
    layer, one, _ = two_people(RED, BLUE)
    assert layer.unlikelihood(one, RED) == pytest.approx(0.0, abs=1e-6)
    # Nothing in common: a Hellinger distance of 1, in deviations of 0.12.
    assert layer.unlikelihood(one, BLUE) == pytest.approx(1 / (2 * 0.12**2))


def test_reassigned_identities_move_with_their_times_and_are_logged() -> None:
    life = LifeCycle()
    life.begin(0.0)
    one, two = life.spawn("a"), life.spawn("b")
    life.begin(3.0)
    life.confirm(two, "tracked")
    life.reassign([one, two], [two, one], 0.99)
    assert (one.track_id, two.track_id) == (2, 1)
    assert one.confirmed and not two.confirmed
    assert [d.kind for d in life.decisions] == ["confirmed", "identity", "identity"]


def test_life_cycle_tells_states_and_reasons() -> None:
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
