"""Edits in the folder of a run."""

from pathlib import Path

import numpy as np
import pytest
from say import JsonOf, Say

from planview.output.finished import read_steps
from planview.output.folder import RunInfo, write_run_info
from planview.trajectories.table import positions_table, read_tracks, write_table


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished run of two people; its page, which has tests of its own, is not made."""
    monkeypatch.setattr("planview.output.finished.write_report", lambda folder: folder)
    frame = np.repeat(np.arange(20), 2)
    ids = np.tile([1, 2], 20)
    table = positions_table(frame, ids, np.column_stack([ids, frame / 10]), timestamp_s=frame / 10)
    with (tmp_path / "tracks.csv").open("w") as file:
        write_table(file, table)
    write_run_info(RunInfo(finished=True, state="finished"), tmp_path / "run.json")
    return tmp_path


def test_edits_are_applied_written_down_and_taken_back(run: Path, say: Say) -> None:
    before = (run / "tracks.csv").read_bytes()
    assert say("edit", run, "--split", "1@10", "--delete", "2") == (
        0, f"{run}/tracks.csv: 2 tracks became 2, 40 rows 20 (1 calls of edit to undo)\n"
    )  # fmt: skip
    say("edit", run, "--rename", "3:7")
    assert set(read_tracks(run / "tracks.csv").track_id.tolist()) == {1, 7}
    assert [step.edits for step in read_steps(run)] == [["split 1 10", "delete 2"], ["rename 3 7"]]
    assert (run / "tracks_before.csv").read_bytes() == before
    say("edit", run, "--undo")
    assert set(read_tracks(run / "tracks.csv").track_id.tolist()) == {1, 3}
    say("edit", run, "--undo-all")
    assert (run / "tracks.csv").read_bytes() == before and not (run / "edits.json").exists()
    assert not (run / "tracks_before.csv").exists()


def test_an_edit_that_is_refused_changes_nothing(run: Path, say: Say) -> None:
    before = (run / "tracks.csv").read_bytes()
    status, told = say("edit", run, "--delete", "2", "--join", "1:9")
    assert (status, told) == (2, "planview: 'join 1 9': expected the id of a track, found 9, which none has\n")
    assert (run / "tracks.csv").read_bytes() == before and not (run / "edits.json").exists()


def test_edits_of_a_list_are_applied_in_its_order(run: Path, say: Say) -> None:
    (run / "mine.txt").write_text("rename 1 5  # the guide\n\nregion POLYGON ((0 0, 9 0, 9 0.95, 0 0.95, 0 0))\n")
    say("edit", run, "--list", run / "mine.txt")
    tracks = read_tracks(run / "tracks.csv")
    assert (set(tracks.track_id.tolist()), int(tracks.frame.max())) == ({2, 5}, 9)


def test_nothing_to_undo_and_unfinished_runs_are_refused(run: Path, say: Say) -> None:
    assert say("edit", run, "--undo")[0] == 2
    write_run_info(RunInfo(state="interrupted"), run / "run.json")
    assert "expected the folder of a finished run" in say("edit", run, "--delete", "2")[1]


def test_refinement_does_not_write_over_edits(run: Path, say: Say) -> None:
    say("edit", run, "--delete", "2")
    assert "its tracks were edited" in say("edit", run, "--refine")[1]


def test_export_and_count_take_regions(run: Path, say: Say, json_of: JsonOf) -> None:
    half = "POLYGON ((0 0, 1.5 0, 1.5 9, 0 9, 0 0))"
    say("export", run, "--to", "csv", "--ignore", half, "--out", run / "other.csv")
    assert set(read_tracks(run / "other.csv").track_id.tolist()) == {2}
    (run / "rules.toml").write_text('[[tripwire]]\nname = "w"\nfrom_m = [0, 1.02]\nto_m = [9, 1.02]\n')
    assert json_of("count", run, "--rules", run / "rules.toml", "--region", half)["rules"]["w"]["people"] == 1
