"""Cameras that move apart in time, from thumbnails alone."""

import numpy as np
import pytest

from calib.types import F64, U8
from planview.checks.timing import (
    BLOCKS_MAX,
    WINDOW,
    MotionFindings,
    MotionWatch,
    Thumbnails,
    lag_of,
    lag_sums,
    motion_checks,
    thumbnails,
)

FRAMES = 60


def picture(t: float, shift: int) -> U8:
    """A square of 20 px that moves along the diagonal, to and fro, with noise; ``shift`` is its disparity."""
    image = np.random.default_rng((round(1000 * t), shift)).integers(58, 63, (96, 120), dtype=np.uint8)
    place = round(35 + 25 * np.sin(t / 5.0) + 8 * np.sin(t / 1.7))
    image[place : place + 20, place + 10 - shift : place + 30 - shift] = 200
    return image


def watched(left: list[U8], right: list[U8]) -> MotionFindings:
    watch = MotionWatch()
    for pair in zip(left, right, strict=True):
        watch.update(Thumbnails(*pair))
    return watch.findings()


@pytest.fixture(scope="module")
def sides() -> tuple[list[U8], list[U8]]:
    return [picture(i, 0) for i in range(FRAMES)], [picture(i, 6) for i in range(FRAMES)]


def failing(found: MotionFindings) -> set[str]:
    return {check.name for check in motion_checks(found) if not check.ok}


def test_cameras_in_step_pass(sides: tuple[list[U8], list[U8]]) -> None:
    found = watched(*sides)
    assert abs(found.lag) < 0.2 and failing(found) == set()


@pytest.mark.parametrize("late", [1, 2, 3, 8])
def test_right_images_that_are_late_are_told_with_their_lag(sides: tuple[list[U8], list[U8]], late: int) -> None:
    found = watched(sides[0][late:], sides[1][:-late])
    assert found.lag == pytest.approx(late, abs=0.3)
    assert "synchronisation" in failing(found)


def test_left_images_that_are_late_have_a_negative_lag(sides: tuple[list[U8], list[U8]]) -> None:
    assert watched(sides[0][:-2], sides[1][2:]).lag == pytest.approx(-2, abs=0.3)


def test_frozen_right_camera_is_told(sides: tuple[list[U8], list[U8]]) -> None:
    found = watched(sides[0], [sides[1][0]] * FRAMES)
    assert found.frozen == 1.0 and {"frozen camera", "stalled camera"} <= failing(found)


def test_camera_that_stalls_once_is_told_by_the_length_of_the_stall(sides: tuple[list[U8], list[U8]]) -> None:
    left, right = sides
    found = watched(left * 5, (right[:20] + [right[19]] * 12 + right[32:]) + right * 4)
    assert found.frozen < 0.1 and 10 <= found.stall <= 12
    assert failing(found) == {"stalled camera"}


def test_second_half_that_is_late_is_told(sides: tuple[list[U8], list[U8]]) -> None:
    long = [[picture(i * 1.0 + 0.001 * i * i, shift) for i in range(360)] for shift in (0, 6)]
    found = watched(long[0], long[1][:180] + long[1][165:345])
    assert found.lag == pytest.approx(15, abs=1.0)


def wave(late: float, frames: int = WINDOW, seed: int = 0) -> F64:
    t = np.arange(frames)[:, None] - late + np.array([0.0, 20.0, 40.0])
    noise = np.random.default_rng((seed, round(10 * late) + 100)).normal(0, 0.05, (frames, 3))
    return np.asarray(np.sin(t / 3.0) + 0.5 * np.sin(t / 7.0) + noise, dtype=np.float64)


@pytest.mark.parametrize("late", [2.5, -2.5])
def test_lag_is_found_between_frames_within_its_deviation(late: float) -> None:
    lag = lag_of(lag_sums(wave(0.0), wave(late)))
    assert lag.frames == pytest.approx(late, abs=0.15) and abs(lag.frames - late) < 4 * lag.std + 0.05
    assert lag.surely > 1.5


def test_lag_of_cameras_in_step_is_never_sure_whatever_the_noise() -> None:
    lags = [lag_of(lag_sums(wave(0.0, seed=seed), wave(0.01, seed=seed))) for seed in range(20)]
    assert all(lag.surely < 0.5 for lag in lags)


def test_one_burst_of_movement_that_one_camera_saw_later_is_not_sure() -> None:
    left, right = np.zeros((WINDOW, 3)), np.zeros((WINDOW, 3))
    left[47:51], right[55:59] = 1.0, 1.0  # somebody comes into the right camera's view eight frames later
    lag = lag_of(lag_sums(left, right))
    assert not lag.surely > 0.5


def test_nothing_that_moves_has_no_lag() -> None:
    assert np.isnan(lag_of(lag_sums(np.zeros((60, 3)), np.zeros((60, 3)))).frames)


def test_memory_of_movement_is_bounded() -> None:
    watch, still = MotionWatch(), Thumbnails(picture(0, 0), picture(0, 6))
    for _ in range(20 * WINDOW):
        watch.update(still)
    assert len(watch._sums) <= BLOCKS_MAX


def test_every_fifth_pair_a_copy_is_told(sides: tuple[list[U8], list[U8]]) -> None:
    left, right = ([side[i * 4 // 5] for i in range(FRAMES)] for side in sides)
    assert watched(left, right).repeated == pytest.approx(0.17, abs=0.05)


def test_still_scene_says_nothing() -> None:
    still = [picture(0, 0)] * FRAMES
    assert np.isnan(watched(still, still).lag) and failing(watched(still, still)) == set()


def test_thumbnails_leave_out_what_one_camera_alone_shows() -> None:
    left, right = np.zeros((48, 80), np.uint8), np.zeros((48, 80), np.uint8)
    left[:, :10], right[:, 70:] = 255, 255
    small = thumbnails(left, right)
    assert small.left.shape == small.right.shape == (24, 35)
    assert not small.left.any() and not small.right.any()
