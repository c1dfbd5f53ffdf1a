"""``planview run`` on a recording of several heads."""

import math
from dataclasses import replace

import pytest
from toy_run import EMPTY, FEW, run_few

from planview.engine.open import open_engine
from planview.output.folder import read_run_info
from planview.trajectories.table import read_tracks


def test_a_person_seen_by_two_heads_is_one_person(cli, heads, engine, tmp_path):
    status, printed = run_few(cli, heads, tmp_path / "out", "--rrd")
    assert status == 0, printed
    tracks = read_tracks(tmp_path / "out" / "tracks.csv")
    assert set(tracks.track_id[tracks.state == "confirmed"]) == {1}
    info = read_run_info(tmp_path / "out" / "run.json")
    assert info.rig is not None and [camera.name for camera in info.rig.heads] == ["left_one", "right_one"]
    assert (tmp_path / "out" / "run.rrd").stat().st_size > 0
    assert "right_one" in (tmp_path / "out" / "report.html").read_text()
    # Two heads weigh against what was predicted as two looks do, so that places differ by a few centimetres.
    alone = {(r.frame, t.track_id): t for r in engine for t in r.tracks}
    sure = tracks.where(tracks.state == "confirmed")
    for frame, track_id, x, y in zip(sure.frame, sure.track_id, sure.x_m, sure.y_m, strict=True):
        assert (x, y) == pytest.approx((alone[frame, track_id].x_m, alone[frame, track_id].y_m), abs=0.04)


def test_a_rig_without_a_frame_is_left_out_of_that_moment(heads, engine):
    together = open_engine(heads, config=engine.config)
    frames = [frame for frame, _ in zip(together.recording, range(EMPTY + 6), strict=False)]
    for frame in frames[:-2]:
        both = together.step(frame)
    assert both.tracks and None not in both.rigs and both.boxed == (both.tracks, both.tracks)
    left = together.step(replace(frames[-2], frames=(frames[-2].frames[0], None)))
    assert left.rigs[1] is None and left.image is not None and len(left.observation.views) == 1
    right = together.step(replace(frames[-1], frames=(None, frames[-1].frames[1])))
    assert right.rigs[0] is None and right.image is None and right.sampled is None
    assert [t.track_id for t in right.tracks] == [t.track_id for t in both.tracks]
    assert not math.isnan(right.tracks[0].box_px[0])


def test_maps_of_several_heads_are_not_saved_and_other_commands_ask_for_one_of_them(refused, heads, tmp_path):
    assert "several heads" in refused("run", heads, "--out", tmp_path / "out", "--set", FEW, "--maps")
    assert "left_one" in refused("calibrate", "floor", heads)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("left_one", "left_one"), "every head once"),
        (("left_one", "right_one", "--clock", "-1"), "--clock"),
        (("left_one", "right_one", "--out", "left_one/rigs.toml"), "above all heads"),
    ],
)
def test_heads_that_cannot_be_aligned_are_refused_at_once(refused, heads, words, found):
    assert found in refused("calibrate", "align", *(heads / w if w[0] in "lr" else w for w in words))
