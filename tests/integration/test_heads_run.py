"""``planview run`` on a recording of several heads."""

import shutil
from pathlib import Path

import pytest
from toy_run import Say, one_sentence, run_few

from calib.world import RigEntry, save_rigs
from planview.engine.pipeline import Pipeline
from planview.output.folder import read_run_info
from planview.trajectories.table import read_tracks


@pytest.fixture(scope="module")
def heads(recording: Path, engine: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two heads at one place that record the same."""
    folder = tmp_path_factory.mktemp("heads")
    for name in ("left_one", "right_one"):
        shutil.copytree(recording, folder / name)
    pose = engine.setup.floor.world_SE3_left
    save_rigs([RigEntry("left_one", pose), RigEntry("right_one", pose)], folder / "rigs.toml")
    return folder


def test_a_person_seen_by_two_heads_is_one_person(say: Say, heads: Path, engine: Pipeline, tmp_path: Path) -> None:
    status, told = run_few(say, heads, tmp_path / "out", "--rrd", "--debug")
    assert status == 0, told
    tracks = read_tracks(tmp_path / "out" / "tracks.csv")
    assert set(tracks.track_id[tracks.state == "confirmed"]) == {1}
    info = read_run_info(tmp_path / "out" / "run.json")
    assert info.rig is not None and [camera.name for camera in info.rig.heads] == ["left_one", "right_one"]
    assert (tmp_path / "out" / "run.rrd").stat().st_size > 0
    assert "right_one" in (tmp_path / "out" / "report.html").read_text()
    # Two heads weigh against what was predicted as two looks do, so that places differ by a few centimetres.
    alone = {(r.frame, t.track_id): t for r in engine for t in r.tracks}
    for frame, track_id, x, y in zip(tracks.frame, tracks.track_id, tracks.x_m, tracks.y_m, strict=True):
        assert (x, y) == pytest.approx((alone[frame, track_id].x_m, alone[frame, track_id].y_m), abs=0.04)


def test_maps_of_several_heads_are_not_saved_and_why(say: Say, heads: Path, tmp_path: Path) -> None:
    status, told = run_few(say, heads, tmp_path / "out", "--maps")
    assert status == 2
    assert "several heads" in one_sentence(told)


def test_other_commands_ask_for_one_of_the_heads(say: Say, heads: Path) -> None:
    status, told = say("calibrate", "floor", heads)
    assert status == 2
    assert "left_one" in one_sentence(told)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("left_one", "left_one"), "every head once"),
        (("left_one", "right_one", "--clock", "-1"), "--clock"),
        (("left_one", "right_one", "--out", "left_one/rigs.toml"), "above all heads"),
    ],
)
def test_heads_that_cannot_be_aligned_are_refused_at_once(
    say: Say, heads: Path, words: tuple[str, ...], found: str
) -> None:
    status, told = say("calibrate", "align", *(heads / w if w[0] in "lr" else w for w in words))
    assert status == 2
    assert found in one_sentence(told)
