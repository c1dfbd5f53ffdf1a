import numpy as np
import pytest

from planview.tracking import body
from planview.tracking.explain.facing import DIRECTIONS_RAD, STANDING_TURN_RAD2_PS, FacingDistribution, Gait

ALONG_X = -20.0 * np.sin(DIRECTIONS_RAD[: body.FACINGS // 2]) ** 2
"""Log-likelihood ratios of a silhouette whose axis is along x."""


def standing(belief: FacingDistribution, frames: int, axis: np.ndarray = ALONG_X) -> FacingDistribution:
    """After frames at 10 per second in which somebody who does not walk is seen."""
    for _ in range(frames):
        belief = belief.predict(0.1, 1.0).observe(axis, 0.4, Gait(1.0, 0.0, 0.0))
    return belief


def walked() -> FacingDistribution:
    """After walking along x for a second."""
    belief = FacingDistribution.uniform()
    for _ in range(10):
        belief = belief.predict(0.1, 0.0).observe(ALONG_X, 0.4, Gait(0.0, 0.0, 4.0))
    return belief


def test_a_silhouette_shows_an_axis_without_its_end():
    belief = standing(FacingDistribution.uniform(), 10)
    assert belief.axis_var < 0.3 and belief.best[1] == pytest.approx(0.5)
    assert FacingDistribution.uniform().axis_var > 1.0


def test_walking_shows_which_end_is_ahead():
    facing, confidence = walked().best
    assert facing == pytest.approx(0.0, abs=1e-6) and confidence > 0.95


def test_facing_is_less_sure_the_longer_somebody_is_not_seen():
    sure = [walked().predict(seconds, 1.0).best[1] for seconds in (0.0, 0.3, 0.6, 10.0)]
    assert sure == sorted(sure, reverse=True) and sure[-1] == pytest.approx(0.5, abs=1e-3)


def test_a_direction_spreads_by_the_variance_of_turns():
    for still, variance in ((1.0, STANDING_TURN_RAD2_PS), (0.0, body.TURNING_RAD2_PS)):
        known = FacingDistribution(np.eye(body.FACINGS)[0]).predict(0.25, still)
        resultant = known.share @ np.cos(DIRECTIONS_RAD)
        assert resultant == pytest.approx(np.exp(-0.5 * variance * 0.25), abs=0.01)


def test_a_step_back_does_not_turn_somebody_round():
    stepped = walked()
    for _ in range(5):  # half a second at half a metre per second: a concentration of one
        stepped = stepped.predict(0.1, 0.5).observe(ALONG_X, 0.4, Gait(0.0, np.pi, 1.0))
    assert stepped.best[0] == pytest.approx(0.0, abs=0.1) and stepped.best[1] > 0.8


def test_a_turn_costs_certainty_that_standing_still_does_not():
    turned = walked()
    for axis in (2, 4, 6, 8):  # of 16 directions: a quarter turn every 0.2 s
        turned = standing(turned, 2, np.roll(ALONG_X, axis))
    assert turned.best[1] < standing(walked(), 8).best[1] - 0.1


def test_the_ends_of_an_axis_share_all_probability():
    belief = standing(walked(), 5)
    (ahead, front), (behind, back) = belief.near(0.0), belief.near(np.pi)
    assert front + back == pytest.approx(1.0) and abs(ahead) < 0.1 and abs(behind) > 3.0
