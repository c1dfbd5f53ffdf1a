"""Times of frames: even, in bursts, with gaps, begun again, and clocks that were set."""

import numpy as np
import pytest

from calib.times import RunningClock, doubts, rate_of_times, run_on, spread_bursts


def in_bursts(of: int, count: int = 40) -> np.ndarray:
    """Frames at 10 per second that are read ``of`` at a time."""
    n = np.arange(count)
    return n // of * of / 10 + n % of * 0.002


@pytest.mark.parametrize("of", [2, 5])
def test_frames_that_arrive_in_bursts_are_spread_from_burst_to_burst(of: int) -> None:
    rate = rate_of_times(in_bursts(of))
    assert rate is not None and rate.burst == of and rate.fps == pytest.approx(10.0, rel=0.15)
    spread, notes = spread_bursts(in_bursts(of), rate)
    assert spread[:30] == pytest.approx(np.arange(30) / 10, abs=0.01)
    assert f"bursts of about {of}" in notes[0]


@pytest.mark.parametrize(
    ("times", "note"),
    [
        (np.arange(20) / 10, ""),
        (np.delete(np.arange(40) / 10, [3, 4, 9, 20, 21, 30]), ""),
        (np.arange(20) * 10.0, "a frame every 10 s, at which nobody can be followed"),
        (np.cumsum(np.tile([0.08, 0.12, 0.04, 0.14], 8)), "times are uneven: steps of "),
    ],
    ids=["even", "gaps", "timelapse", "uneven"],
)
def test_what_is_no_burst_is_left_and_said(times: np.ndarray, note: str) -> None:
    rate = rate_of_times(times)
    assert rate is not None and rate.burst == 1 and rate.note.startswith(note) and bool(rate.note) == bool(note)
    assert spread_bursts(times, rate)[0] is times


def test_times_that_begin_again_run_on() -> None:
    times, notes = run_on(np.array([0.0, 0.1, 0.2, 0.3, 0.0, 0.2]), np.array([0, 1, 2, 3, 4, 6]))
    assert times == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.6]) and "begin again at frame 4" in notes[0]


def test_a_frame_that_is_a_little_late_begins_nothing() -> None:
    times = np.array([0.0, 0.1, 0.3, 0.2])
    assert run_on(times)[0] is times


def test_running_clock_goes_on_after_a_time_far_ahead_and_leaves_out_what_does_not_advance() -> None:
    clock = RunningClock(10.0)
    own = [0.0, 0.1, 1e6, 0.3, 0.4, 0.4]
    found = [clock.time(index, time) for index, time in enumerate(own)]
    assert [time for time, _ in found[:5]] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert [bool(why) for _, why in found] == [False] * 5 + [True]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (np.arange(10) / 10, ""),
        (np.arange(10) * 33.0, "a frame lasts 33 s: are the times milliseconds?"),
        (np.append(np.arange(9) / 10, 3 * 86400.0), "the clock jumps by 3.0 days from frame 8 to 9"),
        (in_bursts(5), "frames come in bursts of about 5"),
    ],
    ids=["even", "ms", "jump", "bursts"],
)
def test_odd_times_of_a_table_are_named(times: np.ndarray, said: str) -> None:
    found = doubts(np.arange(len(times)), times)
    assert len(found) == bool(said) and all(sentence.startswith(said) for sentence in found)
