"""``planview edit --refine`` in the folder of a run."""

import csv
from pathlib import Path

import pytest

from planview.cli import main
from planview.output.folder import RunInfo, read_run_info, write_run_info


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rows = [f"{t},{t / 10:.4f},1,{0.1 * t:.4f},0,,,1.7,{'tentative' if t < 4 else 'confirmed'},,,," for t in range(30)]
    header = "frame,timestamp_s,id,x_m,y_m,vx_mps,vy_mps,height_m,state,left_px,top_px,width_px,height_px"
    (tmp_path / "tracks.csv").write_text("\n".join([header, *rows]) + "\n")
    write_run_info(RunInfo(finished=True, frames_read=30), tmp_path / "run.json")
    return tmp_path


def test_refine_keeps_the_online_tracks_says_so_and_starts_from_them_again(folder, say):
    online = (folder / "tracks.csv").read_text()
    assert say("edit", folder, "--refine")[0] == 0 and (folder / "tracks_online.csv").read_text() == online
    assert (folder / "tracks.csv").read_text().count("tentative") == 4
    assert read_run_info(folder / "run.json").refined
    with (folder / "refinement.csv").open() as file:
        changes = list(csv.DictReader(file))
    fields = ("id", "first_frame", "last_frame", "kind")
    assert [tuple(row[name] for name in fields) for row in changes] == [("1", "0", "29", "smooth")]
    say("edit", folder, "--refine")
    once = (folder / "tracks.csv").read_text(), (folder / "tracks_online.csv").read_text()
    say("edit", folder, "--refine")
    assert ((folder / "tracks.csv").read_text(), (folder / "tracks_online.csv").read_text()) == once


def test_evaluate_tells_refined_from_online_tracks(folder, say, json_of):
    truth = folder / "truth.csv"
    truth.write_text("frame,id,x_m,y_m,height_m\n" + "".join(f"{t},1,{0.1 * t:.2f},0,1.7\n" for t in range(30)))
    say("edit", folder, "--refine")
    for name, refined in (("tracks.csv", True), ("tracks_online.csv", False)):
        assert json_of("evaluate", folder / name, truth)["refined"] == refined


def test_evaluate_takes_the_truth_of_the_runs_recording(folder, refused, json_of, capsys):
    recording = folder / "recording"
    recording.mkdir()
    refused("evaluate", folder)
    write_run_info(RunInfo(finished=True, frames_read=30, input=str(recording)), folder / "run.json")
    assert "expected the truth of the run's recording, found none" in refused("evaluate", folder)
    rows = "".join(f"{t},1,{0.1 * t:.2f},0,1.7\n" for t in range(30))
    (recording / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + rows)
    assert json_of("evaluate", folder)["truth_rows"] == 30
    with pytest.raises(SystemExit, match="0"):
        main(["evaluate", str(folder)])
    assert "strict_identity_changes those that last" in " ".join(capsys.readouterr().out.split())


def test_refine_needs_a_finished_run_and_the_online_tracks_of_a_refined_one(folder, say, refused):
    say("edit", folder, "--refine")
    (folder / "tracks_online.csv").unlink()
    assert "expected the online tracks" in refused("edit", folder, "--refine")
    write_run_info(RunInfo(finished=False), folder / "run.json")
    assert "expected the folder of a finished run" in refused("edit", folder, "--refine")
