"""Disparity as maps.h5 and the checks of a run take it."""

from types import SimpleNamespace

import numpy as np
import pytest

from planview.checks.examine import STEP, RecordingWatch
from planview.output.maps_log import at_step
from stereo.matcher import SampledDisparity


@pytest.mark.parametrize("measured_step", [1, 2, 4])
def test_reduced_disparity_is_that_of_the_image(measured_step: int) -> None:
    samples = np.arange(-(-20 // measured_step) * -(-31 // measured_step), dtype=np.float32)
    sampled = SampledDisparity(samples.reshape(-(-20 // measured_step), -1), measured_step, (20, 31))
    np.testing.assert_array_equal(at_step(sampled, 2), sampled.image[::2, ::2])


def test_disparity_that_was_measured_at_the_step_is_not_enlarged() -> None:
    sampled = SampledDisparity(np.zeros((10, 16), np.float32), 2, (20, 31))
    assert at_step(sampled, 2) is sampled.samples


def test_a_run_is_looked_at_in_every_tenth_frame_only() -> None:
    class Counted:
        made = 0

        @property
        def image(self) -> np.ndarray:
            Counted.made += 1
            return np.full((4, 4), np.nan, np.float32)

    watch = RecordingWatch.__new__(RecordingWatch)
    watch._view, watch._frames, watch._valid = SimpleNamespace(reduction=1), 0, []  # type: ignore[assignment]
    for _ in range(2 * STEP + 1):
        watch.update(None, Counted(), None)  # type: ignore[arg-type]
    assert Counted.made == 3
