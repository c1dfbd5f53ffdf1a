from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from stereo.readers.pairing import pair_stamps
from stereo.readers.times import load_timestamps, rate_of_times, read_stamps, stamps_in_names

STEP = 100_000_000
NOW = 1_650_000_000_000_000_000
EVEN = NOW + STEP * np.arange(10)


@pytest.mark.parametrize(
    ("texts", "unit", "first", "step"),
    [
        (["1403715273262142976", "1403715273312142976"], "ns", 1403715273262142976, 50_000_000),
        (["1403715273262142", "1403715273312142"], "us", 1403715273262142000, 50_000_000),
        (["1403715273262", "1403715273312"], "ms", 1403715273262000000, 50_000_000),
        (["1403715273.262142976", "1403715273.312142976"], "s", 1403715273262142976, 50_000_000),
        (["0", "0.05"], "s", 0, 50_000_000),
        (["0", "33.25"], "ms", 0, 33_250_000),
        (["0", "33250"], "us", 0, 33_250_000),
        (["7", "33250007"], "ns", 7, 33_250_000),
        (["2022-04-15 05:20:00.5", "2022-04-15T05:20:01Z"], "date", 1_650_000_000_500_000_000, 500_000_000),
    ],
)
def test_unit_of_times_is_recognised_and_no_digit_is_lost(texts: list[str], unit: str, first: int, step: int) -> None:
    stamps = read_stamps(texts)
    assert (stamps.unit, stamps.ns[0], stamps.ns[1] - stamps.ns[0]) == (unit, first, step)


@pytest.mark.parametrize("text", ["nan", "1e300", "9" * 30, "soon", ""])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        read_stamps([text, "1"])


def test_names_hold_times_only_when_no_counter_is_like_them() -> None:
    found = stamps_in_names(["rgb_1650000000.066", "rgb_1650000000.133"])
    assert found is not None and found.ns[1] - found.ns[0] == 67_000_000
    assert stamps_in_names(["1403715273262142976", "1403715273312143104"]) is not None
    assert stamps_in_names(["left0001", "left0002"]) is None
    assert stamps_in_names(["0000000001", "0000000003"]) is None
    assert stamps_in_names(["2022041501", "2022041502"]) is None


def test_frames_pair_with_the_nearest_within_a_quarter_period() -> None:
    right = np.delete(EVEN, 6) + np.array([0, 0, 0, 26, 0, 0, 0, 0, 0]) * STEP // 100
    pairs = pair_stamps(EVEN, right)
    frames = list(zip(pairs.left.tolist(), pairs.right.tolist(), strict=True))
    assert frames[2:5] == [(2, 2), (3, -1), (-1, 3)] and frames[7] == (6, -1)
    assert pairs.unpaired == 3 and pairs.fps == pytest.approx(10.0)
    assert "3 of 11 frames without a mate within 25.0 ms" in pairs.notes[0]


def test_frames_recorded_late_are_put_in_their_place() -> None:
    late = EVEN[[0, 1, 3, 2, 4, 5, 6, 7, 8, 9]]
    pairs = pair_stamps(late, EVEN)
    assert pairs.left.tolist() == [0, 1, 3, 2, 4, 5, 6, 7, 8, 9] and pairs.right.tolist() == list(range(10))
    assert pairs.notes == ("1 frame of left recorded out of order, put in order of their times",)


@pytest.mark.parametrize("jump_s", [30 * 86_400, -1_650_000_000])
def test_clock_that_was_set_runs_on_at_the_nominal_rate(jump_s: int) -> None:
    stamps = EVEN + np.where(np.arange(10) >= 5, jump_s * 10**9, 0)
    pairs = pair_stamps(stamps, stamps)
    np.testing.assert_allclose(pairs.times_s, np.arange(10) * 0.1)
    assert "days after frame 4" in pairs.notes[0] and pairs.unpaired == 0


def test_repeated_time_is_a_frame_that_is_skipped() -> None:
    stamps = EVEN.copy()
    stamps[4] = stamps[3]
    pairs = pair_stamps(stamps, stamps)
    assert (pairs.left >= 0).sum() == 9 and np.all(np.diff(pairs.times_s[pairs.left >= 0]) > 0)


def test_two_clocks_with_a_constant_difference_pair_in_order() -> None:
    pairs = pair_stamps(EVEN, EVEN + 5 * STEP + STEP // 3)
    assert pairs.unpaired == 0 and "paired in order" in pairs.notes[0]


def test_clock_that_stands_still_gives_the_assumed_rate() -> None:
    pairs = pair_stamps(np.zeros(3, np.int64), np.zeros(3, np.int64))
    assert pairs.times_s[2] == pytest.approx(2 / 30) and "--fps" in pairs.notes[0]


def test_rate_tells_jitter_gaps_and_dropped_frames() -> None:
    rate = rate_of_times(np.array([0.0, 0.1, 0.2, 0.5, 0.6, 0.7]))
    assert rate is not None
    assert rate.fps == pytest.approx(10.0) and rate.jitter_ms == pytest.approx(0.0, abs=1e-9)
    assert (rate.gaps, rate.dropped) == (1, 2) and rate.longest_gap_s == pytest.approx(0.3)
    assert rate_of_times(np.array([1.0])) is None


@pytest.mark.parametrize("date", ["0001-01-01 00:00:00", "9999-12-31 23:59:59", "2262-04-12 00:00:00"])
def test_dates_that_no_clock_shows_are_refused(date: str) -> None:
    with pytest.raises(ValueError, match=f"expected times, found '{date}'"):
        read_stamps([date, "2022-04-15 05:20:00"])


def test_names_with_more_digits_than_a_clock_hold_no_time() -> None:
    assert stamps_in_names(["9" * 20, "8" * 20]) is None


def test_table_of_times_beyond_half_a_day_is_refused_by_its_size(tmp_path: Path) -> None:
    with (tmp_path / "timestamps.csv").open("wb") as file:
        file.truncate(50_000_000)
    with pytest.raises(InputError, match=r"timestamps\.csv: expected a table of times of up to 33554432 bytes"):
        load_timestamps(tmp_path / "timestamps.csv")


def test_marks_around_numbers_that_count_as_blanks_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "timestamps.csv").write_text("frame,timestamp_s\n0,0.0\n1\x1c,0.5\x1d\n")
    assert load_timestamps(tmp_path / "timestamps.csv").times_s.tolist() == [0.0, 0.5]
