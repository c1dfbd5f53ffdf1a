"""Several runs in one page."""

import json
import shutil
from pathlib import Path

import pytest

from planview.cli import main
from planview.evaluation.significant import SignificantError
from planview.output.report.compare import shared_errors


def lost(frame: int, person: int = 1) -> SignificantError:
    return SignificantError("lost", frame, person, 4, 1.5, "alone")


def test_error_that_two_runs_make_at_about_one_time_is_one_row() -> None:
    rows = shared_errors([[lost(10), lost(90)], [lost(14), lost(10, person=2)]], 0.1)
    assert [(row.frame, row.person, [bool(note) for note in row.notes]) for row in rows] == [
        (10, "P1", [True, True]), (10, "P2", [False, True]), (90, "P1", [True, False]),
    ]  # fmt: skip


def test_comparison_shows_only_settings_that_differ_and_marks_the_best_figure(street: Path, tmp_path: Path) -> None:
    other = tmp_path / "<other>"
    shutil.copytree(street, other)
    info = json.loads((street / "run.json").read_text())
    info["config"]["template"]["stay_s"] = 0.7
    info["stages_ms"] = {"match": 5.0}
    (street / "run.json").write_text(json.dumps(info))
    with pytest.raises(SystemExit, match="0"):
        main(["report", str(street), str(other), "--out", str(tmp_path / "compare.html")])
    page = (tmp_path / "compare.html").read_text()
    assert "template.stay_s" in page
    assert "template.errors_s" not in page
    assert "&lt;other&gt;" in page and "<other>" not in page
    assert '<td class="n">5</td><td class="n">-</td>' in page


def test_report_of_one_run_is_written_into_its_folder(street: Path) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["report", str(street)])
    assert "Busiest frame" in (street / "report.html").read_text()


def test_report_of_nothing_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["report"])
    assert "the folder of a run" in capsys.readouterr().err
