"""Each planted fault is flagged by the check that is meant for it; the recording without faults passes."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_stereo import SIZE, ToyWorld, toy_rig, walking, write_toy_recording

from calib.camera import Camera
from calib.errors import InputError, WorkError
from calib.formats import load_rig
from calib.pose import SE3
from calib.rig import StereoRig, save_rig
from calib.types import U8
from planview.checks.check import at_least, at_most, between
from planview.checks.examine import Diagnosis, examine, refuse_unless_ok
from planview.checks.pair import light_checks
from planview.checks.timing import longest_step
from planview.cli import main
from planview.commands.recordings import check

RIG = toy_rig(rotation_deg=(0.4, -0.6, 1.0))
COUNT = 30
Pairs = list[tuple[U8, U8]]


@pytest.fixture(scope="module")
def pairs() -> Pairs:
    world = ToyWorld()
    return [world.pair(RIG, walking(i), i) for i in range(COUNT)]


def failed(folder: Path, **options: float) -> set[str]:
    return {check.name for check in examine(folder, frames=COUNT, **options).checks if not check.ok}  # type: ignore[arg-type]


def turned(rig: StereoRig, degrees: tuple[float, float, float]) -> StereoRig:
    """The rig as it would be written before its right camera was turned."""
    turn = SE3.from_rotvec(np.radians(degrees))
    return replace(rig, right_SE3_left=turn @ rig.right_SE3_left)


def test_good_recording_passes(tmp_path: Path, pairs: Pairs) -> None:
    diagnosis = examine(write_toy_recording(tmp_path / "r", RIG, pairs), frames=COUNT, person_height_m=1.75)
    assert [c for c in diagnosis.checks if not c.ok] == []
    values = {c.name: c.value for c in diagnosis.checks}
    assert values["camera height"] == pytest.approx(2.5, abs=0.05)
    assert values["person height"] == pytest.approx(1.75, abs=0.08)
    assert values["synchronisation"] < 0.2
    assert values["depth error at 4 m"] == pytest.approx(0.25 * 16 / (230 * 0.12), rel=0.02)


def test_fault_swapped_images(tmp_path: Path, pairs: Pairs) -> None:
    swapped = [(right, left) for left, right in pairs[:8]]
    assert "left-right order" in failed(write_toy_recording(tmp_path / "r", RIG, swapped))


def test_fault_cameras_swapped_in_the_calibration(tmp_path: Path, pairs: Pairs) -> None:
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:4], claimed=RIG.swapped())
    assert failed(folder) == {"calibration and layout"}


def test_fault_mirrored_pose(tmp_path: Path, pairs: Pairs) -> None:
    mirrored = SE3(RIG.right_SE3_left.rotation.T, RIG.right_SE3_left.translation)
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=replace(RIG, right_SE3_left=mirrored))
    assert "mirrored pose" in failed(folder)


def test_fault_units_of_millimetres(tmp_path: Path, pairs: Pairs) -> None:
    pose = SE3(RIG.right_SE3_left.rotation, 1000.0 * RIG.right_SE3_left.translation)
    folder = write_toy_recording(tmp_path / "r", RIG, pairs, claimed=replace(RIG, right_SE3_left=pose))
    assert failed(folder) == {"calibration and layout"}


def test_fault_units_of_inches(tmp_path: Path, pairs: Pairs) -> None:
    pose = SE3(RIG.right_SE3_left.rotation, RIG.right_SE3_left.translation / 0.254)
    folder = write_toy_recording(tmp_path / "r", RIG, pairs, claimed=replace(RIG, right_SE3_left=pose))
    assert failed(folder) & {"floor share", "camera height", "person height"}


def test_fault_vertical_shift(tmp_path: Path, pairs: Pairs) -> None:
    shifted = [(left, np.roll(right, 4, axis=0)) for left, right in pairs[:8]]
    assert "row offset" in failed(write_toy_recording(tmp_path / "r", RIG, shifted))


def test_fault_camera_turned_since_calibration(tmp_path: Path, pairs: Pairs) -> None:
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=turned(RIG, (0.0, 0.0, 2.0)))
    assert "camera turn" in failed(folder)


def test_fault_camera_panned_since_calibration(tmp_path: Path, pairs: Pairs) -> None:
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=turned(RIG, (0.0, 2.0, 0.0)))
    diagnosis = examine(folder, frames=8)
    check = next(c for c in diagnosis.checks if c.name == "camera turn")
    assert not check.ok and check.value == pytest.approx(2.0, abs=0.2)


def test_check_writes_the_rig_that_the_recording_corrects(
    tmp_path: Path, pairs: Pairs, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=turned(RIG, (0.1, 0.0, 0.3)))
    check(folder, frames=8)
    assert "--corrected-rig rig.toml writes the corrected calibration" in capsys.readouterr().err.replace("\n", " ")
    check(folder, frames=8, corrected_rig=tmp_path / "rig.toml")
    assert "roll corrected by" in capsys.readouterr().err
    left = (load_rig(tmp_path / "rig.toml").right_SE3_left @ RIG.right_SE3_left.inverse()).rotvec
    assert np.degrees(np.abs(left)).max() < 0.03
    with pytest.raises(WorkError, match="nothing to write to"):  # it needs no other correction
        check(folder, frames=8, calibration=tmp_path / "rig.toml", corrected_rig=tmp_path / "other.toml")


def test_fault_late_right_camera(tmp_path: Path, pairs: Pairs) -> None:
    late = [(left, pairs[max(0, i - 3)][1]) for i, (left, _) in enumerate(pairs)]
    diagnosis = examine(write_toy_recording(tmp_path / "r", RIG, late[3:]), frames=COUNT)
    check = next(c for c in diagnosis.checks if c.name == "synchronisation")
    assert not check.ok and check.value == pytest.approx(3.0, abs=0.6)


def test_fault_frozen_right_camera(tmp_path: Path, pairs: Pairs) -> None:
    frozen = [(left, pairs[0][1]) for left, _ in pairs]
    assert "frozen camera" in failed(write_toy_recording(tmp_path / "r", RIG, frozen))


def test_fault_no_floor(tmp_path: Path) -> None:
    world = ToyWorld(tilt_deg=55.0, camera_height_m=20.0, wall_y_m=3.0)  # looks down a wall
    wall = [world.pair(RIG, (), i) for i in range(6)]
    assert "floor share" in failed(write_toy_recording(tmp_path / "r", RIG, wall))


def test_fault_over_exposure(tmp_path: Path, pairs: Pairs) -> None:
    bright = [tuple(cv2.convertScaleAbs(i, alpha=2.5) for i in pair) for pair in pairs[:8]]
    assert "over-exposure" in failed(write_toy_recording(tmp_path / "r", RIG, bright))  # type: ignore[arg-type]


def test_fault_under_exposure(tmp_path: Path, pairs: Pairs) -> None:
    dark = [tuple(cv2.convertScaleAbs(i, alpha=0.12) for i in pair) for pair in pairs[:8]]
    assert "under-exposure" in failed(write_toy_recording(tmp_path / "r", RIG, dark))  # type: ignore[arg-type]


def test_fault_covered_right_camera(tmp_path: Path, pairs: Pairs) -> None:
    covered = [(left, np.full_like(right, 3)) for left, right in pairs[:8]]
    assert {"brightness match", "matched corners"} <= failed(write_toy_recording(tmp_path / "r", RIG, covered))


def test_fault_gaps_in_the_timestamps(tmp_path: Path, pairs: Pairs) -> None:
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:10])
    times = np.arange(10) / 15.0 + (np.arange(10) >= 6) * 1.5
    rows = [f"{i},{t:.4f}" for i, t in enumerate(times)]
    (folder / "timestamps.csv").write_text("\n".join(["frame,timestamp_s", *rows]))
    assert failed(folder) == {"timestamp gap"}


def test_fault_undecodable_frames(tmp_path: Path, pairs: Pairs) -> None:
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:10])
    for i in (2, 4, 7):
        (folder / "left" / f"{i:06d}.png").write_bytes(b"broken")
    assert "usable frames" in failed(folder)


def test_fault_no_texture(tmp_path: Path) -> None:
    world = ToyWorld(contrast=0.0, floor_contrast=0.0, noise=0.5)
    bare = [world.pair(RIG, (), i) for i in range(6)]
    assert {"valid disparity", "matched corners"} <= failed(write_toy_recording(tmp_path / "r", RIG, bare))


def test_fault_calibration_for_another_image_size(tmp_path: Path, pairs: Pairs) -> None:
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:6], claimed=toy_rig((400, 240)))
    assert failed(folder) == {"calibration and layout"}


def test_fault_baseline_wrong_against_a_known_height(tmp_path: Path, pairs: Pairs) -> None:
    pose = SE3(RIG.right_SE3_left.rotation, 1.2 * RIG.right_SE3_left.translation)
    folder = write_toy_recording(tmp_path / "r", RIG, pairs, claimed=replace(RIG, right_SE3_left=pose))
    assert failed(folder, person_height_m=1.75) == {"person height"}


def test_known_height_with_nobody_to_measure_is_refused(tmp_path: Path) -> None:
    world = ToyWorld()
    empty = [world.pair(RIG, (), i) for i in range(6)]
    assert failed(write_toy_recording(tmp_path / "r", RIG, empty), person_height_m=1.75) == {"person height"}


def test_fault_focal_length_of_another_lens(tmp_path: Path, pairs: Pairs) -> None:
    camera = Camera(*SIZE, 345.0, 345.0, 159.5, 119.5)
    wrong = StereoRig(camera, camera, RIG.right_SE3_left)
    assert failed(write_toy_recording(tmp_path / "r", RIG, pairs, claimed=wrong), person_height_m=1.75)


def test_missing_recording_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing there"):
        examine(tmp_path / "absent")


def test_longest_step_is_relative_to_the_usual_one() -> None:
    assert longest_step(np.array([0.0, 0.1, 0.2, 0.5, 0.6])) == pytest.approx(3.0)
    assert np.isnan(longest_step(np.array([0.0, 0.1])))


def test_unmeasured_values_fail_only_when_needed() -> None:
    nothing = float("nan")
    assert at_most("a", nothing, 1.0, "", "").ok and not at_most("a", nothing, 1.0, "", "", needed=True).ok
    assert at_least("a", nothing, 1.0, "", "").ok and not at_least("a", nothing, 1.0, "", "", needed=True).ok
    assert not between("a", nothing, (0.0, 1.0), "", "", needed=True).ok
    assert at_most("a", nothing, 1.0, "", "").to_json()["value"] is None


def test_command_prints_json_and_refuses_with_status_one(
    tmp_path: Path, pairs: Pairs, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_toy_recording(tmp_path / "r", RIG, [(b, a) for a, b in pairs[:6]])
    with pytest.raises(SystemExit) as stopped:
        main(["check", str(folder), "--frames", "6", "--json", "--out", str(tmp_path / "pictures")])
    assert stopped.value.code == 1
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert result["ok"] is False
    assert {"name", "ok", "value", "unit", "limit"} <= result["checks"][0].keys()
    assert "left-right order" in printed.err
    names = {p.name for p in (tmp_path / "pictures").iterdir()}
    assert names == {"rows.png", "disparity.png", "floor.png", "exposure.png"}


def test_command_refuses_a_height_without_sense(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_rig(RIG, tmp_path / "rig.toml")
    with pytest.raises(SystemExit) as stopped:
        main(["check", str(tmp_path), "--person-height", "175m"])
    assert stopped.value.code == 2 and "0.5 to 2.5 m" in capsys.readouterr().err


def test_diagnosis_without_evidence_still_says_why(tmp_path: Path) -> None:
    diagnosis = examine(tmp_path)
    assert isinstance(diagnosis, Diagnosis) and not diagnosis.ok
    assert diagnosis.evidence is None and "left/ and right/" in diagnosis.checks[0].note


def test_fault_compression_to_blocks(tmp_path: Path, pairs: Pairs) -> None:
    coded = [tuple(cv2.imencode(".jpg", i, [cv2.IMWRITE_JPEG_QUALITY, 5])[1] for i in pair) for pair in pairs[:4]]
    blocks = [tuple(cv2.imdecode(c, cv2.IMREAD_GRAYSCALE) for c in pair) for pair in coded]
    assert "compression" in failed(write_toy_recording(tmp_path / "r", RIG, blocks))  # type: ignore[arg-type]


def test_a_picture_over_exposed_by_a_hair_is_a_warning_and_no_refusal() -> None:
    image = np.full((100, 100), 100, np.uint8)
    image[:37] = 255
    over = next(check for check in light_checks([image]) if check.name == "over-exposure")
    assert over.value == pytest.approx(0.37, abs=0.02) and not over.ok and not over.failed
    refuse_unless_ok([over], "recording")  # --strict goes on
    assert Diagnosis((over,), None).ok
