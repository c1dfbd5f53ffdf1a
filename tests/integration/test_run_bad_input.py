"""``planview run``: everything that can be wrong with a recording, in one sentence each."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_run import FRAMES, Pair, Say, one_sentence, run_few
from toy_stereo import ToyWorld, toy_rig, write_toy_recording

from calib.errors import WorkError
from calib.rig import StereoRig, save_rig
from planview.engine.engine import Engine, FrameResult
from planview.output.folder import read_run_info
from planview.output.run import run
from planview.trajectories.table import read_tracks


def test_frames_that_cannot_be_used_are_skipped_counted_and_bridged(say: Say, copy: Path, tmp_path: Path) -> None:
    (copy / "left" / "000024.png").unlink()
    broken = copy / "right" / "000025.png"
    broken.write_bytes(broken.read_bytes()[:500])
    (copy / "left" / "000026.png").write_bytes(b"no image")
    out = tmp_path / "out"
    status, told = run_few(say, copy, out)
    assert status == 0, told
    info = read_run_info(out / "run.json")
    assert [skipped.index for skipped in info.skipped] == [24, 25, 26]
    assert info.frames_read == FRAMES - 3
    assert "3 skipped" in " ".join(told.split())
    tracks = read_tracks(out / "tracks.csv")
    assert set(tracks.track_id) == {1}
    assert not set(tracks.frame) & {24, 25, 26}
    assert tracks.frame.max() == FRAMES - 1
    after = tracks.where(tracks.frame == 27)
    assert after.timestamp_s[0] == pytest.approx(27 / 15, abs=1e-3)


def test_sides_of_different_lengths_are_refused(say: Say, copy: Path, tmp_path: Path) -> None:
    for i in range(20, FRAMES):
        (copy / "right" / f"{i:06d}.png").unlink()
    status, told = run_few(say, copy, tmp_path / "out")
    assert status == 2
    assert "36 left, 20 right" in one_sentence(told)


def test_sides_of_different_sizes_are_refused(say: Say, copy: Path, tmp_path: Path) -> None:
    for file in (copy / "right").iterdir():
        cv2.imwrite(str(file), np.zeros((120, 160), dtype=np.uint8))
    status, told = run_few(say, copy, tmp_path / "out")
    assert status == 2
    assert "320x240" in one_sentence(told) and "160x120" in told


def test_a_calibration_for_another_image_is_refused(say: Say, copy: Path, tmp_path: Path) -> None:
    save_rig(toy_rig((400, 240)), copy / "rig.toml")
    status, told = run_few(say, copy, tmp_path / "out")
    assert status == 2
    assert "400x240" in one_sentence(told) and "320x240" in told


def test_swapped_folders_are_told(say: Say, recording: Path, tmp_path: Path) -> None:
    swapped = tmp_path / "swapped"
    shutil.copytree(recording, swapped)
    (swapped / "left").rename(swapped / "l")
    (swapped / "right").rename(swapped / "left")
    (swapped / "l").rename(swapped / "right")
    status, told = run_few(say, swapped, tmp_path / "out")
    assert status == 1
    assert "swapped" in one_sentence(told)
    assert not (tmp_path / "out").exists()


def test_a_calibration_with_the_right_camera_on_the_left_is_told(say: Say, copy: Path, tmp_path: Path) -> None:
    rig = toy_rig()
    save_rig(StereoRig(rig.right, rig.left, rig.right_SE3_left.inverse(), "swapped"), copy / "rig.toml")
    status, told = run_few(say, copy, tmp_path / "out")
    assert status == 2
    assert "swapped" in one_sentence(told)


def test_a_calibration_of_another_rig_is_told(say: Say, pairs: list[Pair], tmp_path: Path) -> None:
    other = toy_rig(rotation_deg=(1.5, 0.0, 0.0))
    recording = write_toy_recording(tmp_path / "moved", toy_rig(), pairs[:4], claimed=other)
    status, told = run_few(say, recording, tmp_path / "out")
    assert status == 1
    assert "another rig's" in one_sentence(told)


def test_cameras_that_saw_different_things_are_told(say: Say, pairs: list[Pair], tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (FRAMES, 240, 320), dtype=np.uint8)
    strangers = [(left, other) for (left, _), other in zip(pairs[:6], noise, strict=False)]
    recording = write_toy_recording(tmp_path / "strangers", toy_rig(), strangers)
    status, told = run_few(say, recording, tmp_path / "out")
    assert status == 1
    assert "no floor found in 4 frames" in one_sentence(told)


def test_no_floor_in_view_is_a_failure_told_in_one_sentence(say: Say, tmp_path: Path) -> None:
    world, rig = ToyWorld(tilt_deg=60.0, wall_y_m=1.0), toy_rig()
    recording = write_toy_recording(tmp_path / "wall", rig, [world.pair(rig, (), i) for i in range(4)])
    status, told = run_few(say, recording, tmp_path / "out")
    assert status == 1
    assert "no floor found" in one_sentence(told)


def test_frames_that_are_all_unusable_are_a_failure(engine: Engine, recording: Path, tmp_path: Path) -> None:
    class Empty:
        path, n_frames, fps, rig, skipped = recording, 3, 15.0, engine.recording.rig, ()

        def __iter__(self) -> Iterator[FrameResult]:
            return iter(())

    nothing = Engine(Empty(), engine.front_end, engine.tracker, engine.config)  # type: ignore[arg-type]
    with pytest.raises(WorkError, match="none of 3 frames can be used"):
        run(nothing, tmp_path)
    assert not read_run_info(tmp_path / "run.json").finished


def test_a_truncated_video_is_tracked_to_its_end(say: Say, pairs: list[Pair], copy: Path, tmp_path: Path) -> None:
    for number, side in enumerate(("left", "right")):
        shutil.rmtree(copy / side)
        writer = cv2.VideoWriter(str(copy / f"{side}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 15.0, (320, 240), False)
        assert writer.isOpened()
        for pair in pairs[:24]:
            writer.write(pair[number])
        writer.release()
    video = copy / "right.avi"
    video.write_bytes(video.read_bytes()[: video.stat().st_size * 2 // 3])
    out = tmp_path / "out"
    status, told = run_few(say, copy, out)
    assert status == 0, told
    info = read_run_info(out / "run.json")
    assert 8 <= info.frames_read < 24
    assert info.frames_skipped == 24 - info.frames_read
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--set", "maps.no_such=1"], "maps.no_such"),
        (["--set", "maps.cell_m=7"], "maps.cell_m"),
        (["--tracker", "telepathy"], "telepathy"),
        (["--tracker", "human-model"], "--calibration"),
        (["--frames", "-1"], "--frames"),
        (["--rules", "none.toml"], "none.toml"),
        (["--config", "none.toml"], "none.toml"),
        (["--calibration", "none.toml"], "none.toml"),
        (["--camera", "none.toml", "--tracker", "human-model"], "none.toml"),
    ],
)
def test_wrong_words_are_refused_by_name(say: Say, copy: Path, tmp_path: Path, words: list[str], named: str) -> None:
    path = copy / "left" if "human-model" in words else copy
    status, told = run_few(say, path, tmp_path / "out", *words)
    assert status == 2
    assert named in one_sentence(told)
    assert not (tmp_path / "out").exists()


def test_a_recording_that_is_not_there_is_refused(say: Say, tmp_path: Path) -> None:
    status, told = run_few(say, tmp_path / "nothing", tmp_path / "out")
    assert status == 2
    assert "nothing" in one_sentence(told)
