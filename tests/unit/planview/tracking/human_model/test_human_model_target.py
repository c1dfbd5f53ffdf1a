"""States of single targets, and the rules that reacquire and prune them, on hand-made targets."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from planview.tracking.human_model.params import ExistenceParams, HumanModelParams, StabilityParams
from planview.tracking.human_model.pruning import prune_reason, reacquirable
from planview.tracking.human_model.seat import Seat
from planview.tracking.human_model.target import Build, Target
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import Existence, LifeCycle

PARAMS = HumanModelParams()
FPS = 10


def _target(track_id: int = 1, confirmed: bool = True, observed: bool = True, **changes: object) -> Target:
    existence = Existence(track_id, 0.0, 0.0, confirmed, observed)
    target = Target(existence, FloorKalman.at(0.0, 0.0, 0.1, 1.5), Build(1.0, np.zeros(2)), np.zeros(2))
    for name, value in changes.items():
        setattr(target, name, value)
    return target


def _trail(target: Target, speed: float, moving: float, visible: Iterable[float]) -> Target:
    for k, v in enumerate(visible):
        target.kalman = target.kalman.moved_to(speed * k / FPS, 0.0)
        target.remember(k / FPS, moving, v, 0.8)
    return target


@pytest.mark.parametrize(
    ("speed", "moving", "state"), [(1.0, 0.3, "moving"), (0.0, 0.05, "stopped"), (0.0, 0.0, "stationary")]
)
def test_motion_state(speed: float, moving: float, state: str) -> None:
    assert _trail(_target(), speed, moving, [1.0] * 10).next_motion(StabilityParams()) == state


@pytest.mark.parametrize(
    ("visible", "shared", "state"),
    [
        (np.linspace(0.2, 1.0, 9), 0.0, "appearing"),
        (np.linspace(1.0, 0.2, 9), 0.0, "disappearing"),
        ([0.8] * 9, 0.0, "stable"),
        (np.linspace(1.0, 0.2, 9), 0.3, "occlusion"),
    ],
)
def test_stability_state(visible: Iterable[float], shared: float, state: str) -> None:
    assert _trail(_target(shared=shared), 1.0, 0.1, visible).next_stability(StabilityParams()) == state


@pytest.mark.parametrize(
    ("target", "now_s", "reason"),
    [
        (_target(), 1.0, ""),
        (_target(confirmed=False), 3.0, "never walked"),
        (_target(still_since_s=0.0), 20.0, "stationary: a thing"),
        (_target(inside=0.2), 1.0, "left the view"),
        (_target(observed=False, inside=0.5), 0.1, "no blob for 0.1 s"),
        (_target(observed=False, support_s=1.0), 2.0, ""),
        (_target(observed=False), 3.5, "no blob for 3.5 s"),
    ],
)
def test_pruning_depends_on_visibility(target: Target, now_s: float, reason: str) -> None:
    life = LifeCycle()
    life.begin(now_s)
    assert prune_reason(_trail(target, 0.0, 0.1, [1.0]), PARAMS, life) == reason


def test_support_grows_with_observation_up_to_the_patience() -> None:
    target, params = _target(), ExistenceParams(trust=0.5, patience_s=3.0)
    target.weigh(2.0, hidden=False, params=params)
    assert target.support_s == 1.0
    target.weigh(10.0, hidden=False, params=params)
    assert target.support_s == 3.0


def test_support_is_used_up_faster_by_a_person_half_outside_the_image() -> None:
    whole, half = _target(observed=False, support_s=3.0), _target(observed=False, support_s=3.0, inside=0.5)
    for target in (whole, half):
        target.weigh(1.0, hidden=False, params=ExistenceParams())
    assert (whole.support_s, half.support_s) == (2.0, 1.0)


def test_support_stays_while_others_hide_a_person() -> None:
    target = _target(support_s=1.5)
    target.weigh(1.0, hidden=True, params=ExistenceParams())
    assert target.support_s == 1.5


def test_travel_counts_only_while_observed() -> None:
    target = _trail(_target(observed=False), 2.0, 0.1, [1.0] * 10)
    assert target.build.travel_m == 0.0


@pytest.mark.parametrize(("std_m", "walked_m"), [(0.1, 0.9), (1.0, 0.0)])
def test_what_may_be_an_error_of_measurement_is_no_walk(std_m: float, walked_m: float) -> None:
    target = _trail(_target(kalman=FloorKalman.at(0.0, 0.0, std_m, 1.5)), 1.0, 0.1, [1.0] * 10)
    assert target.build.travel_m == pytest.approx(walked_m)


@pytest.mark.parametrize(("likeness", "found"), [(0.5, True), (0.0, False), (math.nan, True)])
def test_lost_target_nearby_is_reacquired_unless_it_looks_different(likeness: float, found: bool) -> None:
    target = _target(observed=False)
    same = reacquirable([target], np.array([0.5, 0.0]), lambda _: likeness, PARAMS, 1.0)
    assert (same is target) == found


@pytest.mark.parametrize(("now_s", "likeness", "found"), [(1.0, 0.5, True), (1.0, 0.0, False), (5.0, 0.5, False)])
def test_person_who_has_just_sat_down_and_walks_on_is_the_same(now_s: float, likeness: float, found: bool) -> None:
    target = _target()
    empty = np.zeros((0, 0), np.float32)
    target.seat = Seat(np.zeros(2), 0.0, 0.7, (slice(0), slice(0)), empty > 0, empty)
    same = reacquirable([target], np.array([0.5, 0.0]), lambda _: likeness, PARAMS, now_s)
    assert (same is target) == found
