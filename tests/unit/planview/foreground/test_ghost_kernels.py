"""The compiled search for ghosts beside whole images in numpy and OpenCV."""

import cv2
import numpy as np
import pytest
from reference import ghosts as reference

from planview.foreground._gain_kernels import fill_luma
from planview.foreground._leader_kernels import BLOCK, N_LEAD, Y
from planview.foreground.blobs import find_blobs
from planview.foreground.ghosts import GhostParams, find_ghosts, find_still, find_uncovered, moved_lately

PARAMS = GhostParams()


@pytest.mark.parametrize("smooth", [False, True])
def test_ghosts_are_those_of_whole_images(smooth: bool) -> None:
    rng, found = np.random.default_rng(4), np.zeros(3, np.int64)
    for _ in range(60):
        height, width = rng.integers(12, 90, 2)
        field = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), rng.uniform(1, 5))
        mask = np.where(field > np.quantile(field, rng.uniform()), 255, 0).astype(np.uint8)
        luma = rng.uniform(0, 255, (height, width))
        luma = (cv2.GaussianBlur(luma, (0, 0), 3) if smooth else luma).astype(np.uint8)
        other = luma + (mask > 0) * rng.uniform(-90, 90) + rng.normal(0, 3, luma.shape)
        background = np.clip(other, 0, 255).astype(np.uint8)
        motion = np.where(rng.uniform(size=mask.shape) < rng.choice([0.0, 0.01, 0.05]), 255, 0).astype(np.uint8)
        blobs = find_blobs(mask)
        for k, (ours, numpys) in enumerate(
            (
                (f(luma, background, blobs, motion, PARAMS) for f in (find_ghosts, reference.find_ghosts)),
                (f(blobs, motion, PARAMS) for f in (find_still, reference.find_still)),
                (f(luma, background, mask, PARAMS) for f in (find_uncovered, reference.find_uncovered)),
            )
        ):
            np.testing.assert_array_equal(ours, numpys)
            found[k] += ours.any()
    assert (found > 0).all()


def test_motion_is_remembered_for_a_while() -> None:
    moved_s = np.array([[0.0, 1.0, 2.0]], np.float32)
    motion = np.array([[255, 0, 0]], np.uint8)
    np.testing.assert_array_equal(moved_lately(motion, 2.5, 1.0, moved_s), [[255, 0, 255]])
    np.testing.assert_array_equal(moved_s, [[2.5, 1.0, 2.0]])


def test_background_is_rounded_to_even_levels() -> None:
    levels = np.random.default_rng(3).uniform(-20, 280, 2 * BLOCK).astype(np.float32)
    levels[:4] = 0.5, 1.5, 2.5, 254.5
    lead = np.zeros((2, N_LEAD * BLOCK), np.float32)
    lead[:, Y * BLOCK : (Y + 1) * BLOCK] = levels.reshape(2, BLOCK)
    for gain, offset in ((1.0, 0.0), (1.3, -7.0)):
        luma = np.empty(2 * BLOCK - 5, np.uint8)
        fill_luma(lead, gain, offset, luma)
        np.testing.assert_array_equal(luma, reference.background_luma(levels, gain, offset)[: luma.size])
