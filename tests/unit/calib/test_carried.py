"""State as plain values, and back."""

import json
import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pytest

from calib.carried import Carried, plain, restore
from calib.types import F64


class Place(NamedTuple):
    at_m: F64


@dataclass(slots=True, eq=False)
class Somebody:
    name: str
    place: Place | None = None
    met: list[tuple[Place, int]] = field(default_factory=list)


class Lights(Carried):
    def __init__(self) -> None:
        self.lit = {"door": np.zeros(2)}


class Room(Carried):
    CARRIED = "people", "guest", "lights", "rng"
    RECORDS = Somebody, Place

    def __init__(self) -> None:
        ann = Somebody("Ann", Place(np.array([1.0, 2.0])), [(Place(np.zeros(2)), 7)])
        self.people, self.guest = {1: ann, 2: Somebody("Bo"), 3: ann}, (ann, 0.5)
        self.lights, self.rng, self.size = Lights(), np.random.default_rng(3), 4


@pytest.mark.parametrize(
    "value",
    [
        None, True, 7, 2**127, -0.0, math.inf, "é", (1, (2.5,)), [1, "a"], {(1, 2): [3]}, {3, 1}, {"tuple": {}},
        deque([1, 2], maxlen=3),
        np.float32(0.1), np.float64(0.1), np.int64(-3), np.timedelta64(3, "s"),
    ],
)  # fmt: skip
def test_value_comes_back_with_its_type(value):
    back = restore(plain(value))
    assert (type(back), repr(back)) == (type(value), repr(value))


def test_state_is_json_apart_from_its_arrays():
    arrays = []
    json.dumps(Room().state(), default=lambda value: arrays.append(value))
    assert len(arrays) == 3
    assert all(isinstance(array, np.ndarray) for array in arrays)


@pytest.mark.parametrize("value", [Somebody("Ann"), lambda: 1, np.array([object()]), print])
def test_what_is_no_plain_value_is_refused(value):
    with pytest.raises(TypeError, match="cannot hold"):
        plain({"it": [0, value]})


def test_records_come_back_as_their_classes():
    room = Room()
    room.people, room.guest = {}, (Somebody("Cy"), 0.0)
    room.set_state(Room().state())
    ann, bo = room.people[1], room.people[2]
    assert isinstance(ann.place, Place)
    assert ann.place.at_m.tolist() == [1.0, 2.0]
    assert isinstance(ann.met[0][0], Place)
    assert ann.met[0][1] == 7
    assert (bo.name, bo.place, bo.met) == ("Bo", None, [])


def test_record_in_several_places_is_one_again():
    room = Room()
    room.set_state(Room().state())
    assert room.people[1] is room.people[3] is room.guest[0]


def test_state_is_a_copy_both_ways():
    room = Room()
    state = room.state()
    for _ in range(2):
        room.lights.lit["door"] += 1.0
        room.people[1].met.clear()
        room.set_state(state)
        assert room.lights.lit["door"].tolist() == [0.0, 0.0]
        assert len(room.people[1].met) == 1


def test_random_generator_goes_on_with_the_same_numbers():
    room, other = Room(), Room()
    room.rng.normal(size=5)
    other.set_state(room.state())
    assert other.rng.normal(size=4).tolist() == room.rng.normal(size=4).tolist()
