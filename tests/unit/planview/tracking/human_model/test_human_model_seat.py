"""What is remembered of a person on a seat, by hand: a body of 6 rows and 2 columns in an image of 8 x 6."""

import numpy as np
import pytest

from planview.tracking.human_model.params import PostureParams
from planview.tracking.human_model.seat import Seat

PARAMS = PostureParams(empty=0.5, empty_s=0.3)
BODY = np.s_[1:7, 2:4]


def images() -> tuple[np.ndarray, np.ndarray, Seat]:
    """Evidence and cover of the person alone, and the seat."""
    evidence, cover = np.zeros((8, 6), np.uint8), np.zeros((8, 6), np.uint8)
    evidence[BODY], cover[BODY] = 2, 1
    window = (slice(0, 8), slice(1, 5))
    seat = Seat(np.zeros(2), 0.0, 0.7, window, cover[window] > 0, (evidence[window] > 0).astype(np.float32))
    return evidence, cover, seat


def test_motionless_person_is_on_the_seat() -> None:
    evidence, cover, seat = images()
    assert seat.observe(evidence, cover, 1.0, PARAMS) == 1.0
    assert np.isnan(seat.empty_since_s)


def test_seat_is_empty_since_the_foreground_left() -> None:
    evidence, cover, seat = images()
    evidence[BODY] = 0
    assert [seat.observe(evidence, cover, t, PARAMS) for t in (1.0, 1.2)] == [0.0, 0.0]
    assert seat.empty_since_s == 1.0
    evidence[BODY] = 2
    seat.observe(evidence, cover, 1.4, PARAMS)
    assert np.isnan(seat.empty_since_s)


def test_seat_without_a_head_is_empty_though_legs_cover_it() -> None:
    evidence, cover, seat = images()
    evidence[1:3] = 0  # the upper third of six rows
    assert seat.observe(evidence, cover, 1.0, PARAMS) == 0.0


@pytest.mark.parametrize(("hidden_rows", "kept"), [(slice(0, 8), np.nan), (slice(3, 8), 0.0)])
def test_only_the_unhidden_part_is_judged(hidden_rows: slice, kept: float) -> None:
    evidence, cover, seat = images()
    evidence[BODY] = 0
    cover[hidden_rows] += 1
    np.testing.assert_equal(seat.observe(evidence, cover, 1.0, PARAMS), kept)
    assert np.isnan(seat.empty_since_s) == np.isnan(kept)


def test_silhouette_is_a_mean_first_and_follows_slowly_later() -> None:
    evidence, cover, seat = images()
    evidence[6, 2:4], cover[1, 2:4] = 0, 2
    seat.observe(evidence, cover, 1.0, PARAMS)
    np.testing.assert_allclose(seat.silhouette[6, 1:3], 1 / 2)
    seat.observe(evidence, cover, 1.1, PARAMS)
    np.testing.assert_allclose(seat.silhouette[6, 1:3], 1 / 3)
    for k in range(60):
        seat.observe(evidence, cover, 1.2 + k / 10, PARAMS)
    evidence[6, 2:4] = 2
    before = seat.silhouette[6, 1]
    seat.observe(evidence, cover, 8.0, PARAMS)
    assert seat.silhouette[6, 1] - before == pytest.approx(0.05 * (1 - before))


def test_silhouette_is_kept_where_it_is_hidden_and_learns_nothing_beside_the_model() -> None:
    evidence, cover, seat = images()
    evidence[1, 2:4], cover[1, 2:4] = 0, 2
    evidence[0, 1] = 2  # another person, in the window and beside the model
    for k in range(30):
        seat.observe(evidence, cover, k / 10, PARAMS)
    np.testing.assert_array_equal(seat.silhouette[1, 1:3], 1.0)
    evidence[0, 1], evidence[1, 2:4], cover[1, 2:4] = 0, 2, 1
    assert seat.observe(evidence, cover, 4.0, PARAMS) == 1.0
