"""Kernels of matching in part against their numpy twins."""

import numpy as np
import pytest
from reference import gate as twin

from planview.engine import _gate_kernels as kernels


@pytest.mark.parametrize(("shape", "step"), [((24, 30, 3), 2), ((25, 31, 1), 2), ((40, 61, 3), 3)])
def test_samples_are_compared_and_kept_as_in_numpy(shape: tuple[int, int, int], step: int) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 60, shape, dtype=np.uint8)
    few = tuple(-(-n // step) for n in shape[:2])
    background = rng.integers(0, 60, (*few, shape[2]), dtype=np.uint8)
    measured, foreground = (rng.choice(np.array([0, 255], np.uint8), shape[:2]) for _ in range(2))
    changed = [np.full(few, 255, np.uint8) for _ in range(2)]
    kept = [background.copy() for _ in range(2)]
    for module, mask, memory in zip((kernels, twin), changed, kept, strict=True):
        module.forgive_known(image, background, step, 20, mask)
        module.remember_known(image, measured, foreground, step, memory)
    assert 0 < (changed[0] > 0).sum() < changed[0].size
    np.testing.assert_array_equal(*changed)
    np.testing.assert_array_equal(*kept)


def test_sample_is_known_up_to_the_level_that_is_told() -> None:
    image, background = np.full((2, 4, 1), 50, np.uint8), np.array([[[38], [37]]], np.uint8)
    changed = np.full((1, 2), 255, np.uint8)
    kernels.forgive_known(image, background, 2, 12, changed)
    assert changed.tolist() == [[0, 255]]
