"""``planview run``: everything that can be wrong with a recording, in one sentence each."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_run import FEW, FRAMES, run_few
from toy_stereo import ToyWorld, toy_rig, write_toy_recording

from calib.errors import WorkError
from calib.rig import StereoRig, save_rig
from planview.engine.engine import Engine, FrameResult
from planview.output.folder import read_run_info
from planview.output.run import run
from planview.trajectories.table import read_tracks


def test_frames_that_cannot_be_used_are_skipped_counted_and_bridged(say, copy, tmp_path):
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


def shorten(recording: Path) -> None:
    for i in range(20, FRAMES):
        (recording / "right" / f"{i:06d}.png").unlink()


def shrink(recording: Path) -> None:
    for file in (recording / "right").iterdir():
        cv2.imwrite(str(file), np.zeros((120, 160), dtype=np.uint8))


def claim(rig: StereoRig) -> Callable[[Path], None]:
    return lambda recording: save_rig(rig, recording / "rig.toml")


def crossed(rig: StereoRig) -> StereoRig:
    """With the right camera on the left."""
    return StereoRig(rig.right, rig.left, rig.right_SE3_left.inverse(), "swapped")


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (shorten, ("36 left, 20 right",)),
        (shrink, ("320x240", "160x120")),
        (claim(toy_rig((400, 240))), ("400x240", "320x240")),
        (claim(crossed(toy_rig())), ("swapped",)),
    ],
    ids=["other length", "other size", "calibration of other images", "calibration with crossed cameras"],
)
def test_sides_and_calibrations_that_do_not_fit_are_refused(refused, copy, tmp_path, damage, named):
    damage(copy)
    told = refused("run", copy, "--out", tmp_path / "out", "--set", FEW)
    assert all(text in told for text in named)


STRANGE = np.random.default_rng(0).integers(0, 255, (6, 240, 320), dtype=np.uint8)
BARE = ToyWorld(tilt_deg=60.0, wall_y_m=1.0)
MOVED = toy_rig(rotation_deg=(1.5, 0.0, 0.0))


@pytest.mark.parametrize(
    ("images", "claimed", "named"),
    [
        (lambda pairs: [(right, left) for left, right in pairs[:6]], toy_rig(), "swapped"),
        (lambda pairs: pairs[:4], MOVED, "another rig's"),
        (lambda pairs: [(pairs[i][0], STRANGE[i]) for i in range(6)], toy_rig(), "no floor found in 4"),
        (lambda pairs: [BARE.pair(toy_rig(), (), i) for i in range(4)], toy_rig(), "no floor found"),
    ],
    ids=["swapped folders", "another rig", "different scenes", "no floor in view"],
)
def test_images_without_a_floor_or_of_another_rig_are_a_failure_told_in_one_sentence(
    refused, pairs, tmp_path, images, claimed, named
):
    recording = write_toy_recording(tmp_path / "recording", toy_rig(), images(pairs), claimed=claimed)
    assert named in refused("run", recording, "--out", tmp_path / "out", "--set", FEW, status=1)
    assert not (tmp_path / "out").exists()


def test_frames_that_are_all_unusable_are_a_failure(engine, recording, tmp_path):
    class Empty:
        path, n_frames, fps, rig, skipped = recording, 3, 15.0, engine.recording.rig, ()

        def __iter__(self) -> Iterator[FrameResult]:
            return iter(())

    nothing = Engine(Empty(), engine.front_end, engine.tracker, engine.config)  # type: ignore[arg-type]
    with pytest.raises(WorkError, match="none of 3 frames can be used"):
        run(nothing, tmp_path)
    assert not read_run_info(tmp_path / "run.json").finished


def test_a_truncated_video_is_tracked_to_its_end(say, pairs, copy, tmp_path):
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
        (["--topics", "a"], "--topics"),
        (["--set", "maps.no_such=1"], "maps.no_such"),
        (["--set", "maps.cell_m=7"], "maps.cell_m"),
        (["--tracker", "telepathy"], "telepathy"),
        (["--tracker", "human-model"], "--calibration"),
        (["--set", "run.frames=-1"], "run.frames"),
        (["--rules", "none.toml"], "none.toml"),
        (["--config", "none.toml"], "none.toml"),
        (["--calibration", "none.toml"], "none.toml"),
        (["--camera", "none.toml", "--tracker", "human-model"], "none.toml"),
    ],
)
def test_wrong_words_are_refused_by_name(refused, copy, tmp_path, words, named):
    path = copy / "left" if "human-model" in words else copy
    assert named in refused("run", path, "--out", tmp_path / "out", "--set", FEW, *words)
    assert not (tmp_path / "out").exists()


def test_a_recording_that_is_not_there_is_refused(refused, tmp_path):
    assert "nothing" in refused("run", tmp_path / "nothing", "--out", tmp_path / "out")
