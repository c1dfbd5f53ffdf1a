"""CSV files read by column."""

from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from planview.trajectories import table
from planview.trajectories.table import csv_blocks


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode())
    return path


def column(path: Path, name: str) -> list[float]:
    return [value for block in csv_blocks(path, (), "test") for value in block.numbers(name, np.nan).tolist()]


def test_numbers_with_exponents_blanks_and_many_digits_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, "a,b\n1e3,2\n 1.5 ,2\n0.12345678901234567,2\n,2\n")
    np.testing.assert_array_equal(column(path, "a"), [1000.0, 1.5, 0.12345678901234567, np.nan])


def test_quoted_cells_carriage_returns_and_a_byte_order_mark_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, '\ufeffa,note,b\r\n1,"x, y\nz",2\r\n"3",,4\r\n')
    assert column(path, "a") == [1.0, 3.0]
    assert column(path, "b") == [2.0, 4.0]


def test_blocks_continue_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "BLOCK_ROWS", 7)
    path = written(tmp_path, "a,b\n" + "".join(f"{i},{i / 8}\n" for i in range(50)))
    assert column(path, "b") == [i / 8 for i in range(50)]


def test_a_bad_number_is_named_with_its_line(tmp_path: Path) -> None:
    path = written(tmp_path, "a,b\n1,2\n\n3,many\n")
    with pytest.raises(InputError, match="a number in 'b', line 4, found 'many'"):
        column(path, "b")


def test_a_short_row_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected 3 cells in line 3, found fewer"):
        column(written(tmp_path, "a,b,c\n1,2,3\n4,5\n"), "c")
