import math

import numpy as np
import pytest

from planview.sweep.results import JobResult, estimate, ranked, summary_csv, why_no_intervals
from planview.sweep.study import Configuration

A, B = Configuration(("a.b=1",)), Configuration(("a.b=2",))


def result(configuration: Configuration, recording: str, mota: float | None, seed: int = 0) -> JobResult:
    figures = {} if mota is None else {"mota": mota, "position_error_mean_m": 1 - mota}
    return JobResult(recording, configuration, seed, figures=figures, error="" if figures else "no floor")


def test_best_mean_over_recordings_comes_first() -> None:
    ranking = ranked([result(A, "x", 0.5), result(A, "y", 0.7), result(B, "x", 0.9), result(B, "y", 0.5)], "mota")
    assert [row.configuration for row in ranking] == [B, A]
    assert [row.figures["mota"].mean for row in ranking] == pytest.approx([0.7, 0.6])


def test_errors_rank_upwards() -> None:
    ranking = ranked([result(A, "x", 0.5), result(B, "x", 0.9)], "position_error_mean_m")
    assert [row.configuration for row in ranking] == [B, A]


def test_seeds_of_a_recording_count_together_as_much_as_another_recording() -> None:
    values = np.array([[0.0, 0.0], [1.0, math.nan]])
    assert estimate(values).mean == 0.5


def test_configuration_with_a_failed_run_comes_after_complete_ones() -> None:
    ranking = ranked([result(A, "x", 0.9), result(A, "y", None), result(B, "x", 0.5), result(B, "y", 0.5)], "mota")
    assert [row.configuration for row in ranking] == [B, A]
    assert (ranking[1].runs, ranking[1].failed) == (1, 1)


@pytest.mark.parametrize("values", [[[0.4]], [[0.4, 0.5]] * 4, [[0.4]] * 4 + [[math.nan]]])
def test_fewer_than_five_recordings_have_no_interval(values: list[list[float]]) -> None:
    found = estimate(np.array(values))
    assert found.mean == pytest.approx(np.nanmean(values)) and math.isnan(found.low) and math.isnan(found.high)


def test_why_there_are_no_intervals_is_said() -> None:
    assert why_no_intervals([result(A, "x", 0.5), result(A, "y", None)]) == (
        "no 95% intervals: they need 5 recordings, found 1"
    )
    assert not why_no_intervals([result(A, name, 0.5) for name in "abcde"])


def test_interval_of_equal_recordings_has_no_width() -> None:
    found = estimate(np.full((5, 1), 0.25))
    assert (found.mean, found.low, found.high) == pytest.approx((0.25, 0.25, 0.25))


def test_interval_of_many_recordings_is_that_of_the_mean() -> None:
    values = np.random.default_rng(1).normal(0.0, 1.0, (400, 1))
    found = estimate(values)
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.1)


def test_difference_to_the_first_is_taken_run_by_run() -> None:
    runs = [result(A, name, 0.5 + i / 10) for i, name in enumerate("vwxyz")]
    runs += [result(B, name, 0.4 + i / 10) for i, name in enumerate("vwxyz")]
    behind = ranked(runs, "mota")[1].behind
    assert (behind.mean, behind.low, behind.high) == pytest.approx((-0.1, -0.1, -0.1))


def test_configurations_without_the_objective_are_not_dropped() -> None:
    ranking = ranked([result(A, "x", None), result(B, "x", 0.5)], "mota")
    assert [row.configuration for row in ranking] == [B, A]


def test_summary_has_a_row_per_run_and_a_column_per_parameter() -> None:
    done = JobResult("hall", Configuration(("a.b=1", "c.d=true")), 3, figures={"mota": 0.5})
    header, row = summary_csv([done]).splitlines()
    assert header.startswith("recording,a.b,c.d,seed,state,tracked_from,mota,idf1")
    assert row.startswith("hall,1,true,3,done,recording,0.5,,")


def test_summary_keeps_spreadsheets_from_taking_names_for_formulas() -> None:
    failed = JobResult('=HYPERLINK("x")', Configuration(("a.b=-1",)), 0, error="no floor")
    row = summary_csv([failed]).splitlines()[1]
    assert row.startswith('"\'=HYPERLINK(""x"")",-1,0,failed') and row.endswith(",no floor")
