"""Tests of the floor of a recording: a plane aligned with the images."""

import cv2
import numpy as np
import pytest

from calib.floor.plane import FloorParams, Plane
from stereo.depth import RectifiedGeometry
from stereo.floor import align_plane

GEOMETRY = RectifiedGeometry(
    focal_u_px=260.0, focal_v_px=260.0, cu_px=159.5, cv_px=119.5, baseline_m=0.2, width=320, height=240
)


def plane(tilt_deg: float, roll_deg: float, height_m: float) -> Plane:
    tilt, roll = np.radians([tilt_deg, roll_deg])
    normal = np.array([np.sin(roll), -np.sin(tilt) * np.cos(roll), -np.cos(tilt) * np.cos(roll)])
    return Plane(-normal / height_m, 1.0, np.zeros((3, 3)))


def seen(true: Plane, contrast: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left and right image of a spotted plane, and its depth [m]."""
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    inverse = GEOMETRY.rays(np.stack([u, v], axis=-1)) @ true.q
    rng = np.random.default_rng(1)
    spots = cv2.GaussianBlur(rng.normal(size=(240, 320)), (0, 0), 2.5)
    right = (120 + contrast * spots).astype(np.float32)
    disparity = (260.0 * 0.2 * inverse).astype(np.float32)
    left = cv2.remap(
        right, u.astype(np.float32) - disparity, v.astype(np.float32), cv2.INTER_CUBIC, None, cv2.BORDER_REFLECT
    )
    depth = np.where(inverse > 0.1, 1.0 / np.maximum(inverse, 0.1), np.nan).astype(np.float32)
    noise = rng.normal(size=(2, 240, 320)).astype(np.float32)
    return left + noise[0], right + noise[1], depth


def test_a_plane_is_aligned_to_a_tenth_of_a_degree_and_knows_it() -> None:
    true, guess = plane(60.0, 1.0, 2.5), plane(60.7, 0.7, 2.54)
    aligned = align_plane(guess, *seen(true, 200.0), GEOMETRY, FloorParams())
    assert aligned.distance_m == pytest.approx(2.5, abs=0.01)
    assert np.degrees([aligned.tilt_rad, aligned.roll_rad]) == pytest.approx([60.0, 1.0], abs=0.1)
    assert 0 < np.sqrt(np.trace(aligned.covariance)) < 0.01


def test_without_texture_the_guess_stays() -> None:
    true, guess = plane(60.0, 1.0, 2.5), plane(60.7, 0.7, 2.54)
    assert align_plane(guess, *seen(true, 0.0), GEOMETRY, FloorParams()) is guess


def test_what_stands_on_the_plane_does_not_take_part() -> None:
    true, guess = plane(60.0, 1.0, 2.5), plane(60.3, 0.8, 2.52)
    left, right, depth = seen(true, 200.0)
    left[100:160, 140:200], depth[100:160, 140:200] = left[40:100, 140:200], 1.5
    aligned = align_plane(guess, left, right, depth, GEOMETRY, FloorParams())
    assert np.degrees([aligned.tilt_rad, aligned.roll_rad]) == pytest.approx([60.0, 1.0], abs=0.1)
