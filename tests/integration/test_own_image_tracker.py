"""A tracker of one's own through ``open_engine``: the recording says what it gets."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.errors import InputError
from calib.types import U8
from planview.engine.open import open_engine
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.trajectories.state import TrackState


class Brightest:
    """Follows the brightest pixel; says nothing of foreground, as trackers of plan-view maps do."""

    decisions: tuple[Decision, ...] = ()

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        assert observation.image is not None
        row, column = np.unravel_index(int(observation.image.argmax()), observation.image.shape)
        return (TrackState(1, "confirmed", box_px=(float(column), float(row), 1.0, 1.0)),)

    def feedback(self) -> U8 | None:
        return None

    def debug(self) -> TrackerDebug:
        return TrackerDebug()

    def reset(self) -> None:
        """Nothing is remembered."""


class BrightestInImage(Brightest):
    """The same as an ``ImageTracker``."""

    foreground_columns = None


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    for i in range(3):
        image = np.zeros((48, 64), np.uint8)
        image[20, 10 + i] = 255
        cv2.imwrite(str(tmp_path / f"{i:03}.png"), image)
    return tmp_path


def test_a_tracker_of_images_gets_the_frames_of_one_camera(clip: Path) -> None:
    boxes = [result.tracks[0].box_px[:2] for result in open_engine(clip, BrightestInImage())]
    assert boxes == [(10, 20), (11, 20), (12, 20)]


def test_a_tracker_of_plan_view_maps_needs_depth(clip: Path) -> None:
    with pytest.raises(InputError):
        open_engine(clip, Brightest())
