"""The loop that tries hypotheses."""

import math

import pytest

from calib.doubt import Hypothesis, Score, best


def times(factor: float, odds: float = 1.0) -> Hypothesis[float]:
    """That a number is too small by a factor."""
    return Hypothesis(f"times {factor:g}", f"multiply by {factor:g}", lambda number: factor * number, odds)


def near_one(number: float) -> Score:
    """The better the nearer a number is to 1."""
    return Score(-abs(math.log(number)), f"the number is {number:g}")


def named(number: float, *hypotheses: Hypothesis[float], **settings: float) -> str:
    finding = best(number, hypotheses, near_one, **settings)
    return finding.names if finding else ""


def test_the_hypothesis_that_fits_best_is_named_with_its_remedy():
    finding = best(0.01, [times(10), times(100)], near_one)
    assert str(finding) == "if times 100, the number is 1: multiply by 100"


def test_nothing_is_named_that_fits_no_better_than_the_data_as_given():
    assert named(1.0, times(10)) == named(0.9, times(1.1)) == ""


def test_a_hypothesis_must_make_good_for_the_odds_against_it():
    assert named(0.01, times(100, odds=50.0)) == "times 100"
    assert named(0.01, times(100, odds=200.0)) == ""


def test_two_hypotheses_that_fit_alike_are_both_named():
    finding = best(0.01, [times(100), times(101), times(10)], near_one)
    assert str(finding).startswith("either if times 100, the number is 1, or if times 101")
    assert str(finding).endswith("multiply by 100 or multiply by 101")


def test_what_scores_below_the_least_explains_nothing():
    assert named(0.01, times(10), least=-1.0) == ""


def test_what_cannot_win_is_not_tried():
    def fail(number):
        raise AssertionError

    impossible = Hypothesis("never tried", "", fail, odds=2.0)
    assert named(0.01, times(100), impossible, ceiling=0.0) == "times 100"


def test_two_changes_are_undone_one_after_the_other():
    both = times(10).and_then(Hypothesis("minus 9", "subtract 9", lambda number: number - 9.0, 1.5))
    assert (both.name, both.remedy, both.odds) == ("times 10 and minus 9", "multiply by 10, and subtract 9", 1.5)
    assert both.undo(1.0) == pytest.approx(1.0)
