"""Which changes are large enough to ask for depth."""

import cv2
import numpy as np
import pytest

from planview.engine.gated import SAME_LEVELS, alike, solid


def test_fleck_that_fills_less_than_half_of_a_head_is_no_change() -> None:
    mask = np.zeros((40, 40), np.uint8)
    mask[10:14, 10:14] = 255
    assert not solid(mask, 7).any()


def test_disc_as_wide_as_a_head_keeps_its_middle() -> None:
    mask = np.zeros((40, 40), np.uint8)
    cv2.circle(mask, (20, 20), 3, 255, -1)
    assert solid(mask, 7)[20, 20] == 255


@pytest.mark.parametrize("seed", range(3))
def test_smallest_square_is_the_median_of_nine(seed: int) -> None:
    mask = np.where(np.random.default_rng(seed).random((30, 50)) < 0.5, 255, 0).astype(np.uint8)
    assert np.array_equal(solid(mask, 3), cv2.medianBlur(mask, 3))


@pytest.mark.parametrize("channels", [(), (3,)])
def test_images_are_alike_up_to_the_level_in_every_channel(channels: tuple[int, ...]) -> None:
    image, other = np.full((1, 4, *channels), 50, np.uint8), np.full((1, 4, *channels), 50, np.uint8)
    other[0, 1], other[0, 2] = 50 + SAME_LEVELS, 50 - SAME_LEVELS
    other[0, 3, ..., None][-1] = 50 + SAME_LEVELS + 1
    assert alike(image, other).tolist() == [[255, 255, 255, 0]]
