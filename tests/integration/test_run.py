"""``planview run`` over a small exact world: the contract of its folder."""

import csv
import io
import json
import re
from contextlib import redirect_stderr
from pathlib import Path

import numpy as np
import pytest
from toy_run import EMPTY, FEW, FRAMES, is_whole, run_few, write_world
from toy_stereo import toy_rig, walking, write_toy_recording

from planview.cli import main
from planview.engine.config import load_config
from planview.engine.open import open_engine
from planview.output.folder import read_run_info
from planview.output.run import run
from planview.output.run_spec import RunSpec
from planview.trajectories.table import read_tracks


@pytest.fixture(scope="module")
def folder(engine, recording, tmp_path_factory) -> Path:
    """A run with everything: rules, decisions and the rerun recording, by the command."""
    out = tmp_path_factory.mktemp("run")
    rules = out.parent / "rules.toml"
    rules.write_text('[[tripwire]]\nname = "gate"\nfrom_m = [-0.6, 1.0]\nto_m = [-0.6, 6.0]\n')
    words = ["run", str(recording), "--out", str(out), "--set", FEW, "--rules", str(rules), "--rrd"]
    output = io.StringIO()
    with redirect_stderr(output), pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code in (0, None)
    (out.parent / "output.txt").write_text(output.getvalue())
    return out


def test_the_summary_tells_counts_before_the_speed(folder):
    output = " ".join((folder.parent / "output.txt").read_text().split())
    assert re.search(r"gate tripwire left to right \d, right to left \d, people 1", output)
    assert re.search(r"tracked in \d+ s", output)
    assert "medians; reading runs in parallel" in output


def test_tracks_have_the_columns_of_the_contract(folder):
    first = (folder / "tracks.csv").read_text().splitlines()[0]
    place, box = "x_m,y_m,vx_mps,vy_mps,height_m", "left_px,top_px,width_px,height_px"
    assert first == f"frame,timestamp_s,id,{place},state,{box},facing_deg,facing_confidence,confidence,std_m"


def test_nothing_half_written_is_left(folder):
    assert [file.name for file in folder.iterdir() if file.suffix == ".part"] == []


def test_report_needs_no_other_file(folder):
    page = (folder / "report.html").read_text()
    assert page.rstrip().endswith("</html>")
    assert 'src="http' not in page
    assert 'href="http' not in page


def test_the_walker_is_tracked_once_where_he_is(folder):
    tracks = read_tracks(folder / "tracks.csv")
    sure = tracks.where(tracks.state == "confirmed")
    assert set(sure.track_id) == {1}
    assert len(sure) > FRAMES - EMPTY - 12
    truth = np.array([(walking(int(f) - EMPTY)[0].x_m, walking(int(f) - EMPTY)[0].y_m) for f in sure.frame])
    assert np.median(np.hypot(sure.x_m - truth[:, 0], sure.y_m - truth[:, 1])) < 0.15
    assert np.median(sure.height_m) == pytest.approx(1.75, abs=0.06)


def test_run_json_says_what_was_done(folder, recording):
    info = json.loads((folder / "run.json").read_text())
    assert info["input"] == str(recording)
    assert info["finished"] is True
    assert (info["frames_read"], info["frames_skipped"], info["people"]) == (FRAMES, 0, 1)
    assert info["config"]["analysis"]["setup_frames"] == 4
    assert {"planview", "python", "numpy"} <= info["versions"].keys()
    assert info["floor"]["height_m"] == pytest.approx(2.5, abs=0.03)
    assert info["floor"]["tilt_deg"] == pytest.approx(50.0, abs=0.5)
    assert info["rig"]["baseline_m"] == pytest.approx(0.12, abs=1e-6)
    assert list(info["stages_ms"]) == ["read", "rectify", "match", "foreground", "maps", "track"]


def test_events_name_the_crossing(folder):
    with (folder / "events.csv").open() as file:
        events = list(csv.DictReader(file))
    assert list(events[0]) == ["frame", "timestamp_s", "rule", "kind", "id", "direction"]
    assert [(event["rule"], event["id"]) for event in events] == [("gate", "1")]


def test_decisions_have_reasons_from_birth_on(folder):
    with (folder / "decisions.csv").open() as file:
        decisions = list(csv.DictReader(file))
    assert decisions[0]["kind"] == "spawned"
    assert all(decision["reason"] for decision in decisions)
    assert "confirmed" in {decision["kind"] for decision in decisions}


def test_the_rerun_recording_passes_its_own_verification(folder):
    assert is_whole(folder / "run.rrd")


def test_same_input_gives_the_same_tracks(engine, folder, tmp_path):
    run(engine, RunSpec(tmp_path))
    assert (tmp_path / "tracks.csv").read_bytes() == (folder / "tracks.csv").read_bytes()


def test_overwriting_leaves_foreign_files_alone(succeed, copy, tmp_path):
    out = tmp_path / "out"
    run_few(succeed, copy, out, "--frames", "2")
    (out / "notes.txt").write_text("mine")
    run_few(succeed, copy, out, "--frames", "3", "--overwrite")
    assert (out / "notes.txt").read_text() == "mine"
    assert read_run_info(out / "run.json").frames_read == 3


def test_colour_is_tracked_like_grey(pairs, engine, tmp_path):
    tint = np.array([0.8, 1.0, 0.9])
    coloured = [tuple((image[..., None] * tint).astype(np.uint8) for image in pair) for pair in pairs[:26]]
    recording = write_toy_recording(tmp_path / "colour", toy_rig(), coloured)
    write_world(engine, recording)
    results = list(open_engine(recording, config=load_config(None, [FEW])))
    assert results[0].depth.picture().ndim == 3
    assert [track.state for track in results[-1].tracks] == ["confirmed"]


def test_a_folder_may_be_named_like_markup_whatever_the_tracker(succeed, copy, tmp_path):
    run_few(succeed, copy, tmp_path / "[/out]", "--tracker", "template")
    info = read_run_info(tmp_path / "[/out]" / "run.json")
    assert (info.tracker, info.finished, info.frames_read) == ("template", True, FRAMES)
