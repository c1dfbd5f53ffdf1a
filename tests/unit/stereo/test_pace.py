"""The frame rate of images without times."""

from collections.abc import Sequence

import numpy as np
import pytest

from calib.camera import Camera
from stereo.pace import rate_by_movement
from stereo.recording import RgbdFrame

CAMERA = Camera(320, 240, 260.0, 260.0, 159.5, 119.5)


def _walker(step_m: float) -> list[RgbdFrame]:
    """Before a wall 6 m away, a card of 0.5 m x 1.6 m at 3 m steps to the right."""
    frames = []
    for index in range(24):
        depth = np.full((240, 320), 6.0, np.float32)
        left = round(260 * (-1.8 + step_m * index) / 3 + 159.5)
        depth[40:180, max(left, 0) : max(left + 43, 0)] = 3.0
        frames.append(RgbdFrame(index, index / 30, np.zeros((240, 320), np.uint8), depth))
    return frames


@pytest.mark.parametrize(("step_m", "fps"), [(0.13, 10.0), (0.26, 5.0)])
def test_rate_is_that_at_which_people_walk(step_m: float, fps: float) -> None:
    frames = _walker(step_m)
    found = rate_by_movement(lambda indices: [frames[i] for i in indices], len(frames), CAMERA)
    assert found == pytest.approx(fps, rel=0.25)  # of 8 pixels each


def test_rate_is_unknown_where_nothing_moves() -> None:
    frames = _walker(0.0)

    def at(indices: Sequence[int]) -> list[RgbdFrame]:
        return [frames[0] for _ in indices]

    assert rate_by_movement(at, len(frames), CAMERA) is None
