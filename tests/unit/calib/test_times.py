"""Times of frames: even, in bursts, with gaps, begun again, and clocks that were set."""

import numpy as np
import pytest

from calib.errors import InputError
from calib.times import (
    RunningClock,
    doubts,
    rate_of_times,
    read_stamps,
    run_on,
    seconds_of,
    spread_bursts,
    within_seconds,
)


def in_bursts(of: int, count: int = 40) -> np.ndarray:
    """Frames at 10 per second that are read ``of`` at a time."""
    n = np.arange(count)
    return n // of * of / 10 + n % of * 0.002


@pytest.mark.parametrize("of", [2, 5])
def test_frames_that_arrive_in_bursts_are_spread_from_burst_to_burst(of):
    rate = rate_of_times(in_bursts(of))
    assert rate.burst == of
    assert rate.fps == pytest.approx(10.0, rel=0.15)
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
def test_times_without_bursts_are_left(times, note):
    rate = rate_of_times(times)
    assert rate.burst == 1
    assert rate.note.startswith(note)
    assert bool(rate.note) == bool(note)
    assert spread_bursts(times, rate)[0] is times


def test_times_that_begin_again_run_on():
    times, notes = run_on(np.array([0.0, 0.1, 0.2, 0.3, 0.0, 0.2]), np.array([0, 1, 2, 3, 4, 6]))
    assert times == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.6])
    assert "begin again at frame 4" in notes[0]


def test_a_frame_that_is_a_little_late_begins_nothing():
    times = np.array([0.0, 0.1, 0.3, 0.2])
    assert run_on(times)[0] is times


def test_running_clock_runs_on_where_the_times_do_not():
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
        (45_000 + np.arange(10) / 10 / 86400, "a frame lasts 1.16e-06 s: are the times days?"),
        (np.append(np.arange(9) / 10, 3 * 86400.0), "the clock jumps by 2 days, 23:59:59 from frame 8 to 9"),
        (in_bursts(5), "frames come in bursts of about 5"),
    ],
    ids=["even", "ms", "days", "jump", "bursts"],
)
def test_odd_times_of_a_table_are_named(times, said):
    found = doubts(np.arange(len(times)), times)
    assert len(found) == bool(said)
    assert all(sentence.startswith(said) for sentence in found)


@pytest.mark.parametrize(
    ("texts", "unit", "step_ns"),
    [
        (["2023-10-29T02:59:59.9+02:00", "2023-10-29T02:00:00.1+01:00"], "date", 200_000_000),
        (["2023-10-29 00:59:59.9Z", "2023-10-29 01:00:00+00:00"], "date", 100_000_000),
        (["20231029T005959.9+0000", "20231029T010000Z"], "date", 100_000_000),
        (["20231029005959", "20231029010000"], "date", 1_000_000_000),
        (["2023/10/29 00:59:59,9", "2023/10/29 01:00:00,0"], "date", 100_000_000),
        (["23:59:58.5", "23:59:59"], "date", 500_000_000),
        (["100000", "100033"], "ms", 33_000_000),
        (["1200000000000", "1200033333333"], "ns", 33_333_333),  # 20 minutes after the start of the machine
        (["1403715273262142976", "1403715273312142976"], "ns", 50_000_000),
        (["1403715273262142", "1403715273312142"], "us", 50_000_000),
        (["1403715273262", "1403715273312"], "ms", 50_000_000),
        (["1403715273.262142976", "1403715273.312142976"], "s", 50_000_000),
        (["0", "0.05"], "s", 50_000_000),
        (["0", "33.25"], "ms", 33_250_000),
        (["0", "33250"], "us", 33_250_000),
        (["7", "33250007"], "ns", 33_250_000),
    ],
)
def test_times_are_read_in_every_way_that_recorders_write_them(texts, unit, step_ns):
    stamps = read_stamps("times.txt", texts)
    assert (stamps.unit, stamps.ns[1] - stamps.ns[0]) == (unit, step_ns)


@pytest.mark.parametrize("text", ["29.10.2023 01:00", "2023-13-01 01:00:00", "3.5", "later"])
def test_text_that_is_no_date_among_dates_is_named(text):
    with pytest.raises(InputError, match=rf"times\.txt.*'{text}'"):
        read_stamps("times.txt", ["2023-10-29 01:00:00", text])


@pytest.mark.parametrize("unit", ["1e9", "1e6", "1e3", "1"])
def test_seconds_of_a_table_are_those_since_1970_in_any_unit(unit):
    counts = (1.7e9 + np.array([0.0, 0.5])) * float(unit)
    assert seconds_of("", counts) == pytest.approx([1.7e9, 1.7e9 + 0.5])


def test_small_numbers_of_a_table_stay_seconds():
    assert seconds_of("", np.array([0.0, 33.0])).tolist() == [0.0, 33.0]


def test_dates_of_a_table_become_seconds_where_they_are_known():
    dates = np.array(["2023-10-29T02:59:59.5+02:00", "", "NaT"], object)
    np.testing.assert_array_equal(seconds_of("", dates), [1698541199.5, np.nan, np.nan])


def counted(first: int, counts: list[int]) -> tuple[list[int], list[str]]:
    """Seconds and numbers of frames that are counted in each second; the recording begins with the given one."""
    numbers = [range(first, counts[0]), *(range(count) for count in counts[1:])]
    seconds = [second for second, each in enumerate(numbers) for _ in each]
    return seconds, [f"{number:02d}" for each in numbers for number in each]


@pytest.mark.parametrize("first", [0, 6])
def test_frames_that_are_counted_in_each_second_come_evenly(first):
    seconds, parts = counted(first, [8 if first else 4, 10, 10, 5])
    decimals = within_seconds(seconds, parts)
    times = [second + float(f"0.{part}") for second, part in zip(seconds, decimals, strict=True)]
    assert np.diff(times[:24]) == pytest.approx(0.1, abs=0.21 if first else 1e-6)


def test_lost_frame_of_those_counted_in_each_second_leaves_a_gap():
    seconds, parts = counted(0, [10, 10, 10, 10])
    decimals = within_seconds([*seconds[:14], *seconds[15:]], [*parts[:14], *parts[15:]])
    assert [decimals[13][:3], decimals[14][:3]] == ["300", "500"]


def test_frames_counted_in_two_seconds_that_may_both_be_cut_have_no_times():
    assert within_seconds(*counted(0, [7, 4])) is None


@pytest.mark.parametrize(
    ("parts", "decimals"),
    [
        (["066", "133", "200"], ["066", "133", "200"]),
        (["7", "73", "140", "207"], ["007", "073", "140", "207"]),
        (["0", "66666667", "133333333"], ["000000000", "066666667", "133333333"]),
        (["5", "75"], ["5", "75"]),
    ],
)
def test_number_within_a_second_is_decimals_or_a_count_of_its_parts(parts, decimals):
    assert within_seconds([1_700_000_000] * len(parts), parts) == decimals
