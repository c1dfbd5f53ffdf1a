"""The one type of result: words, plain values, a table, and files."""

from planview.api.result import Result, aligned

RUNS = Result([1, 2], {"runs": 2}, [{"name": "a", "score": 1.0}, {"name": "b", "score": 2.0}])


def test_result_prints_its_values_with_their_units():
    assert repr(Result(None, {"height_m": 2.5, "lens": {"fov_deg": None}})) == "height [m]    2.5\nlens fov [°]  -"


def test_result_prints_what_is_several_of_a_kind_as_a_table():
    assert repr(Result(None, {"runs": RUNS.rows})) == "name  score\na     1\nb     2"


def test_result_shows_control_characters():
    assert "\x1b" not in str(Result(None, {"name": "\x1b[31mred"}))


def test_result_of_several_is_a_table_of_them():
    assert RUNS.to_dataframe()["score"].tolist() == [1.0, 2.0]


def test_the_last_cell_of_a_row_is_wrapped(monkeypatch):
    monkeypatch.setenv("COLUMNS", "31")
    lines = aligned([("ok", "floor", "a long clause about the floor"), ("NO", "rows", "short")]).splitlines()
    assert lines == ["ok  floor  a long clause about", "           the floor", "NO  rows   short"]
