"""Each planted fault is flagged by the check that is meant for it; the recording without faults passes."""

import json
from collections.abc import Callable
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
from calib.rig import StereoRig
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


def brightened(pairs: Pairs, factor: float) -> Pairs:
    return [(cv2.convertScaleAbs(a, alpha=factor), cv2.convertScaleAbs(b, alpha=factor)) for a, b in pairs]  # type: ignore[misc]


def seen(world: ToyWorld) -> Pairs:
    """Nobody before six frames of a world."""
    return [world.pair(RIG, (), i) for i in range(6)]


IMAGES: dict[str, tuple[Callable[[Pairs], Pairs], set[str]]] = {
    "swapped": (lambda pairs: [(b, a) for a, b in pairs[:8]], {"left-right order"}),
    "vertical shift": (lambda pairs: [(a, np.roll(b, 4, axis=0)) for a, b in pairs[:8]], {"row offset"}),
    "frozen right camera": (lambda pairs: [(a, pairs[0][1]) for a, _ in pairs], {"frozen camera"}),
    "a wall": (
        lambda _: seen(ToyWorld(tilt_deg=55.0, camera_height_m=20.0, wall_y_m=3.0)), {"floor share"},
    ),
    "over-exposed": (lambda pairs: brightened(pairs[:8], 2.5), {"over-exposure"}),
    "under-exposed": (lambda pairs: brightened(pairs[:8], 0.12), {"under-exposure"}),
    "covered right camera": (
        lambda pairs: [(a, np.full_like(b, 3)) for a, b in pairs[:8]], {"brightness match", "matched corners"},
    ),
    "no texture": (
        lambda _: seen(ToyWorld(contrast=0.0, floor_contrast=0.0, noise=0.5)), {"valid disparity", "matched corners"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", IMAGES)
def test_fault_of_the_images(fault, tmp_path, pairs):
    images, expected = IMAGES[fault]
    assert expected <= failed(write_toy_recording(tmp_path / "r", RIG, images(pairs)))


@pytest.mark.parametrize(
    ("rig", "frames", "expected"),
    [
        (RIG.swapped(), 4, {"calibration and layout"}),
        (claimed(scale=1000.0), COUNT, {"calibration and layout"}),
        (toy_rig((400, 240)), 6, {"calibration and layout"}),
        (claimed(mirrored=True), 8, {"mirrored pose"}),
        (turned(RIG, (0.0, 0.0, 2.0)), 8, {"camera turn"}),
    ],
    ids=["cameras swapped", "millimetres", "another image size", "mirrored pose", "turned camera"],
)
def test_fault_of_the_calibration(rig, frames, expected, tmp_path, pairs):
    found = failed(write_toy_recording(tmp_path / "r", RIG, pairs[:frames], claimed=rig))
    assert expected <= found
    assert found == expected or expected != {"calibration and layout"}


def test_fault_units_of_inches(tmp_path, pairs):
    folder = write_toy_recording(tmp_path / "r", RIG, pairs, claimed=claimed(scale=1 / 0.254))
    assert failed(folder) & {"floor share", "camera height", "person height"}


def test_fault_of_scale_against_a_known_height(tmp_path, pairs):
    longer = write_toy_recording(tmp_path / "longer", RIG, pairs, claimed=claimed(scale=1.2))
    assert failed(longer, person_height_m=1.75) == {"person height"}
    empty = write_toy_recording(tmp_path / "empty", RIG, seen(ToyWorld()))
    assert failed(empty, person_height_m=1.75) == {"person height"}
    camera = Camera(*SIZE, 345.0, 345.0, 159.5, 119.5)
    lens = write_toy_recording(tmp_path / "lens", RIG, pairs, claimed=StereoRig(camera, camera, RIG.right_SE3_left))
    assert failed(lens, person_height_m=1.75)


def test_fault_camera_panned_since_calibration(tmp_path, pairs):
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=turned(RIG, (0.0, 2.0, 0.0)))
    diagnosis = examine(folder, frames=8)
    check = next(c for c in diagnosis.checks if c.name == "camera turn")
    assert not check.ok and check.value == pytest.approx(2.0, abs=0.2)


def test_check_writes_the_rig_that_the_recording_corrects(tmp_path, pairs, capsys):
    folder = write_toy_recording(tmp_path / "r", RIG, pairs[:8], claimed=turned(RIG, (0.1, 0.0, 0.3)))
    check(folder, frames=8)
    assert "--corrected-rig rig.toml writes the corrected calibration" in capsys.readouterr().err.replace("\n", " ")
    check(folder, frames=8, corrected_rig=tmp_path / "rig.toml")
    assert "roll corrected by" in capsys.readouterr().err
    left = (load_rig(tmp_path / "rig.toml").right_SE3_left @ RIG.right_SE3_left.inverse()).rotvec
    assert np.degrees(np.abs(left)).max() < 0.03
    with pytest.raises(WorkError, match="nothing to write to"):  # it needs no other correction
        check(folder, frames=8, calibration=tmp_path / "rig.toml", corrected_rig=tmp_path / "other.toml")


def test_fault_late_right_camera(tmp_path, pairs):
    late = [(left, pairs[max(0, i - 3)][1]) for i, (left, _) in enumerate(pairs)]
    diagnosis = examine(write_toy_recording(tmp_path / "r", RIG, late[3:]), frames=COUNT)
    check = next(c for c in diagnosis.checks if c.name == "synchronisation")
    assert not check.ok and check.value == pytest.approx(3.0, abs=0.6)


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


def test_longest_step_is_relative_to_the_usual_one():
    assert longest_step(np.array([0.0, 0.1, 0.2, 0.5, 0.6])) == pytest.approx(3.0)
    assert np.isnan(longest_step(np.array([0.0, 0.1])))


def test_unmeasured_values_fail_only_when_needed():
    nothing = float("nan")
    assert at_most("a", nothing, 1.0, "", "").ok and not at_most("a", nothing, 1.0, "", "", needed=True).ok
    assert at_least("a", nothing, 1.0, "", "").ok and not at_least("a", nothing, 1.0, "", "", needed=True).ok
    assert not between("a", nothing, (0.0, 1.0), "", "", needed=True).ok
    assert at_most("a", nothing, 1.0, "", "").to_json()["value"] is None


def test_command_prints_json_and_refuses_with_status_one(tmp_path, pairs, capsys):
    folder = write_toy_recording(tmp_path / "r", RIG, [(b, a) for a, b in pairs[:6]])
    with pytest.raises(SystemExit, match="1"):
        main(["check", str(folder), "--frames", "6", "--json", "--out", str(tmp_path / "pictures")])
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert result["ok"] is False
    assert {"name", "ok", "value", "unit", "limit"} <= result["checks"][0].keys()
    assert "left-right order" in printed.err
    names = {p.name for p in (tmp_path / "pictures").iterdir()}
    assert names == {"rows.png", "disparity.png", "floor.png", "exposure.png"}


def test_command_refuses_a_height_without_sense(refused, tmp_path):
    assert "0.5 to 2.5 m" in refused("check", tmp_path, "--person-height", "175m")


def test_what_is_no_recording_is_refused_or_told(tmp_path):
    with pytest.raises(InputError, match="nothing there"):
        examine(tmp_path / "absent")
    diagnosis = examine(tmp_path)
    assert isinstance(diagnosis, Diagnosis) and not diagnosis.ok and diagnosis.evidence is None
    assert "left/ and right/" in diagnosis.checks[0].note


def test_a_picture_over_exposed_by_a_hair_is_a_warning_and_no_refusal():
    image = np.full((100, 100), 100, np.uint8)
    image[:37] = 255
    over = next(check for check in light_checks([image]) if check.name == "over-exposure")
    assert over.value == pytest.approx(0.37, abs=0.02) and not over.ok and not over.failed
    refuse_unless_ok([over], "recording")  # --strict goes on
    assert Diagnosis((over,), None).ok
