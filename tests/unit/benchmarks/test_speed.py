"""The benchmark of speed: what it refuses and what it prints; figures are for the benchmark itself."""

import io
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console
from toy_stereo import toy_rig

from benchmarks.__main__ import main_benchmarks as main
from benchmarks.speed import LIMITS, Clip, Speed, Yardstick, counted, one_core, print_speed, walking_people
from calib.errors import InputError
from calib.ground_camera import GroundCamera


def test_missing_recording_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        Clip(tmp_path / "nowhere", 10)


def test_too_few_frames_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["speed", "--frames", "1"])
    assert "--frames" in capsys.readouterr().err


def test_ratios_are_printed_beside_their_limits() -> None:
    speed = Speed({"match": 12.5}, details={"recording": "clip", "image": "640x480"})
    speed.add("foreground_to_mog2", np.array([0.55, 0.65, 0.75, 0.85, 0.95]))
    out = io.StringIO()
    print_speed(speed, Console(file=out, width=100))
    line = next(line for line in out.getvalue().splitlines() if "foreground to mog2" in line)
    assert "0.750" in line
    assert "0.650 to 0.850" in line
    assert f"{LIMITS['foreground_to_mog2']:g}" in line
    assert "12.50" in out.getvalue()


def test_one_core_is_given_back():
    threads = cv2.getNumThreads()
    with one_core():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == threads
    if hasattr(os, "sched_getaffinity"):
        cores = os.sched_getaffinity(0)
        with one_core():
            assert len(os.sched_getaffinity(0)) == 1
        assert os.sched_getaffinity(0) == cores


@pytest.mark.parametrize(("size", "disparities"), [((320, 240), 64), ((640, 480), 64), ((1280, 800), 128)])
def test_the_yardstick_depends_on_the_size_alone(size: tuple[int, int], disparities: int) -> None:
    assert Yardstick(toy_rig().scaled(*size), grey=True).disparities == disparities


def test_frames_with_four_people_count_where_there_are_enough() -> None:
    people = np.array([1] * 20 + [4] * 12)
    assert counted(people).sum() == 12
    assert counted(people[:25]).sum() == 25


def test_painted_people_come_in_after_ten_frames() -> None:
    frames = list(walking_people(GroundCamera(80, 60, 65.0, 3.5, 1.05), 2, 12))
    changed = [int((np.abs(frames[i].astype(int) - frames[0]).max(axis=2) > 20).sum()) for i in (9, 10)]
    assert changed[0] == 0
    assert changed[1] > 50
