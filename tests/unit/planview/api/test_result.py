"""The one type of result: words, plain values, a table, and files."""

import json
from pathlib import Path

from planview.api.result import Result, aligned

RUNS = Result([1, 2], "two runs", {"runs": 2}, [{"name": "a", "score": 1.0}, {"name": "b", "score": 2.0}])


def test_result_prints_its_words() -> None:
    assert str(RUNS) == repr(RUNS) == "two runs"


def test_result_shows_control_characters() -> None:
    assert "\x1b" not in str(Result(None, "\x1b[31mred"))


def test_result_of_several_is_a_table_of_them() -> None:
    assert RUNS.to_dataframe()["score"].tolist() == [1.0, 2.0]


def test_result_of_one_is_a_row_of_its_values() -> None:
    assert Result(None, values={"height_m": 2.5}).to_dataframe()["height_m"].tolist() == [2.5]


def test_result_is_saved_as_json(tmp_path: Path) -> None:
    RUNS.save(tmp_path / "runs.json")
    assert json.loads((tmp_path / "runs.json").read_text()) == {"runs": 2}


def test_result_is_saved_as_a_table(tmp_path: Path) -> None:
    RUNS.save(tmp_path / "runs.csv")
    assert (tmp_path / "runs.csv").read_text() == "name,score\na,1.0\nb,2.0\n"


def test_cells_stand_below_each_other_and_the_last_is_wrapped(monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "31")
    lines = aligned([("ok", "floor", "a long clause about the floor"), ("NO", "rows", "short")]).splitlines()
    assert lines == ["ok  floor  a long clause about", "           the floor", "NO  rows   short"]
