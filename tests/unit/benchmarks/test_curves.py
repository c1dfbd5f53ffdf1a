"""Curves of the speed bench: what is drawn, and on what recordings; figures are for the bench itself."""

from pathlib import Path

import numpy as np
import pytest
from toy_stereo import toy_rig

from benchmarks.crowd import EMPTY, FPS, Crowd, crowd_pipeline
from benchmarks.curve_plot import points_of, write_plot
from benchmarks.looped import LoopedRecording
from benchmarks.scaled import ScaledFrames
from calib.errors import InputError
from calib.pose import SE3
from stereo.recording import StereoFrame

RATIOS = {"pixels_640x480": 0.8, "pixels_320x240": 0.5, "engine": 1.0}
QUARTILES = {"pixels_640x480": (0.7, 0.9), "pixels_320x240": (0.4, 0.6), "engine": (0.9, 1.1)}


def frames(count: int, width: int = 64, height: int = 48) -> list[StereoFrame]:
    image = np.zeros((height, width), np.uint8)
    return [StereoFrame(i, i / 10, image, image) for i in range(count)]


class ToyRecording:
    path, fps, n_frames = Path("toy"), 10.0, 3
    rig = toy_rig()

    def __iter__(self):
        return iter(frames(3, *self.rig.left.size))


def test_points_of_a_curve_are_sorted_by_their_place() -> None:
    assert points_of("pixels_", RATIOS, QUARTILES) == [(320, 0.5, 0.4, 0.6), (640, 0.8, 0.7, 0.9)]


def test_curves_are_drawn_in_a_small_file(tmp_path: Path) -> None:
    write_plot(tmp_path / "curves.svg", RATIOS, QUARTILES, [(1000, 300.0), (2000, 301.0)])
    assert 1000 < (tmp_path / "curves.svg").stat().st_size < 60_000


def test_plot_without_a_curve_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--part curves"):
        write_plot(tmp_path / "curves.svg", {"engine": 1.0}, {"engine": (0.9, 1.1)})


def test_scaled_frames_are_every_second_one_of_another_size() -> None:
    scaled = ScaledFrames(frames(5), (32, 24), every=2)
    assert [(f.index, f.timestamp_s, f.left.shape) for f in scaled] == [
        (0, 0.0, (24, 32)), (1, 0.2, (24, 32)), (2, 0.4, (24, 32)),
    ]  # fmt: skip


def test_looped_recording_goes_on_in_frames_and_time() -> None:
    width = ToyRecording.rig.left.size[0] // 2
    looped = LoopedRecording(ToyRecording(), 5, width, SE3.identity())
    assert [(f.index, round(f.timestamp_s, 3), f.left.shape[1]) for f in looped] == [
        (i, i / 10, width) for i in range(5)
    ]


def test_crowd_is_nearer_than_the_floor_once_it_is_there() -> None:
    *_, empty, with_people = Crowd(crowd_pipeline(), 4).frames(EMPTY + 1)
    assert with_people.timestamp_s == EMPTY / FPS
    nearer = with_people.disparity - empty.disparity > 0.5
    assert 0.005 < nearer.mean() < 0.1
