"""Edits and refinement in the folder of a run."""

import csv
from pathlib import Path

import numpy as np
import pytest
from toy_tracks import positions_table

from calib.errors import InputError
from planview.api.tracks import edit
from planview.output.finished import read_steps
from planview.output.folder import RunInfo, read_run_info, write_run_info
from planview.trajectories.table import read_tracks, write_table


@pytest.fixture
def run(tmp_path, monkeypatch) -> Path:
    """A finished run of two people; its page, which has tests of its own, is not made."""
    monkeypatch.setattr("planview.output.finished.write_report", lambda folder: folder)
    frame = np.repeat(np.arange(20), 2)
    ids = np.tile([1, 2], 20)
    table = positions_table(frame, ids, np.column_stack([ids, frame / 10]), timestamp_s=frame / 10)
    with (tmp_path / "tracks.csv").open("w") as file:
        write_table(file, table)
    write_run_info(RunInfo(finished=True, state="finished"), tmp_path / "run.json")
    return tmp_path


def test_edits_can_be_undone(run, cli, json_of):
    before = (run / "tracks.csv").read_bytes()
    done = {"rows_before": 40, "rows": 20, "people_before": 2, "people": 2, "left_to_undo": 1}
    assert json_of("edit", run, "--split", "1@10", "--delete", "2") == done
    cli("edit", run, "--rename", "3:7")
    assert set(read_tracks(run / "tracks.csv").track_id.tolist()) == {1, 7}
    assert [step.edits for step in read_steps(run)] == [["split 1 10", "delete 2"], ["rename 3 7"]]
    assert (run / "tracks_before.csv").read_bytes() == before
    cli("edit", run, "--undo")
    assert set(read_tracks(run / "tracks.csv").track_id.tolist()) == {1, 3}
    cli("edit", run, "--undo-all")
    assert (run / "tracks.csv").read_bytes() == before
    assert not (run / "edits.json").exists()


def test_text_is_one_edit(run):
    with pytest.raises(InputError, match="no track has the id 12"):
        edit(run, delete="12")


def test_an_edit_that_is_refused_changes_nothing(run, cli):
    before = (run / "tracks.csv").read_bytes()
    status, output = cli("edit", run, "--delete", "2", "--join", "1:9")
    assert (status, output) == (2, "planview: 'join 1 9': no track has the id 9\n")
    assert (run / "tracks.csv").read_bytes() == before
    assert not (run / "edits.json").exists()


def test_an_edit_written_in_another_form_is_refused_with_its_form(run, cli):
    assert cli("edit", run, "--join", "1-2")[1].startswith("planview: 'join 1-2': expected join A B")


@pytest.mark.parametrize("name", ["decisions.csv", "events.csv", "counts.json"])
def test_what_the_page_cannot_be_made_of_is_refused_before_anything_changes(run, name, cli):
    (run / name).write_text("damaged\n")
    before = {file.name: file.read_bytes() for file in run.iterdir()}
    for command, *words in (["refine"], ["edit", "--delete", "2"], ["edit", "--undo-all"]):
        status, output = cli(command, run, *words)
        assert status == 2
        assert name in output
        assert {file.name: file.read_bytes() for file in run.iterdir()} == before


def test_edits_of_a_list_are_applied_in_its_order(run, cli):
    (run / "mine.txt").write_text("rename 1 5  # the guide\n\nregion POLYGON ((0 0, 9 0, 9 0.95, 0 0.95, 0 0))\n")
    cli("edit", run, "--list", run / "mine.txt")
    tracks = read_tracks(run / "tracks.csv")
    assert (set(tracks.track_id.tolist()), int(tracks.frame.max())) == ({2, 5}, 9)


def test_edited_tracks_are_not_refined(run, cli):
    cli("edit", run, "--delete", "2")
    assert "its tracks were edited" in cli("refine", run)[1]


def test_unfinished_run_is_not_edited(run, cli):
    write_run_info(RunInfo(state="interrupted"), run / "run.json")
    assert "no finished run in it" in cli("edit", run, "--delete", "1")[1]


def test_regions_limit_what_is_exported_or_counted(run, cli, json_of):
    half = "POLYGON ((0 0, 1.5 0, 1.5 9, 0 9, 0 0))"
    cli("export", run, "--to", "csv", "--ignore", half, "--out", run / "other.csv")
    assert set(read_tracks(run / "other.csv").track_id.tolist()) == {2}
    (run / "rules.toml").write_text('[[tripwire]]\nname = "w"\nfrom_m = [0, 1.02]\nto_m = [9, 1.02]\n')
    assert json_of("count", run, "--rules", run / "rules.toml", "--region", half)["rules"]["w"]["people"] == 1


@pytest.fixture
def folder(tmp_path) -> Path:
    rows = [f"{t},{t / 10:.4f},1,{0.1 * t:.4f},0,,,1.7,{'tentative' if t < 4 else 'confirmed'},,,," for t in range(30)]
    header = "frame,timestamp_s,id,x_m,y_m,vx_mps,vy_mps,height_m,state,left_px,top_px,width_px,height_px"
    (tmp_path / "tracks.csv").write_text("\n".join([header, *rows]) + "\n")
    write_run_info(RunInfo(finished=True, frames_read=30), tmp_path / "run.json")
    return tmp_path


def test_refine_starts_from_the_online_tracks_again(folder, cli):
    online = (folder / "tracks.csv").read_text()
    assert cli("refine", folder)[0] == 0
    assert (folder / "tracks_online.csv").read_text() == online
    assert (folder / "tracks.csv").read_text().count("tentative") == 4
    assert read_run_info(folder / "run.json").refined
    with (folder / "refinement.csv").open() as file:
        changes = list(csv.DictReader(file))
    fields = ("id", "first_frame", "last_frame", "kind")
    assert [tuple(row[name] for name in fields) for row in changes] == [("1", "0", "29", "smooth")]
    cli("refine", folder)
    once = (folder / "tracks.csv").read_text(), (folder / "tracks_online.csv").read_text()
    cli("refine", folder)
    assert ((folder / "tracks.csv").read_text(), (folder / "tracks_online.csv").read_text()) == once


def test_undo_all_gives_the_table_of_the_tracker(folder, cli, json_of, refused):
    own = (folder / "tracks.csv").read_bytes()
    assert "nothing to undo" in refused("edit", folder, "--undo")
    assert json_of("refine", folder)["changes"] == {"join": 0, "smooth": 1}
    refined = (folder / "tracks.csv").read_bytes()
    cli("edit", folder, "--delete", "1")
    assert json_of("edit", folder, "--undo")["left_to_undo"] == 1
    assert (folder / "tracks.csv").read_bytes() == refined != own
    cli("edit", folder, "--delete", "1")
    assert json_of("edit", folder, "--undo-all")["left_to_undo"] == 0
    assert (folder / "tracks.csv").read_bytes() == own
    assert not read_run_info(folder / "run.json").refined
    assert not (folder / "tracks_online.csv").exists()
    assert not (folder / "refinement.csv").exists()


def recording_with_truth(folder: Path) -> Path:
    """The recording of the run, and its truth."""
    write_run_info(RunInfo(finished=True, frames_read=30, input=str(folder / "recording")), folder / "run.json")
    (folder / "recording").mkdir()
    rows = "".join(f"{t},1,{0.1 * t:.2f},0,1.7\n" for t in range(30))
    (folder / "recording" / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + rows)
    return folder / "recording" / "truth.csv"


def test_refinement_says_whether_it_made_the_tracks_better_or_worse(folder, cli, json_of):
    truth = recording_with_truth(folder)
    assert "equal against the truth\nbefore: 1 person in the truth" in cli("refine", folder)[1]
    for name, refined in (("tracks.csv", True), ("tracks_online.csv", False)):
        assert json_of("evaluate", folder / name, truth)["refined"] == refined


def test_evaluate_takes_the_truth_of_the_runs_recording(folder, refused, json_of):
    refused("evaluate", folder)
    truth = recording_with_truth(folder)
    assert json_of("evaluate", folder)["truth_rows"] == 30
    truth.unlink()
    assert "has no truth.csv; add the truth file" in refused("evaluate", folder)


def test_refined_run_is_refined_again_from_its_online_tracks_alone(folder, cli, refused):
    cli("refine", folder)
    (folder / "tracks_online.csv").unlink()
    assert "expected the online tracks" in refused("refine", folder)


def test_refine_needs_a_finished_run(folder, refused):
    write_run_info(RunInfo(finished=False), folder / "run.json")
    assert "no finished run in it" in refused("refine", folder)
