"""The page that compares runs."""

import json
import shutil
from pathlib import Path

from planview.evaluation.significant import SignificantError
from planview.sweep.page import shared_errors, write_comparison


def lost(frame: int, person: int = 1) -> SignificantError:
    return SignificantError("lost", frame, person, 4, 1.5, "alone")


def test_error_that_two_runs_make_at_about_one_time_is_one_row() -> None:
    rows = shared_errors([[lost(10), lost(90)], [lost(14), lost(10, person=2)]], 0.1)
    assert [(row.frame, row.person, [bool(note) for note in row.notes]) for row in rows] == [
        (10, "P1", [True, True]), (10, "P2", [False, True]), (90, "P1", [True, False]),
    ]  # fmt: skip


def test_comparison_names_runs_by_the_settings_that_differ(street: Path, tmp_path: Path) -> None:
    other = tmp_path / "<other>"
    shutil.copytree(street, other)
    info = json.loads((street / "run.json").read_text())
    info["config"]["joint"]["stay_s"] = 0.7
    (street / "run.json").write_text(json.dumps(info))
    write_comparison([street, other], tmp_path / "compare.html")
    page = (tmp_path / "compare.html").read_text()
    assert "joint.stay_s=0.7" in page and "joint.errors_s" not in page
    assert "&lt;other&gt;" in page and "<other>" not in page
    assert page.count("<h2>Floor: ") == 2 and "position error" in page
