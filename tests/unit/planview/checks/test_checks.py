"""What is wrong with a recording: camera, pair, timing."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_stereo import SIZE, ToyWorld, toy_rig, walking, write_toy_recording

from calib.camera import Camera
from calib.errors import InputError, WorkError
from calib.formats import load_rig
from calib.pose import SE3
from calib.rig import Floor, StereoRig
from calib.types import F32, F64, U8
from planview.api.check import verdict
from planview.checks.check import Check, limit_check
from planview.checks.examine import examine
from planview.checks.heights import height_check
from planview.checks.images import flicker_check, light_checks
from planview.checks.motion import MotionWatch, repeated_check
from planview.checks.scene import floor_checks
from planview.checks.timing import LONGEST_LAG, SURELY, WINDOW, SpeedWatch, lag_of
from planview.checks.watch import refuse_unless_ok
from planview.cli import main
from planview.commands.check import check
from stereo.doctor.hypotheses import LATE
from stereo.thumbnails import Thumbnails

FRAMES = 60


def picture(t: float, shift: int) -> U8:
    """A square of 20 px that moves along the diagonal, to and fro, with noise; ``shift`` is its disparity."""
    image = np.random.default_rng((round(1000 * t), shift)).integers(58, 63, (96, 120), dtype=np.uint8)
    place = round(35 + 25 * np.sin(t / 5.0) + 8 * np.sin(t / 1.7))
    image[place : place + 20, place + 10 - shift : place + 30 - shift] = 200
    return image


def watched(left: Sequence[U8], right: Sequence[U8 | F32], is_pair: bool = True) -> dict[str, Check]:
    watch = MotionWatch()
    for index, pair in enumerate(zip(left, right, strict=True)):
        watch.update(Thumbnails(*pair, is_pair), index / 10)
    return {check.name: check for check in watch.checks()}


@pytest.fixture(scope="module")
def sides() -> tuple[list[U8], list[U8]]:
    return [picture(i, 0) for i in range(FRAMES)], [picture(i, 6) for i in range(FRAMES)]


def test_depth_that_stands_still_or_comes_twice_is_named_with_how_long(sides):
    images, depths = sides[0], [image.astype(np.float32) for image in sides[1]]
    assert "frozen camera" not in failing(watched(images, depths, is_pair=False))
    stands = watched(images, depths[:40] + [depths[40]] * (FRAMES - 40), is_pair=False)
    assert {"frozen camera", "stalled camera"} <= failing(stands)
    assert "the depth stands still from 4.2 to 5.9 s" in stands["frozen camera"].note  # nothing moves in frame 41
    assert "frozen camera" in failing(watched(images, [depths[n // 2 * 2] for n in range(FRAMES)], is_pair=False))


def test_cameras_that_stand_still_while_people_walk_are_named(sides):
    paused = [*range(20), *[20] * 20, *range(40, FRAMES)]
    found = watched(*([side[n] for n in paused] for side in sides))["stalled camera"]
    assert not found.ok
    assert found.value == 19
    assert "the left camera and the right camera stand still from 2.1 to 4.0 s" in found.note


def test_an_image_that_stands_still_while_its_depth_does_not_is_named(sides):
    images, depths = ([sides[0][n] for n in [*range(20), *[20] * 20, *range(40, FRAMES)]], sides[1])
    found = watched(images, [depth.astype(np.float32) for depth in depths], is_pair=False)["stalled camera"]
    assert not found.ok
    assert ": the image stands still from 2.1 to 4.0 s" in found.note


def test_people_who_stop_do_not_make_cameras_stand_still(sides):
    stopped = [*range(20), *[20] * 20, *range(20, 40)]
    assert "stalled camera" not in failing(watched(*([side[n] for n in stopped] for side in sides)))


def failing(found: dict[str, Check]) -> set[str]:
    return {name for name, check in found.items() if not check.ok}


def test_cameras_in_step_pass(sides):
    found = watched(*sides)
    assert found["synchronisation"].value < 0.2
    assert failing(found) == set()


def test_still_scenes_pass():
    still = watched(*[[picture(0, 0)] * FRAMES] * 2)
    assert np.isnan(still["synchronisation"].value)
    assert failing(still) == set()


def test_pairs_that_are_copies_are_reported(sides):
    copied = watched(*([side[i * 4 // 5] for i in range(FRAMES)] for side in sides))
    assert copied["repeated pairs"].value == pytest.approx(0.17, abs=0.05)


@pytest.mark.parametrize("late", [1, 2, 3, 8, -2])
def test_images_that_are_late_are_reported_with_their_lag(sides, late):
    left, right = sides
    found = watched(left[late:], right[:-late]) if late > 0 else watched(left[:late], right[-late:])
    lag = found["synchronisation"]
    assert not lag.ok
    assert lag.value == pytest.approx(abs(late), abs=0.3)
    assert f"right camera {'late' if late > 0 else 'ahead'}, by movement: {LATE['right camera'].remedy}" in lag.note


def test_camera_that_stalls_once_is_reported_by_the_length_of_the_stall(sides):
    left, right = sides
    found = watched(left * 5, (right[:20] + [right[19]] * 12 + right[32:]) + right * 4)
    assert found["frozen camera"].value < 0.1
    assert 10 <= found["stalled camera"].value <= 12
    assert failing(found) == {"stalled camera"}


def test_second_half_that_is_late_is_reported(sides):
    long = [[picture(i * 1.0 + 0.001 * i * i, shift) for i in range(360)] for shift in (0, 6)]
    found = watched(long[0], long[1][:180] + long[1][165:345])
    assert found["synchronisation"].value == pytest.approx(15, abs=1.0)


@pytest.mark.parametrize("side", [0, 1])
def test_picture_written_twice_leaves_its_camera_behind(sides, side):
    both = [list(images) for images in sides]
    both[side] = both[side][:15] + both[side][14:-1]
    found = watched(*both)
    assert round(found["synchronisation"].value) == 1
    assert "synchronisation" in failing(found)
    assert f"right camera {'late' if side else 'ahead'}, by movement" in found["synchronisation"].note


def test_every_second_frame_that_is_darker_is_a_warning():
    rng = np.random.default_rng(0)
    steady = 90 + 10 * np.sin(np.arange(60) / 20) + rng.normal(0, 2, 60)
    assert flicker_check(list(steady)).ok
    assert flicker_check([90.0] * 4).ok
    check = flicker_check(list(steady * np.where(np.arange(60) % 2, 0.8, 1.0)))
    assert not check.ok
    assert check.warns
    assert check.value == pytest.approx(0.2, abs=0.02)


def wave(late: float, frames: int = WINDOW, seed: int = 0) -> F64:
    t = np.arange(frames)[:, None] - late + np.array([0.0, 20.0, 40.0])
    noise = np.random.default_rng((seed, round(10 * late) + 100)).normal(0, 0.05, (frames, 3))
    return np.sin(t / 3.0) + 0.5 * np.sin(t / 7.0) + noise


@pytest.mark.parametrize("late", [2.5, -2.5])
def test_lag_is_found_between_frames_within_its_deviation(late):
    lag = lag_of(wave(0.0), wave(late))
    assert lag.frames == pytest.approx(late, abs=0.15)
    assert abs(lag.frames - late) < 4 * lag.std + 0.05
    assert lag.gain > SURELY


def test_lag_of_one_burst_is_not_sure():
    left, right = np.zeros((WINDOW, 3)), np.zeros((WINDOW, 3))
    left[47:51], right[55:59] = 1.0, 1.0  # somebody comes into the right camera's view eight frames later
    assert not lag_of(left, right).gain > SURELY


def test_frames_long_after_any_movement_are_not_kept():
    watch, still = MotionWatch(), Thumbnails(picture(0, 0), picture(0, 6))
    for _ in range(3 * LONGEST_LAG):
        watch.update(still)
    assert len(watch._bands) == LONGEST_LAG


def test_a_floor_that_may_be_a_wall_is_a_warning():
    floor = Floor(SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 5.0])), 0.8, 0.02)
    assert not any(check.warns for check in floor_checks(floor))
    (warning,) = (check for check in floor_checks(replace(floor, doubt="it may be a wall")) if not check.ok)
    assert warning.warns
    assert warning.note == "it may be a wall"


def test_thumbnails_leave_out_what_one_camera_alone_shows():
    left, right = np.zeros((48, 80), np.uint8), np.zeros((48, 80), np.uint8)
    left[:, :10], right[:, 70:] = 255, 255
    small = Thumbnails.of_pair(left, right)
    assert small.left.shape == small.right.shape == (24, 35)
    assert not small.left.any()
    assert not small.right.any()


RIG = toy_rig(rotation_deg=(0.4, -0.6, 1.0))
COUNT = 30
Pairs = list[tuple[U8, U8]]


@pytest.fixture(scope="module")
def pairs() -> Pairs:
    world = ToyWorld()
    return [world.pair(RIG, walking(i), i) for i in range(COUNT)]


def failed(folder: Path, **options: float) -> set[str]:
    return {check.name for check in examine(folder, frames=COUNT, **options).checks if not check.ok}


def turned(rig: StereoRig, degrees: tuple[float, float, float]) -> StereoRig:
    """The rig as it would be written before its right camera was turned."""
    turn = SE3.from_rotvec(np.radians(degrees))
    return replace(rig, right_SE3_left=turn @ rig.right_SE3_left)


def test_good_recording_passes(tmp_path, pairs):
    diagnosis = examine(write_toy_recording(tmp_path / "r", RIG, pairs), frames=COUNT, person_height_m=1.75)
    assert [c for c in diagnosis.checks if not c.ok] == []
    values = {c.name: c.value for c in diagnosis.checks}
    assert values["camera height"] == pytest.approx(2.5, abs=0.05)
    assert values["person height"] == pytest.approx(1.75, abs=0.08)
    assert values["synchronisation"] < 0.2
    assert values["depth error at 4 m"] == pytest.approx(0.25 * 16 / (230 * 0.12), rel=0.02)


def claimed(scale: float = 1.0, mirrored: bool = False) -> StereoRig:
    """The rig with another baseline, or with the pose of its mirror image."""
    pose = RIG.right_SE3_left
    return replace(RIG, right_SE3_left=SE3(pose.rotation.T if mirrored else pose.rotation, scale * pose.translation))


def seen(world: ToyWorld) -> Pairs:
    """Nobody before six frames of a world."""
    return [world.pair(RIG, (), i) for i in range(6)]


@pytest.mark.parametrize(
    ("world", "expected"),
    [
        (ToyWorld(tilt_deg=55.0, camera_height_m=20.0, wall_y_m=3.0), {"floor share"}),
        (ToyWorld(contrast=0.0, floor_contrast=0.0, noise=0.5), {"valid disparity", "matched corners"}),
    ],
    ids=["a wall", "no texture"],
)
def test_fault_of_the_scene(world, expected, tmp_path):
    assert expected <= failed(write_toy_recording(tmp_path / "r", RIG, seen(world)))


@pytest.mark.parametrize(
    ("rig", "expected"),
    [(claimed(scale=1000.0), "calibration and layout"), (claimed(mirrored=True), "row offset")],
    ids=["millimetres", "mirrored pose"],
)
def test_fault_of_the_calibration(rig, expected, tmp_path, pairs):
    assert expected in failed(write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=rig))


@pytest.mark.parametrize(("median_m", "ok", "failed"), [(1.7, True, False), (1.05, False, False), (2.4, False, True)])
def test_height_that_no_adults_have_is_a_warning_unless_impossible(median_m, ok, failed):
    check = height_check(np.full(30, median_m))
    assert (check.ok, check.failed) == (ok, failed)
    assert ("focal length, baseline or unit" in check.note) == (median_m == 1.05)


def test_scale_that_makes_people_too_small_is_a_warning(tmp_path, pairs):
    folder = write_toy_recording(tmp_path / "r", RIG, pairs, claimed=claimed(scale=0.7))
    (check,) = [check for check in examine(folder).checks if check.name == "person height"]
    assert check.value == pytest.approx(0.7 * 1.75, abs=0.08)
    assert check.warns
    assert not check.ok


def test_fault_of_scale_against_a_known_height(tmp_path, pairs):
    longer = write_toy_recording(tmp_path / "longer", RIG, pairs, claimed=claimed(scale=1.2))
    assert failed(longer, person_height_m=1.75) == {"person height"}
    empty = write_toy_recording(tmp_path / "empty", RIG, seen(ToyWorld()))
    assert failed(empty, person_height_m=1.75) == {"person height"}
    camera = Camera(*SIZE, 345.0, 345.0, 159.5, 119.5)
    lens = write_toy_recording(tmp_path / "lens", RIG, pairs, claimed=StereoRig(camera, camera, RIG.right_SE3_left))
    assert failed(lens, person_height_m=1.75)


def test_camera_that_was_panned_since_its_calibration_is_reported_with_the_angle(tmp_path, pairs):
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=turned(RIG, (0.0, 2.0, 0.0)))
    check = next(check for check in examine(folder).checks if check.name == "camera turn")
    assert not check.ok
    assert check.value == pytest.approx(2.0, abs=0.2)


def test_check_writes_the_rig_that_the_recording_corrects(tmp_path, pairs, capsys):
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=turned(RIG, (0.1, 0.0, 0.3)))
    check(folder, frames=8)
    assert "--corrected-rig rig.toml writes the corrected calibration" in " ".join(capsys.readouterr().err.split())
    check(folder, frames=8, corrected_rig=tmp_path / "rig.toml")
    assert f"wrote {tmp_path / 'rig.toml'}" in capsys.readouterr().err
    left = (load_rig(tmp_path / "rig.toml").right_SE3_left @ RIG.right_SE3_left.inverse()).rotvec
    assert np.degrees(np.abs(left)).max() < 0.03


def test_corrected_rig_of_a_calibration_that_fits_is_refused_below_the_table(tmp_path, pairs, capsys):
    folder, rig = write_toy_recording(tmp_path / "r", RIG, pairs[:8]), tmp_path / "rig.toml"
    with pytest.raises(WorkError, match=r"rig\.toml was not written: there is nothing to correct"):
        check(folder, frames=8, corrected_rig=rig)
    assert "camera turn" in capsys.readouterr().out
    assert not rig.exists()


def test_a_value_is_shown_to_the_first_digit_of_its_deviation():
    assert limit_check("turn", 0.16712, "deg", "", std=0.0052, most=0.5).number_text == "0.167 ± 0.005"
    assert limit_check("lag", 12.34, "frames", "", std=15.0, most=0.5).number_text == "12 ± 15"
    assert limit_check("corners", 1312.4, "", "", least=60).number_text == "1,312"
    assert limit_check("turn", math.nan, "deg", "", most=0.5).number_text == ""


def test_light_is_named_after_the_camera_that_has_it():
    dark, bright = np.zeros((8, 8), np.uint8), np.full((8, 8), 255, np.uint8)
    over, under = light_checks([dark], [bright])
    assert over.note.endswith("of the right camera")
    assert under.note.endswith("of the left camera")
    assert not any("camera" in one.note for one in light_checks([bright]))


def test_frames_that_are_written_twice_are_a_warning(pairs):
    images = [left for left, _ in pairs[:16]]
    assert repeated_check(images).ok
    check = repeated_check([image for image in images for _ in range(2)])
    assert not check.ok
    assert check.value == pytest.approx(0.5, abs=0.1)
    assert check.warns


@pytest.mark.parametrize(("fps", "ok"), [(10.0, True), (60.0, False)])
def test_people_who_run_all_the_time_are_a_warning_of_a_wrong_rate(fps, ok):
    watch = SpeedWatch()
    for frame in range(60):  # 0.12 m a frame, and one who stands
        watch.update(frame / fps, {1: (0.12 * frame, 0.0), 2: (0.0, 1.0)})
    assert watch.check().value == pytest.approx(0.12 * fps)
    assert watch.check().ok is ok


def test_speed_between_frames_of_one_time_does_not_count():
    watch = SpeedWatch()
    for frame in range(60):
        watch.update(1.0, {1: (0.12 * frame, 0.0)})
    assert np.isnan(watch.check().value)


def test_fault_gaps_in_the_timestamps(tmp_path, pairs):
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:10])
    times = np.arange(10) / 15.0 + (np.arange(10) >= 6) * 1.5
    rows = [f"{i},{t:.4f}" for i, t in enumerate(times)]
    (folder / "timestamps.csv").write_text("\n".join(["frame,timestamp_s", *rows]))
    assert failed(folder) == {"timestamp gap"}


def test_fault_undecodable_frames(tmp_path, pairs):
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:10])
    for i in (2, 4, 7):
        (folder / "left" / f"{i:06d}.png").write_bytes(b"broken")
    assert "usable frames" in failed(folder)


def test_unmeasured_values_fail_only_when_needed():
    nothing = float("nan")
    assert limit_check("a", nothing, "", "", most=1.0).ok
    assert limit_check("a", nothing, "", "", least=1.0).ok
    assert not limit_check("a", nothing, "", "", least=1.0, needed=True).ok
    assert not limit_check("a", nothing, "", "", least=0.0, most=1.0, needed=True).ok
    assert limit_check("a", nothing, "", "", most=1.0).to_json()["value"] is None


def test_command_prints_json_although_checks_fail(tmp_path, pairs, capsys):
    folder = write_toy_recording(tmp_path / "r", RIG, [(b, a) for a, b in pairs[:6]])
    with pytest.raises(SystemExit, match="1"):
        main(["check", str(folder), "--frames", "6", "--json", "--out", str(tmp_path / "pictures")])
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert result["ok"] is False
    assert {"name", "ok", "value", "unit", "limit"} <= result["checks"][0].keys()
    assert "left-right order" in printed.err
    names = {p.name for p in (tmp_path / "pictures").iterdir()}
    assert names == {"rows.png", "disparity.png", "floor.png"}


def test_the_verdict_names_what_failed_before_what_is_a_warning():
    warned = height_check(np.full(30, 1.05))
    failed = Check("valid disparity", False, 0.2, "", 0.35, "at least", "share of the picture")
    fine = Check("row offset", True, 0.1)
    cause = Check("explanation", False, math.nan, note="if left is right", warns=True)
    lines = verdict((fine, warned, failed, cause))
    assert "1 of 4 checks failed and 2 warnings" in lines[0]
    assert lines[1] == "warning: explanation: if left is right"
    assert lines[2].startswith("failed: valid disparity: expected at least 0.35, found 0.2")
    assert lines[3].startswith("warning: person height: expected 1.5 to 1.95 m, found 1.05")


def test_the_verdict_names_what_was_not_measured():
    (line,) = verdict((Check("row offset", True, 0.1), height_check(np.empty(0))))
    assert "not measured: person height" in line


def test_command_refuses_a_height_without_sense(refused, tmp_path):
    assert "0.5 to 2.5 m" in refused("check", tmp_path, "--person-height", "175m")


def test_what_is_no_recording_is_refused_or_reported(tmp_path):
    with pytest.raises(InputError, match="no such file or folder"):
        examine(tmp_path / "absent")
    diagnosis = examine(tmp_path)
    assert diagnosis.checks[0].failed
    assert diagnosis.seen is None
    assert "expected a recording, found an empty folder" in diagnosis.checks[0].note


def test_a_picture_over_exposed_by_a_hair_is_a_warning():
    image = np.full((100, 100), 100, np.uint8)
    image[:37] = 255
    over = next(check for check in light_checks([image]) if check.name == "over-exposure")
    assert over.value == pytest.approx(0.37, abs=0.02)
    assert not over.ok
    assert not over.failed
    refuse_unless_ok([over], "recording")  # --strict goes on
