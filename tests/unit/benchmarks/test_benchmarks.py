"""The smaller benchmarks."""

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import write_video
from toy_stereo import toy_rig

from benchmarks.__main__ import main_benchmarks as main
from benchmarks.calibration import alignment_error, floor_error_m
from benchmarks.floors import ANGLE_OFF_DEG, HEIGHT_OFF_M, floor_errors, low_room, low_room_floor
from benchmarks.options import figure, report
from benchmarks.speed import LIMITS, Yardstick, compared, counted, one_core, ratio_row
from calib.ground_camera import GroundCamera
from calib.pose import SE3
from calib.rig import world_from_plane
from calib.world import RigEntry
from planview.engine.open import open_engine


def test_missing_recordings_and_too_few_frames_are_refused(tmp_path, capsys):
    for words, named in ((["--recording", str(tmp_path / "nowhere")], "nowhere"), (["--frames", "1"], "--frames")):
        with pytest.raises(SystemExit, match="2"):
            main(["speed", *words])
        assert named in capsys.readouterr().err


def test_table_shows_long_names_intervals_and_unknown_figures(capsys: pytest.CaptureFixture[str]) -> None:
    name = "a recording with a name " * 10
    report(False, rows=[{"recording": name, "share": 0.12345}, {"recording": "b", "share": (0.5, 0.25, 0.75), "n": 3}])
    head, first, second, _ = capsys.readouterr().out.splitlines()
    assert head.split() == ["recording", "share", "n"]
    assert first.startswith(name) and first.split()[-2:] == ["0.1235", "-"]
    assert second.split() == ["b", "0.5", "[0.25,", "0.75]", "3"]


def test_json_has_null_for_unknown_figures(capsys: pytest.CaptureFixture[str]) -> None:
    report(True, rows=[{"a": math.nan, "b": (1.0, math.inf, 2.0)}])
    assert json.loads(capsys.readouterr().out) == {"rows": [{"a": None, "b": [1.0, None, 2.0]}]}


def test_ratio_has_median_and_quartiles() -> None:
    row = ratio_row("foreground / MOG2", np.array([0.55, 0.65, 0.75, 0.85, 0.95]), np.ones(5))
    assert (row["ratio"], row["limit"]) == (pytest.approx((0.75, 0.65, 0.85)), LIMITS["foreground / MOG2"])


def test_one_core_is_given_back():
    before = cv2.getNumThreads(), os.sched_getaffinity(0)
    with one_core():
        assert (cv2.getNumThreads(), len(os.sched_getaffinity(0))) == (1, 1)
    assert (cv2.getNumThreads(), os.sched_getaffinity(0)) == before


@pytest.mark.parametrize(("size", "disparities"), [((320, 240), 64), ((640, 480), 64), ((1280, 800), 128)])
def test_the_yardstick_depends_on_the_size_alone(size: tuple[int, int], disparities: int) -> None:
    assert Yardstick(toy_rig().scaled(*size), grey=True).disparities == disparities


def test_video_takes_turns_with_mog2_alone(tmp_path: Path) -> None:
    write_video(tmp_path / "video.avi", 12, colour=True)
    tables = compared(open_engine(tmp_path / "video.avi", "ellipse-particle"), 10)
    assert [row["ours / OpenCV"] for row in tables["ratios"]] == [
        "engine on all cores / MOG2", "engine / MOG2", "foreground / MOG2",
    ]  # fmt: skip
    assert {row["stage"] for row in tables["stages"]} >= {"foreground", "track"}


def test_frames_with_four_people_count_where_there_are_enough() -> None:
    people = np.array([1] * 20 + [4] * 12)
    assert counted(people).sum() == 12 and counted(people[:25]).sum() == 25


OWN = world_from_plane(np.array([0.0, -0.9, -0.4]), 2.4)


def rig(name: str, heading_deg: float, x_m: float, y_m: float, start_s: float = 0.0) -> RigEntry:
    """A rig whose own world lies in the common one."""
    turn = SE3.from_rotvec([0.0, 0.0, math.radians(heading_deg)], [x_m, y_m, 0.0])
    return RigEntry(name, turn @ OWN, start_s)


def test_alignment_error_is_that_of_place_heading_and_clock_and_kept_without_a_limit():
    true = [rig("a", 0, 0, 0), rig("b", 170, 3, 4, 1.0)]
    error = alignment_error([rig("a", 0, 0, 0), rig("b", -179, 3.03, 4.04, 1.02)], true)
    assert error == pytest.approx((5.0, 11.0, 20.0))
    assert [figure("a", value, "cm", 2.0)["ok"] for value in (2.0, 2.1, math.inf)] == [True, False, False]
    assert figure("a", 5.0, "cm")["ok"]


@pytest.mark.parametrize("seed", [1, 11], ids=["nobody moves", "somebody walks"])
def test_floor_of_a_level_camera_is_found_among_larger_walls(seed: int) -> None:
    room = low_room(seed)
    assert room.share < 0.07
    height_m, angle_deg = floor_errors(low_room_floor(room), room.floor)
    assert height_m < HEIGHT_OFF_M and angle_deg < ANGLE_OFF_DEG


def test_floor_error_is_what_no_shift_and_turn_of_the_floor_takes_away() -> None:
    low = GroundCamera(640, 480, 400.0, 2.0, 0.0)
    corners = low.project([[x, y, 0.0] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    high = replace(low, height_m=2.2)  # from straight above all is a tenth farther from the middle
    assert floor_error_m(high, low, corners) == pytest.approx(0.1 * math.sqrt(2.0))
    assert floor_error_m(replace(low, roll_rad=0.3), low, corners) == pytest.approx(0.0, abs=1e-9)
