"""The speed and memory benches: what they refuse and what they print; figures are for the bench itself."""

import io
import math
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console
from toy_stereo import toy_rig

from benchmarks.__main__ import main_benchmarks as main
from benchmarks.clip import Clip
from benchmarks.commands.bench_speed import merged, print_changes, print_speed
from benchmarks.memory import resident_mb
from benchmarks.one_core import one_core
from benchmarks.side_by_side import counted
from benchmarks.single_speed import human_model_beside_mog2
from benchmarks.speed import LIMITS, Speed
from benchmarks.yardstick import Yardstick
from calib.errors import InputError
from calib.ground_camera import GroundCamera


def test_missing_recording_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        Clip(tmp_path / "nowhere", 10)


@pytest.mark.parametrize("command", ["speed", "memory"])
def test_too_few_frames_are_refused(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main([command, "--frames", "1"])
    assert "--frames" in capsys.readouterr().err


def test_resident_memory_is_that_of_a_python_with_numpy() -> None:
    assert 20 < resident_mb() < 20_000


def test_ratios_are_printed_beside_their_limits() -> None:
    speed = Speed({"match": 12.5}, {"foreground_to_mog2": 0.75}, details={"recording": "clip", "image": "640x480"})
    out = io.StringIO()
    print_speed(speed, Console(file=out, width=100))
    line = next(line for line in out.getvalue().splitlines() if "foreground to mog2" in line)
    assert "0.750" in line
    assert f"{LIMITS['foreground_to_mog2']:g}" in line
    assert "12.50" in out.getvalue()


def test_times_are_printed_beside_their_quartiles_and_limits() -> None:
    speed = Speed(details={"recording": "clip"})
    speed.add("human_model_eight_ms", np.array([10.0, 11.0, 12.0, 13.0, 14.0]), time=True)
    out = io.StringIO()
    print_speed(speed, Console(file=out, width=100))
    line = next(line for line in out.getvalue().splitlines() if "human model eight ms" in line)
    assert "12.000" in line
    assert "11.000 to 13.000" in line
    assert f"{LIMITS['human_model_eight_ms']:g}" in line


def test_an_engine_is_timed_beside_mog2_after_its_start() -> None:
    times = human_model_beside_mog2(GroundCamera(64, 48, 52.0, 3.5, math.radians(60)), 1, 4)
    assert times.engine_ms.shape == times.people.shape == (4,)
    np.testing.assert_allclose(times.ratios * times.mog2_ms, times.engine_ms)


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


@pytest.mark.parametrize(
    ("quartiles", "word"), [((0.5, 0.6), "faster"), ((0.85, 0.95), "slower"), ((0.6, 0.75), "within noise")]
)
def test_ratios_are_compared_with_those_kept_by_their_quartiles(quartiles: tuple[float, float], word: str) -> None:
    name = "foreground_to_mog2"
    before = Speed(ratios={name: 0.75}, quartiles={name: (0.7, 0.8)})
    now = Speed(ratios={name: sum(quartiles) / 2}, quartiles={name: quartiles})
    out = io.StringIO()
    print_changes(now, before, Console(file=out, width=100))
    assert word in out.getvalue()


@pytest.mark.parametrize(("size", "disparities"), [((320, 240), 64), ((640, 480), 64), ((1280, 800), 128)])
def test_the_yardstick_depends_on_the_size_alone(size: tuple[int, int], disparities: int) -> None:
    assert Yardstick(toy_rig().scaled(*size), grey=True).disparities == disparities


def test_frames_with_four_people_count_where_there_are_enough() -> None:
    people = np.array([1] * 20 + [4] * 12)
    assert counted(people).sum() == 12
    assert counted(people[:25]).sum() == 25


def test_figures_of_other_parts_are_kept() -> None:
    before = Speed(ratios={"engine": 1.0, "start": 2.0}, quartiles={"engine": (0.9, 1.1)})
    after = merged(before, Speed(ratios={"start": 1.5}))
    assert after == Speed(ratios={"engine": 1.0, "start": 1.5}, quartiles={"engine": (0.9, 1.1)})
