"""People who are missing: kept in mind, recognised when somebody appears where nobody comes in, forgotten at last."""

import math
from typing import cast

import numpy as np
import pytest

from calib.types import F64
from planview.tracking.human_model.missing import Missing
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.target import Build, Target
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import Existence

PARAMS = HumanModelParams()
FAR = 2.0 * PARAMS.prune.vanished_m


class _View:
    """A camera that looks straight down with 1 px per metre; the border of its image is at x = -1."""

    def __init__(self) -> None:
        self.model_map = self.camera = self

    def project(self, xyz_m: F64) -> F64:
        return xyz_m[:2]

    def visibility(self, position: F64) -> float:
        return 1.0 if position[0] > -1.0 else 0.5


def _missing() -> Missing:
    return Missing(PARAMS, cast("ModelScene", _View()))


def _at(x_m: float, track_id: int = 1, since_s: float = 0.0, confirmed: bool = True) -> Target:
    """A person last observed at ``since_s``: lost since then if confirmed, else new."""
    existence = Existence(track_id, since_s, since_s, confirmed, observed=not confirmed)
    place = np.array([x_m, 0.0])
    return Target(existence, FloorKalman.at(x_m, 0.0, 0.1, 1.5), Build(1.0, place), np.zeros(2))


def _alike(target: Target) -> float:
    return 1.0


def test_nearest_missing_person_is_who_appears() -> None:
    missing, near, far = _missing(), _at(1.0, 1), _at(9.0, 2)
    assert missing.keep(far)
    assert missing.keep(near)
    assert missing.who_appears(_at(3.0, 3, 5.0, confirmed=False), [], _alike) is near


def test_missing_person_who_looks_otherwise_is_passed_over() -> None:
    missing, near, far = _missing(), _at(1.0, 1), _at(9.0, 2)
    missing.keep(near)
    missing.keep(far)
    newcomer = _at(3.0, 3, 5.0, confirmed=False)
    assert missing.who_appears(newcomer, [], lambda t: 0.0 if t is near else math.nan) is far


@pytest.mark.parametrize(("lost_s", "found"), [(4.0, True), (6.0, False)])
def test_person_who_is_still_looked_for_appears_when_lost_before(lost_s: float, found: bool) -> None:
    lost = _at(1.0, 1, lost_s)
    assert (_missing().who_appears(_at(3.0, 2, 5.0, confirmed=False), [lost], _alike) is lost) == found


def test_who_comes_in_over_the_border_is_new() -> None:
    missing = _missing()
    missing.keep(_at(1.0))
    assert missing.who_appears(_at(-2.0, 2, 5.0, confirmed=False), [], _alike) is None


def test_who_was_observed_leaving_the_view_is_not_missing() -> None:
    person = _at(0.0)
    person.inside = 0.5
    assert not _missing().keep(person)


@pytest.mark.parametrize(("before", "entrance"), [(1, False), (2, True)])
def test_place_where_people_have_appeared_is_an_entrance(before: int, entrance: bool) -> None:
    missing = _missing()
    for k in range(before):
        missing.learn(_at(FAR, k + 1, confirmed=False))
    missing.keep(_at(0.0, 8))
    assert (missing.who_appears(_at(FAR, 9, 5.0, confirmed=False), [], _alike) is None) == entrance
    assert missing.keep(_at(FAR, 10)) != entrance


def test_appearances_beside_others_and_while_somebody_is_missing_tell_no_entrance() -> None:
    missing, beside = _missing(), _at(FAR, 1, confirmed=False)
    beside.splits = True
    for _ in range(2):
        missing.learn(beside)
    missing.keep(_at(0.0, 2))
    for _ in range(2):
        missing.learn(_at(FAR, 3, confirmed=False))
    assert missing.keep(_at(FAR, 4))


def test_missing_people_are_forgotten_after_ten_minutes() -> None:
    missing, person = _missing(), _at(0.0)
    missing.keep(person)
    assert not missing.forgotten(600.0)
    assert missing.forgotten(600.1) == [person]
    assert not list(missing)


def test_who_is_missing_where_nobody_is_left_to_hide_them_has_gone() -> None:
    missing, person = _missing(), _at(0.0)
    missing.keep(person)
    missing.watch([_at(0.9 * PARAMS.prune.vanished_m, 2), _at(FAR, 3)])
    assert missing.hidden == (person,)
    missing.watch([_at(FAR, 3)])
    assert missing.hidden == ()
    assert list(missing) == [person]
