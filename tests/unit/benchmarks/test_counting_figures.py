"""Pictures of counting."""

from pathlib import Path

import cv2
import numpy as np

from benchmarks.counting_figures import ENLARGED, models_over_frame, write_occupancy
from planview.tracking.base import Drawing, TrackerDebug


def test_models_are_drawn_over_the_enlarged_frame_in_the_colour_of_their_state() -> None:
    square = np.array([[10, 10], [30, 10], [30, 30], [10, 30], [10, 10]], np.float32)
    debug = TrackerDebug((Drawing("models", "image", (square,), ("1 stationary stable M=1.50",)),))
    picture = models_over_frame(np.zeros((48, 64, 3), np.uint8), debug)
    assert picture.shape == (48 * ENLARGED, 64 * ENLARGED, 3)
    blue, _, red = (int(v) for v in picture[30 * ENLARGED, 20 * ENLARGED])
    assert blue > 200 > red
    assert not picture[20 * ENLARGED, 20 * ENLARGED].any()


def test_shapes_on_the_floor_are_not_drawn_over_the_frame() -> None:
    debug = TrackerDebug((Drawing("footprints", "floor", (np.ones((1, 2), np.float32),), ("1",)),))
    assert not models_over_frame(np.zeros((48, 64, 3), np.uint8), debug).any()


def test_plot_of_occupancy_is_a_small_picture(tmp_path: Path) -> None:
    times = np.arange(1300) / 10
    write_occupancy(tmp_path / "o.png", "room", times, (times // 10).astype(np.int64), (times // 11).astype(np.int64))
    assert cv2.imread(str(tmp_path / "o.png")) is not None
    assert (tmp_path / "o.png").stat().st_size < 150_000
