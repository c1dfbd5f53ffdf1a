"""``planview run``: everything that can be wrong with a recording, in one sentence each."""

from collections.abc import Iterator

import numpy as np
import pytest
from toy_run import FEW, FRAMES, run_few
from toy_stereo import ToyWorld, toy_rig, write_toy_recording

from calib.errors import WorkError
from planview.engine.engine import Engine, FrameResult
from planview.output.folder import read_run_info
from planview.output.run import run
from planview.trajectories.table import read_tracks


def test_frames_that_cannot_be_used_are_skipped_counted_and_bridged(cli, copy, tmp_path):
    (copy / "left" / "000024.png").unlink()
    broken = copy / "right" / "000025.png"
    broken.write_bytes(broken.read_bytes()[:500])
    (copy / "left" / "000026.png").write_bytes(b"no image")
    out = tmp_path / "out"
    status, printed = run_few(cli, copy, out)
    assert status == 0, printed
    info = read_run_info(out / "run.json")
    assert [skipped.index for skipped in info.skipped] == [24, 25, 26] and info.frames_read == FRAMES - 3
    assert "3 skipped" in " ".join(printed.split())
    tracks = read_tracks(out / "tracks.csv")
    confirmed = tracks.where(tracks.state == "confirmed")
    assert set(confirmed.track_id) == {1} and not set(tracks.frame) & {24, 25, 26}
    assert tracks.frame.max() == FRAMES - 1
    after = tracks.where(tracks.frame == 27)
    assert after.timestamp_s[0] == pytest.approx(27 / 15, abs=1e-3)


STRANGE = np.random.default_rng(0).integers(0, 255, (6, 240, 320), dtype=np.uint8)
BARE = ToyWorld(tilt_deg=60.0, wall_y_m=1.0)


@pytest.mark.parametrize(
    ("images", "named"),
    [
        (lambda pairs: [(pairs[i][0], STRANGE[i]) for i in range(6)], "no floor found in 4"),
        (lambda pairs: [BARE.pair(toy_rig(), (), i) for i in range(4)], "no floor found"),
    ],
    ids=["different scenes", "no floor in view"],
)
def test_images_without_a_floor_are_a_failure_told_in_one_sentence(refused, pairs, tmp_path, images, named):
    recording = write_toy_recording(tmp_path / "recording", toy_rig(), images(pairs))
    assert named in refused("run", recording, "--out", tmp_path / "out", "--set", FEW, status=1)
    assert not (tmp_path / "out").exists()


def test_frames_that_are_all_unusable_are_a_failure(engine, recording, tmp_path):
    class Empty:
        path, n_frames, fps, rig, skipped = recording, 3, 15.0, engine.recording.rig, ()

        def __iter__(self) -> Iterator[FrameResult]:
            return iter(())

    nothing = Engine(Empty(), engine.front_end, engine.config)  # type: ignore[arg-type]
    with pytest.raises(WorkError, match="none of 3 frames can be used"):
        run(nothing, tmp_path)
    assert not read_run_info(tmp_path / "run.json").finished


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--topics", "a"], "--topics"),
        (["--tracker", "human-model"], "--calibration"),
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
