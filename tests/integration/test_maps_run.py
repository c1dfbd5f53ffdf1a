"""``planview run --maps``, and tracking what it wrote."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from toy_run import FRAMES, run_few

from planview.engine.engine import Engine, FrameResult
from planview.engine.replay import recorded_config, replay_engine
from planview.maps.recording import MapsRecording
from planview.output.folder import read_run_info
from planview.output.maps_log import MapsLog
from planview.output.run import RunOptions, run
from planview.tracking.joint import JointTracker

PRODUCTS = ("tracks.csv", "decisions.csv")


@pytest.fixture(scope="module")
def live(engine: Engine, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[FrameResult]]:
    """The folder of a run that saved its maps, and its results."""
    folder = tmp_path_factory.mktemp("live")
    results: list[FrameResult] = []
    run(engine, folder, RunOptions(), [MapsLog(engine, folder / "maps.h5")], results.append)
    return folder, results


@pytest.fixture
def maps(live: tuple[Path, list[FrameResult]], tmp_path: Path) -> Path:
    """A copy to be damaged."""
    return Path(shutil.copy(live[0] / "maps.h5", tmp_path / "maps.h5"))


def test_maps_are_tracked_again_bit_for_bit(cli, live, maps, tmp_path):
    status, printed = cli("run", maps, "--out", tmp_path / "again")
    assert status == 0, printed
    for name in PRODUCTS:
        assert (tmp_path / "again" / name).read_bytes() == (live[0] / name).read_bytes()
    again, before = read_run_info(tmp_path / "again" / "run.json"), read_run_info(live[0] / "run.json")
    assert (again.floor, again.rig, again.config) == (before.floor, before.rig, before.config)
    assert again.frames_read == FRAMES


def test_maps_built_from_the_recording_are_those_of_the_run(live, engine):
    recording = MapsRecording(live[0] / "maps.h5")
    config = recorded_config(recording)
    again = list(replay_engine(recording, JointTracker(config.joint), config))
    assert len(again) == len(live[1]) == FRAMES
    for before, after in zip(live[1], again, strict=True):
        old, new = before.observation.maps, after.observation.maps
        np.testing.assert_array_equal(new.height, old.height, strict=True)
        np.testing.assert_array_equal(new.occupancy, old.occupancy, strict=True)
        for name in ("xyz", "area", "pixels", "colours"):
            np.testing.assert_array_equal(getattr(new.points, name), getattr(old.points, name), strict=True)
        assert after.tracks == before.tracks


def test_another_tracker_follows_the_same_maps(cli, maps, tmp_path):
    out = tmp_path / "out"
    status, printed = cli("run", maps, "--out", out, "--tracker", "template", "--set", "seed=3")
    assert status == 0, printed
    info = read_run_info(out / "run.json")
    assert (info.tracker, info.config["seed"], info.frames_read) == ("template", 3, FRAMES)


def test_the_command_saves_maps_without_any_image(cli, copy, tmp_path):
    status, printed = run_few(cli, copy, tmp_path / "out", "--maps", "--set", "run.frames=12")
    assert status == 0, printed
    with h5py.File(tmp_path / "out" / "maps.h5") as file:
        assert set(file["points"]) == {"pixel", "disparity", "appearance"}
        assert len(file["frames/index"]) == 12


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--set", "foreground.learning_rate=0.1"], "expected foreground as recorded"),
        (["--set", "maps.height_max_m=3"], "expected maps.height_max_m as recorded"),
        (["--tracker", "human-model"], "human-model"),
        (["--calibration", "rig.toml"], "rig.toml"),
        (["--maps"], "--maps"),
    ],
)
def test_words_that_do_not_go_with_maps_are_refused(refused, maps, tmp_path, words, named):
    assert named in refused("run", maps, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


def test_maps_are_not_replaced_by_their_own_tracking(refused, maps):
    assert "another folder" in refused("run", maps, "--out", maps.parent, "--set", "run.overwrite=true")
    assert maps.exists()


def test_maps_cut_short_and_other_hdf5_files_are_refused(refused, maps, tmp_path):
    maps.write_bytes(maps.read_bytes()[:-5000])
    assert f"{maps}: expected plan-view maps" in refused("run", maps, "--out", tmp_path / "out")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = [1, 2]
    assert "expected plan-view maps" in refused("run", tmp_path / "other.h5", "--out", tmp_path / "out")
