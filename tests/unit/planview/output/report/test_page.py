"""report.html: self-contained, escaped, and made of whatever there is."""

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError, WorkError
from planview.cli import main
from planview.engine.config import Config
from planview.engine.info import CameraInfo, FloorInfo
from planview.output.folder import PaceInfo, RunInfo, SkippedFrame, read_run_info, write_run_info
from planview.output.report.page import changed_settings, write_report
from planview.output.report.plots import heat_map
from planview.output.tables import DECISION_COLUMNS

HEADER = "frame,timestamp_s,id,x_m,y_m,height_m,state\n"


def write_tracks(folder: Path, n: int = 30) -> None:
    rows = [
        f"{t},{t / 10:.4f},{i},{i},{1 - t / 10:.3f},1.7{i},{'lost' if t > 25 else 'confirmed'}"
        for t in range(n)
        for i in (1, 2)
    ]
    (folder / "tracks.csv").write_text(HEADER + "".join(row + "\n" for row in rows))


def full_info() -> RunInfo:
    return RunInfo(
        input="recordings/<script>alert(1)</script>",
        tracker="template",
        finished=True,
        started_at="2026-01-02T03:04:05+00:00",
        elapsed_s=2.0,
        versions={"planview": "0.1.0"},
        config={"seed": 0, "grid": {"cell_m": 0.03}},
        frames_read=40,
        frames_skipped=1,
        skipped=[SkippedFrame(index=7, why="cannot be decoded")],
        rig=CameraInfo(width=640, height=480, view_m=[(-2, 0), (2, 0), (3, 5), (-3, 5)]),
        floor=FloorInfo(height_m=2.5, tilt_deg=60, roll_deg=1),
        stages_ms={"match": 12.5, "track": None},
    )


def pictures(page: str) -> list[bytes]:
    return [base64.b64decode(data) for data in re.findall(r'src="data:image/png;base64,([^"]+)"', page)]


def test_report_of_tracks_alone_shows_the_floor_the_heat_and_the_people(tmp_path: Path) -> None:
    write_tracks(tmp_path)
    page = write_report(tmp_path).read_text()
    assert len(pictures(page)) == 3
    assert all(picture.startswith(b"\x89PNG") for picture in pictures(page))
    assert "No run.json in this folder" in page


def test_report_of_a_full_run_tells_everything(tmp_path: Path) -> None:
    write_tracks(tmp_path)
    write_run_info(full_info(), tmp_path / "run.json")
    (tmp_path / "rules.toml").write_text(
        '[[tripwire]]\nname = "<b>door"\nfrom_m = [0, 0]\nto_m = [5, 0]\n'
        '[[zone]]\nname = "room"\npolygon_m = [[0, 0], [5, 0], [5, -5]]\n[[queue]]\nname = "q"\nzone = "room"\n'
    )
    with pytest.raises(SystemExit, match="0"):
        main(["count", str(tmp_path), "--rules", str(tmp_path / "rules.toml")])
    error = {"kind": "lost", "frame": 12, "truth_id": 3, "track_id": None, "duration_s": 2.0, "note": "alone for <2 s"}
    evaluation = {"mota": 0.9, "motp_m": None, "significant_errors": {"total": 1}, "significant_error_list": [error]}
    page = write_report(tmp_path, evaluation).read_text()
    assert len(pictures(page)) == 6
    for text in (
        "cannot be decoded",
        "camera height",
        "2.50 m",
        "grid.cell_m",
        "expected the recording of the run, found nothing there",
        "alone for &lt;2 s",
        "left to right 2",
        "0.9",
    ):
        assert text in page
    assert "<b>door" not in page
    assert "<script" not in page


def test_report_asks_for_nothing_from_outside(tmp_path: Path) -> None:
    write_tracks(tmp_path)
    write_run_info(full_info(), tmp_path / "run.json")
    page = write_report(tmp_path).read_text()
    assert "http://" not in page
    assert "https://" not in page
    assert set(re.findall(r'(?:src|href)="([^:"]*)', page)) == {"data", "#person-1", "#person-2"}


def test_interrupted_run_says_so(tmp_path: Path) -> None:
    write_tracks(tmp_path)
    write_run_info(full_info().model_copy(update={"finished": False}), tmp_path / "run.json")
    assert "interrupted" in write_report(tmp_path).read_text()


@pytest.mark.parametrize("rows", ["", "0,0,1,,,,confirmed\n", "5,0.5,1,1,1,,tentative\n", "0,0,1,1,1,1.7,confirmed\n"])
def test_report_survives_few_and_unknown_values(tmp_path: Path, rows: str) -> None:
    (tmp_path / "tracks.csv").write_text(HEADER + rows)
    assert "</html>" in write_report(tmp_path).read_text()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("counts.json", "[]"), ("counts.json", "{"), ("run.json", '{"frames_read": "many"}'), ("events.csv", "a,b\n"),
        ("evaluation.json", "nothing"), ("decisions.csv", "frame\n1\n"),
        ("evaluation.json", '{"significant_error_list": [1]}'),
    ],
)  # fmt: skip
def test_files_that_are_not_what_they_say_are_named(tmp_path: Path, name: str, text: str) -> None:
    write_tracks(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=name):
        write_report(tmp_path)


def test_folder_without_tracks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"tracks\.csv"):
        write_report(tmp_path)


def test_page_that_cannot_be_written_is_work_failed(tmp_path: Path) -> None:
    write_tracks(tmp_path)
    (tmp_path / "report.html").mkdir()
    with pytest.raises(WorkError, match="cannot be written"):
        write_report(tmp_path)
    assert not (tmp_path / "report.html.part").exists()


def test_only_settings_that_differ_from_the_defaults_are_listed() -> None:
    config = Config().model_dump(mode="json")
    assert changed_settings(config) == []
    config["template"]["stay_s"] = 0.7
    assert [row[:2] for row in changed_settings(config)] == [("template.stay_s", "0.7")]


def test_decisions_of_a_person_say_why_and_how_well_they_matched(tmp_path: Path) -> None:
    write_tracks(tmp_path)
    matched = [f"{t},{t / 10:.4f},1,matched,score {t / 100},{t / 100},{t / 200},{t / 200},0,0" for t in range(31)]
    rows = ["0,0.0000,1,spawned,1.7 m tall,,,,,", *matched, "31,3.1,1,lost,<nothing like it>,0.9,,,,"]
    (tmp_path / "decisions.csv").write_text(",".join(DECISION_COLUMNS) + "\n" + "\n".join(rows) + "\n")
    page = write_report(tmp_path).read_text()
    assert "matched in 31 frames, 0 to 30; median score 0.15, worst 0.30 in frame 30" in page
    assert "&lt;nothing like it&gt;" in page


def test_heat_map_adds_time_in_the_cell_of_each_row() -> None:
    xy = np.array([[0.0, 0.0], [0.01, 0.01], [1.0, 0.5]])
    heat = heat_map(xy, 0.1)
    assert heat.seconds.sum() == pytest.approx(0.3)
    col, row = np.floor((xy[0] - heat.corner_m) / heat.cell_m).astype(int)
    assert heat.seconds[row, col] == pytest.approx(0.2)


def test_heat_map_of_far_apart_places_stays_small() -> None:
    assert heat_map(np.array([[0.0, 0.0], [1e6, 1e6]]), 0.1).seconds.size < 4_000_000


def test_run_info_survives_writing_and_reading(tmp_path: Path) -> None:
    write_run_info(full_info(), tmp_path / "run.json")
    assert read_run_info(tmp_path / "run.json") == full_info()
    assert json.loads((tmp_path / "run.json").read_text())["frames_read"] == 40
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_latency_of_a_run_in_real_time_is_on_the_page(tmp_path: Path) -> None:
    write_tracks(tmp_path)
    pace = PaceInfo(frames_dropped=3, latency_median_ms=35.2, latency_95_ms=50.0, latency_99_ms=61.6)
    write_run_info(full_info().model_copy(update={"pace": pace}), tmp_path / "run.json")
    page = write_report(tmp_path).read_text()
    assert "<b>3</b>frames dropped" in page
    assert "<b>62 ms</b>latency, 99 % within" in page
