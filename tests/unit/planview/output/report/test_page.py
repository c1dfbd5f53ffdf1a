"""The report: pages, timelines, snapshots."""

import base64
import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from toy_tracks import positions_table

import planview
from calib.errors import InputError, WorkError
from calib.types import U8
from planview.engine.config import Config
from planview.engine.info import CameraInfo, FloorInfo
from planview.evaluation.significant import SignificantError
from planview.output.folder import RunInfo, SkippedFrame, read_run_info, write_run_info
from planview.output.render import open_frames
from planview.output.report.page import changed_settings, differing_settings, scores_of, write_report
from planview.output.report.plots import UNHELD, held_by, identity_pictures
from planview.output.report.snapshots import busiest_frame, scene_pictures
from planview.output.run_folder import RunFolder
from planview.output.tables import DECISION_COLUMNS
from planview.trajectories.clock import Clock
from planview.trajectories.table import Trajectories

HEADER = "frame,timestamp_s,id,x_m,y_m,height_m,state\n"


def write_tracks(folder: Path, n: int = 30) -> None:
    state = ["lost" if t > 25 else "confirmed" for t in range(n)]
    rows = [f"{t},{t / 10:.4f},{i},{i},{1 - t / 10:.3f},1.7{i},{state[t]}\n" for t in range(n) for i in (1, 2)]
    (folder / "tracks.csv").write_text(HEADER + "".join(rows))


def full_info() -> RunInfo:
    return RunInfo(
        input="recordings/<script>alert(1)</script>", tracker="joint", finished=True, elapsed_s=2.0,
        started_at="2026-01-02T03:04:05+00:00", versions={"planview": "0.1.0"},
        config={"seed": 0, "grid": {"cell_m": 0.03}}, frames_read=40, frames_skipped=1,
        skipped=[SkippedFrame(index=7, why="cannot be decoded")], stages_ms={"match": 12.5, "track": None},
        rig=CameraInfo(width=640, height=480, view_m=[(-2, 0), (2, 0), (3, 5), (-3, 5)]),
        floor=FloorInfo(height_m=2.5, tilt_deg=60, roll_deg=1),
    )  # fmt: skip


def pictures(page: str) -> list[bytes]:
    return [base64.b64decode(data) for data in re.findall(r'src="data:image/png;base64,([^"]+)"', page)]


def test_report_of_tracks_alone_shows_paths_density_curves_with_identities(tmp_path):
    write_tracks(tmp_path)
    page = write_report(tmp_path).read_text()
    assert len(pictures(page)) == 4
    assert all(picture.startswith(b"\x89PNG") for picture in pictures(page))
    assert "No run.json in this folder" in page


def test_report_of_boxes_alone_shows_paths_in_the_image_without_a_density(tmp_path):
    rows = [f"{t},{t / 10:.4f},1,,,,confirmed,{10 + t},20,30,60\n" for t in range(30)]
    header = HEADER.rstrip() + ",left_px,top_px,width_px,height_px\n"
    (tmp_path / "tracks.csv").write_text(header + "".join(rows))
    page = write_report(tmp_path).read_text()
    assert "<h2>Paths</h2>" in page
    assert "<h2>Density</h2>" not in page


def test_report_of_a_full_run_shows_everything(tmp_path, monkeypatch, shown_by):
    write_tracks(tmp_path)
    write_run_info(full_info(), tmp_path / "run.json")
    (tmp_path / "rules.toml").write_text(
        '[[tripwire]]\nname = "<b>door"\nfrom_m = [0, 0]\nto_m = [5, 0]\n'
        '[[zone]]\nname = "room"\npolygon_m = [[0, 0], [5, 0], [5, -5]]\n[[queue]]\nname = "q"\nzone = "room"\n'
    )
    shown_by("count", tmp_path, "--rules", tmp_path / "rules.toml")
    error = SignificantError("lost", 12, 3, None, 2.0, "alone for <2 s")
    scores = {"mota": 0.9, "motp_m": None, "significant_errors": {"total": 1}}
    evaluation = SimpleNamespace(significant=(error,), to_json=lambda: scores)
    monkeypatch.setattr("planview.output.report.page.scores_of", lambda run: evaluation)
    page = write_report(tmp_path).read_text()
    assert len(pictures(page)) == 6
    gone, note = "expected the recording of the run, found nothing there", "alone for &lt;2 s"
    for text in ("cannot be decoded", "camera height", "2.50 m", "grid.cell_m", gone, note, "left to right 2", "0.9"):
        assert text in page
    assert "<b>door" not in page
    assert "<script" not in page


def test_report_asks_for_nothing_from_outside(tmp_path):
    write_tracks(tmp_path)
    write_run_info(full_info(), tmp_path / "run.json")
    page = write_report(tmp_path).read_text()
    assert "http://" not in page
    assert "https://" not in page
    assert "interrupted" not in page
    assert set(re.findall(r'(?:src|href)="([^:"]*)', page)) == {"data"}


def test_report_shows_when_a_run_was_interrupted(tmp_path):
    write_tracks(tmp_path)
    write_run_info(full_info().model_copy(update={"finished": False}), tmp_path / "run.json")
    assert "interrupted" in write_report(tmp_path).read_text()


@pytest.mark.parametrize("rows", ["", "0,0,1,,,,confirmed\n", "5,0.5,1,1,1,,tentative\n", "0,0,1,1,1,1.7,confirmed\n"])
def test_report_survives_values_that_are_unknown(tmp_path, rows):
    (tmp_path / "tracks.csv").write_text(HEADER + rows)
    assert "</html>" in write_report(tmp_path).read_text()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("counts.json", "[]"), ("counts.json", "{"), ("run.json", '{"frames_read": "many"}'), ("events.csv", "a,b\n"),
        ("decisions.csv", "frame\n1\n"),
    ],
)  # fmt: skip
def test_files_that_are_not_what_they_say_are_named(tmp_path, name, text):
    write_tracks(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=name):
        write_report(tmp_path)


def test_folder_without_tracks_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"tracks\.csv"):
        write_report(tmp_path)


def test_page_that_cannot_be_written_is_work_failed(tmp_path):
    write_tracks(tmp_path)
    (tmp_path / "report.html").mkdir()
    with pytest.raises(WorkError, match="cannot be written"):
        write_report(tmp_path)
    assert not (tmp_path / "report.html.part").exists()


def test_only_settings_that_differ_from_the_defaults_are_listed():
    config = Config().model_dump(mode="json")
    assert changed_settings(config) == []
    config["joint"]["stay_s"] = 0.7
    assert [row[:2] for row in changed_settings(config)] == [("joint.stay_s", "0.7")]


def test_decisions_on_a_person_are_listed(tmp_path):
    write_tracks(tmp_path)
    matched = [f"{t},{t / 10:.4f},1,matched,score {t / 100},{t / 100},{t / 200},{t / 200},0,0" for t in range(31)]
    rows = ["0,0.0000,1,spawned,1.7 m tall,,,,,", *matched, "31,3.1,1,lost,<nothing like it>,0.9,,,,"]
    (tmp_path / "decisions.csv").write_text(",".join(DECISION_COLUMNS) + "\n" + "\n".join(rows) + "\n")
    page = write_report(tmp_path).read_text()
    assert "&lt;nothing like it&gt;" in page


def test_run_info_survives_a_round_trip(tmp_path):
    write_run_info(full_info(), tmp_path / "run.json")
    assert read_run_info(tmp_path / "run.json") == full_info()
    assert json.loads((tmp_path / "run.json").read_text())["frames_read"] == 40
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def table(rows: list[tuple[int, int, float]]) -> Trajectories:
    """Rows of (frame, id, x), 10 frames per second, y = 0."""
    frame, track_id, x = (np.array(column) for column in zip(*rows, strict=True))
    xy = np.column_stack([x, np.zeros(len(x))]).astype(np.float64)
    return positions_table(frame, track_id, xy, timestamp_s=frame / 10)


def test_truth_is_held_by_the_confirmed_track_within_the_gate():
    truth = table([(0, 7, 0.0), (0, 8, 5.0), (1, 7, 0.0)])
    tracks = table([(0, 3, 0.1), (1, 3, 2.0)])
    assert held_by(tracks, truth).tolist() == [3, UNHELD, UNHELD]


def test_errors_are_pictured_in_the_rows_of_their_people():
    tracks = table([(frame, 3, 0.0) for frame in range(5)])
    truth = table([(frame, 7, 0.0) for frame in range(10)])
    error = SignificantError("lost", 5, 7, 3, 0.5, "visible")
    run = SimpleNamespace(tracks=tracks, truth=truth, clock=Clock(tracks, 10.0), people=[3])
    (tracked, true), (plain_tracked, plain_true) = identity_pictures(run, [error]), identity_pictures(run, [])
    assert tracked == plain_tracked
    assert true.data != plain_true.data


def decoded(uri: str) -> U8:
    data = base64.b64decode(uri.partition(",")[2])
    return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)


def test_pictures_are_of_the_busiest_frame(street):
    assert busiest_frame(RunFolder(street)) == 5, "the middle of who is there for a second; a flicker is nobody"
    images = {frame: int(np.median(image)) for frame, image in open_frames(RunFolder(street)).at([3, 7, 20])}
    assert images == {3: 103, 7: 107, 20: 120}


def test_scores_are_of_these_tracks(street):
    (street / "evaluation.json").write_text('{"mota": 0.123, "significant_errors": {"total": 77}}')
    page = write_report(street).read_text()
    assert "0.123" not in page
    assert ">77<" not in page


def test_scene_is_pictured_from_the_recording_opened_again(street):
    results = RunFolder(street)
    scores = scores_of(results)
    errors = scores.significant
    assert [(error.kind, error.frame) for error in errors] == [("lost", 10)]
    pictures = scene_pictures(results, errors)
    assert pictures.why_none == ""
    assert pictures.overview[0].title == "Busiest frame"
    assert decoded(pictures.overview[0].data).shape == (480, 640, 3)
    (strip,) = pictures.errors
    assert strip.is_strip
    assert decoded(strip.data).shape[1] > 4 * decoded(strip.data).shape[0]


def test_recording_that_is_gone_gives_a_sentence_instead_of_pictures(street):
    info = json.loads((street / "run.json").read_text())
    (street / "run.json").write_text(json.dumps({**info, "input": "gone"}))
    pictures = scene_pictures(RunFolder(street), [])
    assert pictures.overview == []
    assert "gone: expected the recording of the run, found nothing there" in pictures.why_none


def test_report_of_one_run_is_written_into_its_folder(street, shown_by):
    shown_by("report", street)
    assert "Busiest frame" in (street / "report.html").read_text()


def test_report_of_no_run_is_refused(refused):
    assert "the folder of a run" in refused("report")


def test_report_of_two_runs_prints_the_settings_that_differ(street, tmp_path, shown_by):
    other = tmp_path / "other"
    shutil.copytree(street, other)
    info = json.loads((street / "run.json").read_text())
    info["config"]["joint"]["stay_s"] = 0.7
    (street / "run.json").write_text(json.dumps(info))
    names = [line.split()[0] for line in shown_by("report", street, other).splitlines()]
    assert (street / "report.html").is_file()
    assert (other / "report.html").is_file()
    assert names[0] == "setting"
    assert names[1:] == ["joint.stay_s"]


def test_settings_that_differ_have_all_their_digits():
    one = full_info()
    other = one.model_copy(update={"config": {"seed": 0, "grid": {"cell_m": 0.030001}}, "tracker": "template"})
    rows = differing_settings([one, other])
    assert rows == [("tracker", ["joint", "template"]), ("grid.cell_m", ["0.03", "0.030001"])]


def test_every_output_counts_the_same_people(tmp_path):
    write_tracks(tmp_path)
    with (tmp_path / "tracks.csv").open("a") as file:
        file.write("29,2.9,3,3,1,1.7,confirmed\n")  # for too short to be somebody
    tracks = planview.read_tracks(tmp_path / "tracks.csv")
    exported = planview.export(tmp_path, "pedpy", out=tmp_path / "pedpy.txt")
    page = write_report(tmp_path).read_text()
    assert exported.values["people"] == 2
    assert "of 2 people" in repr(tracks)
    assert len(planview.plot(tracks).axes[0].get_legend().get_texts()) == 2
    assert page.count("<summary>") == 2
