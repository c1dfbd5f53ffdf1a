"""Calibration from boards, and the frames of a room aligned."""

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import write_frames

from calib.errors import InputError, WorkError
from calib.types import F64
from planview.calibration.align import after, align_rigs
from planview.calibration.board import BoardImages
from planview.evaluation.align import floor_rotation
from planview.evaluation.paths import TICK_S, RigAlignment, WalkedPath


def save(folder: Path, names: Sequence[str], size: tuple[int, int] = (40, 30)) -> Path:
    for i, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((size[1], size[0]), 10 * i + 5, np.uint8))
    return folder


def values(images: BoardImages) -> list[tuple[int, int]]:
    """Grey values of the pairs: which file went where."""
    return [(int(p.left[0, 0]), int(p.right[0, 0])) for p in images if p.left is not None and p.right is not None]


@pytest.mark.parametrize(
    "names",
    [
        ("left01.png", "left02.png", "right01.png", "right02.png"),
        ("left/1.png", "left/2.png", "right/1.png", "right/2.png"),
        ("L1.png", "L2.png", "R1.png", "R2.png"),
        ("leftcamera/Im_L_1.png", "leftcamera/Im_L_2.png", "rightcamera/Im_R_1.png", "rightcamera/Im_R_2.png"),
    ],
)
def test_pairs_are_found_however_they_are_named(names, tmp_path):
    assert values(BoardImages(save(tmp_path, names))) == [(5, 25), (15, 35)]


def test_images_without_a_mate_or_that_cannot_be_decoded_are_named(tmp_path):
    images = BoardImages(save(tmp_path, ["left1.png", "left2.png", "left3.png", "right1.png", "right3.png"]))
    assert [(p.name, p.why) for p in images if p.left is None] == [("left2.png", "has no mate from the other camera")]
    assert values(images) == [(5, 35), (25, 45)]
    (tmp_path / "left1.png").write_bytes(b"\x89PNG broken")
    assert next(iter(images)).why.endswith("left1.png cannot be decoded")


def test_wide_images_are_split_in_halves(tmp_path):
    picture = np.hstack([np.full((30, 40), 7, np.uint8), np.full((30, 40), 9, np.uint8)])
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    assert values(BoardImages(tmp_path)) == [(7, 9)]


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["a.png"], "expected a left and a right image side by side .* found 40x30"),
        ([], "expected"),
        (["left/1.png"], "expected"),
        (["left/1.png", "left2/1.png", "right/1.png"], "expected"),
        (None, "no such file or folder"),
    ],
)
def test_what_holds_no_pairs_is_refused(names, found, tmp_path):
    with pytest.raises(InputError, match=found):
        list(BoardImages(tmp_path / "none" if names is None else save(tmp_path, names)))


def test_a_side_by_side_video_gives_named_frames(tmp_path):
    write_frames(tmp_path / "v.avi", [np.zeros((48, 160, 3), np.uint8)] * 6)
    images = BoardImages(tmp_path / "v.avi")
    assert images.names[0] == "frame 0"
    assert [pair.left.shape[:2] for pair in images if pair.left is not None] == [(48, 80)] * 6


TRUE = RigAlignment(math.radians(140.0), 3.0, 1.5, 2.34)


def path(times_s: F64, xy_m: F64, height_m: float = 1.7) -> WalkedPath:
    """A path at ticks from positions at any times."""
    ticks = np.arange(math.ceil(times_s[0] / TICK_S), math.floor(times_s[-1] / TICK_S) + 1)
    xy = np.column_stack([np.interp(ticks * TICK_S, times_s, column) for column in xy_m.T])
    return WalkedPath(int(ticks[0]), xy, height_m, np.zeros_like(xy))


def both_sensors(xy_m: F64, noise_m: float = 0.03, seed: int = 0) -> tuple[WalkedPath, WalkedPath]:
    """What two sensors measure of a person at xy (T, 2), every 0.05 s: noise and clock are those of TRUE."""
    rng = np.random.default_rng(seed)
    times = 0.05 * np.arange(len(xy_m))
    own = (xy_m - [TRUE.x_m, TRUE.y_m]) @ floor_rotation(TRUE.heading_rad)
    first, second = (p + rng.normal(0, noise_m, p.shape) for p in (xy_m, own))
    return path(times, first), path(times - TRUE.clock_s, second)


def curve(t: F64) -> F64:
    """A walk around a room."""
    return np.column_stack([1.5 * np.sin(0.5 * t) + 0.3 * np.sin(1.3 * t), 3.0 + 1.2 * np.cos(0.4 * t)])


def test_a_walk_with_turns_aligns_two_sensors():
    first, second = both_sensors(curve(0.05 * np.arange(600)))
    found = align_rigs([first], [second], disparity_px=0.0)
    assert math.degrees(abs(found.heading_rad - TRUE.heading_rad)) < 0.5
    assert math.hypot(found.x_m - TRUE.x_m, found.y_m - TRUE.y_m) < 0.03
    assert found.clock_s == pytest.approx(TRUE.clock_s, abs=0.02)
    assert found.shared_s == pytest.approx(30.0, abs=0.3)
    assert found.residual_m == pytest.approx(0.03, abs=0.02)
    assert abs(found.heading_rad - TRUE.heading_rad) < 3 * found.heading_std_rad


@pytest.mark.parametrize(
    ("x_m", "noise_m", "found"),
    [
        (-2.0 + 0.5 * 0.05 * np.arange(200), 0.01, "straight|another that fits"),
        (1.5 * np.sin(0.7 * 0.05 * np.arange(600)), 0.01, "another that fits"),
        (np.full(400, 0.5), 0.03, "stood"),
    ],
    ids=["one straight line at one speed", "to and fro on a line", "standing"],
)
def test_walks_that_determine_no_alignment_are_refused(x_m, noise_m, found):
    first, second = both_sensors(np.column_stack([x_m, np.full(len(x_m), 3.0)]), noise_m)
    with pytest.raises(WorkError, match=found):
        align_rigs([first], [second], disparity_px=0.0)
    with pytest.raises(WorkError, match="found none"):
        align_rigs([], [], disparity_px=0.0)


def test_people_of_other_heights_do_not_meet():
    first, second = both_sensors(curve(0.05 * np.arange(600)))
    taller = WalkedPath(second.first, second.xy_m, 1.95, second.per_px_m)
    with pytest.raises(WorkError, match="no path that fits"):
        align_rigs([first], [taller], disparity_px=0.0)


def test_a_third_sensor_is_placed_by_the_second():
    second, third = RigAlignment(math.pi / 2, 1.0, 2.0, 3.0), RigAlignment(math.pi / 2, 1.0, 0.0, -1.0)
    placed = after(second, third)
    assert (placed.x_m, placed.y_m, placed.clock_s) == pytest.approx((1.0, 3.0, 2.0))
    assert abs(placed.heading_rad) == pytest.approx(math.pi)
