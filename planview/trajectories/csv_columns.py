"""The text of a CSV file in blocks of rows, converted by column with errors that name file, line and column."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from itertools import islice, zip_longest
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.text import require_file
from calib.types import F64, I64

WordColumn = np.ndarray[tuple[int], np.dtype[np.str_]]
BLOCK_ROWS = 20_000
"""Rows of a file that are text in memory at a time: the text of 500,000 rows takes a gigabyte (our choice)."""


def csv_blocks(path: Path, required: tuple[str, ...], what: str) -> Iterator[CsvColumns]:
    """The rows of a file in blocks, at least one."""
    require_file(path, f"a {what} file")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            names = next(reader, [])
            missing = [name for name in required if name not in names]
            if missing:
                raise InputError(f"{path}: expected a {what} file with the column {missing[0]!r}, found {names}")
            rows, line = filter(None, reader), 2
            while (block := list(islice(rows, BLOCK_ROWS))) or line == 2:
                yield CsvColumns(path, names, block, line)
                line += max(1, len(block))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected a {what} file, found {error}") from error


class CsvColumns:
    """The text of rows of a CSV file by column, converted on request with errors that name file, line and column.

    Args:
        names: of the columns.
        rows: their cells, the first of them from line ``line``.
    """

    def __init__(self, path: Path, names: list[str], rows: list[list[str]], line: int) -> None:
        self._path, self._line = path, line
        self._width, self._n_rows = len(names), len(rows)
        nothing = (None,) * len(rows)
        columns = list(zip_longest(*rows))
        self._cells: dict[str, tuple[str | None, ...]] = {
            name: columns[i] if i < len(columns) else nothing for i, name in enumerate(names)
        }

    def numbers(self, name: str, default: float) -> F64:
        """(N,) values; ``default`` where the cell is empty or the column missing."""
        if name not in self._cells:
            return np.full(self._n_rows, default)
        number = self._number
        return np.array([number(text, name, i, default) for i, text in enumerate(self._cells[name])], dtype=np.float64)

    def _number(self, text: str | None, name: str, row: int, default: float) -> float:
        if text is None:
            raise InputError(f"{self._path}: expected {self._width} cells in line {row + self._line}, found fewer")
        try:
            return float(text)
        except ValueError:
            if not text.strip():
                return default
            raise InputError(
                f"{self._path}: expected a number in {name!r}, line {row + self._line}, found {text!r}"
            ) from None

    def integers(self, name: str) -> I64:
        """(N,) int64; an empty cell is refused."""
        values = self.numbers(name, np.nan)
        bad = np.flatnonzero(~np.isfinite(values) | (values != np.floor(np.nan_to_num(values))))
        if len(bad):
            i = int(bad[0])
            raise InputError(
                f"{self._path}: expected a whole number in {name!r}, line {i + self._line}, "
                f"found {self._cells[name][i]!r}"
            )
        return values.astype(np.int64)

    def words(self, name: str, known: Sequence[str], default: str) -> WordColumn:
        """(N,) of the known words; ``default`` where the cell is empty or the column missing."""
        words = [word or default for word in self._cells.get(name, (None,) * self._n_rows)]
        if not set(words) <= set(known):
            i, word = next((i, word) for i, word in enumerate(words) if word not in known)
            raise InputError(
                f"{self._path}: expected a {name} of {', '.join(known)} in line {i + self._line}, found {word!r}"
            )
        return np.array(words, dtype=np.str_)
