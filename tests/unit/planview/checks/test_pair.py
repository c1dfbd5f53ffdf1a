"""Laying tracks over truth of another world frame."""

import math

import numpy as np
import pytest

from calib.errors import WorkError
from planview.evaluation.align import FloorAlignment, align_tracks, fit_rigid, moved
from planview.trajectories.table import Trajectories, positions_table

MOTION = FloorAlignment(math.radians(120), 3.0, -2.0, 0.0, 0)


def two_walkers() -> Trajectories:
    frame = np.repeat(np.arange(40), 2)
    walker = np.tile([1, 2], 40)
    t = frame / 40
    xy = np.column_stack([np.where(walker == 1, 3 * t, 1 + 0.5 * t), np.where(walker == 1, 0.2 * t, 2 - 3 * t)])
    return positions_table(frame, walker, xy)


def test_rigid_fit_recovers_a_known_motion() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    fit = fit_rigid(points, MOTION.apply(points))
    assert (fit.rotation_rad, fit.x_m, fit.y_m) == pytest.approx((MOTION.rotation_rad, 3.0, -2.0))
    assert fit.rms_m == pytest.approx(0.0, abs=1e-12)


def test_alignment_finds_the_motion_from_paths_with_noise_and_other_ids() -> None:
    truth = moved(two_walkers(), MOTION)
    noisy = two_walkers()
    rng = np.random.default_rng(1)
    tracks = positions_table(
        noisy.frame, 10 - noisy.track_id, np.column_stack([noisy.x_m, noisy.y_m]) + rng.normal(0, 0.05, (80, 2))
    )
    order = np.lexsort((tracks.track_id, tracks.frame))
    laid, alignment = align_tracks(tracks.where(order), truth, 0.5)
    assert alignment.pairs == 80
    assert math.degrees(alignment.rotation_rad) == pytest.approx(120, abs=1.0)
    assert alignment.rms_m < 0.1
    assert np.isfinite(laid.x_m).all()


def test_alignment_starts_from_boxes_where_both_have_them() -> None:
    plain = two_walkers()
    xy = np.column_stack([plain.x_m, plain.y_m])
    box = np.column_stack([100 * plain.x_m, 100 * plain.y_m + 300, np.full(80, 40.0), np.full(80, 80.0)])
    tracks = positions_table(plain.frame, plain.track_id, xy, box_px=box)
    truth = positions_table(plain.frame, plain.track_id, MOTION.apply(xy), box_px=box)
    _, alignment = align_tracks(tracks, truth, 0.5)
    assert (alignment.x_m, alignment.y_m) == pytest.approx((3.0, -2.0))


def test_alignment_needs_people_who_move() -> None:
    still = positions_table(np.arange(20), np.ones(20, dtype=np.int64), np.zeros((20, 2)))
    with pytest.raises(WorkError, match="tracks that move"):
        align_tracks(still, still, 0.5)
