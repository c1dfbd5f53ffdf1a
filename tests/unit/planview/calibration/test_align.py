"""Two heads laid over each other by the paths of people whom both see."""

import math

import numpy as np
import pytest

from calib.errors import WorkError
from calib.types import F64
from planview.calibration.align import AlignParams, RigAlignment, after, align_rigs
from planview.calibration.paths import TICK_S, WalkedPath, by_time
from planview.evaluation.align import floor_rotation

PARAMS = AlignParams(disparity_px=0.0)
TRUE = RigAlignment(math.radians(140.0), 3.0, 1.5, 2.34)


def path(times_s: F64, xy_m: F64, height_m: float = 1.7) -> WalkedPath:
    """A path at ticks from positions at any times."""
    ticks = np.arange(math.ceil(times_s[0] / TICK_S), math.floor(times_s[-1] / TICK_S) + 1)
    xy = np.column_stack([np.interp(ticks * TICK_S, times_s, column) for column in xy_m.T])
    return WalkedPath(int(ticks[0]), xy, height_m, np.zeros_like(xy))


def both_heads(xy_m: F64, noise_m: float = 0.03, seed: int = 0) -> tuple[WalkedPath, WalkedPath]:
    """What two heads measure of a person at xy (T, 2), every 0.05 s: noise and clock are those of TRUE."""
    rng = np.random.default_rng(seed)
    times = 0.05 * np.arange(len(xy_m))
    own = (xy_m - [TRUE.x_m, TRUE.y_m]) @ floor_rotation(TRUE.heading_rad)
    first, second = (p + rng.normal(0, noise_m, p.shape) for p in (xy_m, own))
    return path(times, first), path(times - TRUE.clock_s, second)


def curve(t: F64) -> F64:
    """A walk around a room."""
    return np.column_stack([1.5 * np.sin(0.5 * t) + 0.3 * np.sin(1.3 * t), 3.0 + 1.2 * np.cos(0.4 * t)])


def test_a_walk_with_turns_tells_heading_place_and_clock() -> None:
    first, second = both_heads(curve(0.05 * np.arange(600)))
    found = align_rigs([first], [second], PARAMS)
    assert math.degrees(abs(found.heading_rad - TRUE.heading_rad)) < 0.5
    assert math.hypot(found.x_m - TRUE.x_m, found.y_m - TRUE.y_m) < 0.03
    assert found.clock_s == pytest.approx(TRUE.clock_s, abs=0.02)
    assert found.shared_s == pytest.approx(30.0, abs=0.3)
    assert found.residual_m == pytest.approx(0.03, abs=0.02)
    assert abs(found.heading_rad - TRUE.heading_rad) < 3 * found.heading_std_rad


def test_one_straight_line_at_one_speed_is_refused() -> None:
    t = 0.05 * np.arange(200)
    first, second = both_heads(np.column_stack([-2.0 + 0.5 * t, np.full(len(t), 3.0)]), noise_m=0.01)
    with pytest.raises(WorkError, match=r"straight|another that fits"):
        align_rigs([first], [second], PARAMS)


def test_to_and_fro_on_a_line_is_refused() -> None:
    t = 0.05 * np.arange(600)
    first, second = both_heads(np.column_stack([1.5 * np.sin(0.7 * t), np.full(len(t), 3.0)]), noise_m=0.01)
    with pytest.raises(WorkError, match="another that fits"):
        align_rigs([first], [second], PARAMS)


def test_a_person_who_stands_is_refused() -> None:
    first, second = both_heads(np.tile([[0.5, 3.0]], (400, 1)))
    with pytest.raises(WorkError, match="stood"):
        align_rigs([first], [second], PARAMS)


def test_people_of_other_heights_do_not_meet() -> None:
    first, second = both_heads(curve(0.05 * np.arange(600)))
    taller = WalkedPath(second.first, second.xy_m, 1.95, second.per_px_m)
    with pytest.raises(WorkError, match="no path that fits"):
        align_rigs([first], [taller], PARAMS)


def test_heads_without_people_are_refused() -> None:
    with pytest.raises(WorkError, match="found none"):
        align_rigs([], [], PARAMS)


def test_a_third_head_is_placed_by_the_second() -> None:
    second, third = RigAlignment(math.pi / 2, 1.0, 2.0, 3.0), RigAlignment(math.pi / 2, 1.0, 0.0, -1.0)
    placed = after(second, third)
    assert (placed.x_m, placed.y_m, placed.clock_s) == pytest.approx((1.0, 3.0, 2.0))
    assert abs(placed.heading_rad) == pytest.approx(math.pi)


def test_paths_one_after_the_other_share_a_slot() -> None:
    ones = np.ones((30, 2))
    early, late, beside = (WalkedPath(first, ones * first, 1.7, ones) for first in (10, 40, 20))
    xy, _, first = by_time([early, late, beside])
    assert (xy.shape, first) == ((60, 2, 2), 10)
