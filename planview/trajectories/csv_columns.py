"""CSV files of numbers by column: a block of rows is bytes, and a column of it is parsed as a whole."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import IO

import numpy as np

from calib.errors import InputError
from calib.io import reason, require_file
from calib.types import F64, I64, U8, Bool

WordColumn = np.ndarray[tuple[int], np.dtype[np.str_]]
BLOCK_BYTES = 4_000_000
"""Text in memory at a time: that of 500,000 rows takes a gigabyte in cells (our choice)."""
_QUOTED_ROWS = 10_000
_BYTE_ORDER_MARK = "\ufeff"
_DIGITS_MAX = 15
"""A whole number of so many digits and a power of ten up to it are exact in float64, and so their quotient is rounded
once, as ``float`` rounds (Clinger 1990)."""


def csv_blocks(path: Path, required: Sequence[str], what: str) -> Iterator[CsvColumns]:
    """The rows of a file in blocks, at least one.

    Args:
        required: columns that the header must name.
        what: the file should be, for messages.
    Raises:
        InputError: unreadable, not UTF-8, or a column missing.
    """
    require_file(path, f"a {what} file")
    try:
        with path.open("rb") as file:
            header = file.readline().decode().removeprefix(_BYTE_ORDER_MARK)
            names = next(csv.reader([header]), [])
            missing = [name for name in required if name not in names]
            if missing:
                raise InputError(f"{path}: expected a {what} file with the column {missing[0]!r}, found {names}")
            line, block = 2, b""
            for block in _blocks(file):
                yield CsvColumns(path, names, block, line)
                line += block.count(b"\n")
            if not block:
                yield CsvColumns(path, names, block, line)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected a {what} file, found {reason(error)}") from error


def _blocks(file: IO[bytes]) -> Iterator[bytes]:
    """Whole lines, without quotes, that end with a line feed."""
    while block := file.read(BLOCK_BYTES):
        block += file.readline()
        if b'"' in block or b"\r" in block.replace(b"\r\n", b""):
            file.seek(-len(block), io.SEEK_CUR)
            yield from _rewritten(file)
            return
        block.decode()
        yield block.replace(b"\r", b"") + (b"" if block.endswith(b"\n") else b"\n")


def _rewritten(file: IO[bytes]) -> Iterator[bytes]:
    """The rest of a file with quotes, without them; what they protect is no number and may change."""
    text = io.TextIOWrapper(file, "utf-8", newline="")
    try:
        rows = csv.reader(text)
        while block := list(islice(rows, _QUOTED_ROWS)):
            cells = [[" ".join(cell.replace(",", ";").splitlines()) for cell in row] for row in block]
            yield "".join(",".join(row) + "\n" for row in cells).encode()
    finally:
        text.detach()  # the file is the caller's to close


class CsvColumns:
    """Rows of a CSV file by column, converted on request with errors that name file, line and column.

    Args:
        names: of the columns.
        block: the rows, unquoted UTF-8, each ended by a line feed; empty ones are left out.
        line: number of the first row's line.
    """

    def __init__(self, path: Path, names: Sequence[str], block: bytes, line: int) -> None:
        self._path, self._block = path, block
        self._column = {name: i for i, name in enumerate(names)}
        self._bytes: U8 = np.frombuffer(block, dtype=np.uint8)
        ends = np.flatnonzero(self._bytes == ord("\n"))
        starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
        filled = np.flatnonzero(ends > starts)
        self._line = line + filled
        self._starts, self._ends = starts[filled], ends[filled]
        self._commas = np.flatnonzero(self._bytes == ord(","))
        self._first_comma = np.searchsorted(self._commas, self._starts)
        self._n_commas = np.searchsorted(self._commas, self._ends) - self._first_comma

    def numbers(self, name: str, default: float) -> F64:
        """(N,) values; ``default`` where the cell is empty, and throughout (read-only) where the column is missing."""
        if name not in self._column:
            return np.broadcast_to(np.float64(default), len(self._line))
        start, stop = self._cells(name)
        values, plain = decimals(self._bytes, start, stop)
        values[start == stop] = default
        for row in np.flatnonzero(~plain & (start < stop)).tolist():
            values[row] = self._number(name, row, default)
        return values

    def integers(self, name: str) -> I64:
        """(N,) int64; an empty cell is refused."""
        values = self.numbers(name, np.nan)
        with np.errstate(invalid="ignore"):
            bad = np.flatnonzero(~(np.abs(values) < 2.0**63) | (values != np.floor(values)))
        if len(bad):
            raise self._refused(f"a whole number in {name!r}", name, int(bad[0]))
        return values.astype(np.int64)

    def words(self, name: str, allowed: Sequence[str], default: str) -> WordColumn:
        """(N,) words of a closed list; ``default`` where the cell is empty or the column missing."""
        kind = f"<U{max(map(len, allowed))}"
        if name not in self._column:
            return np.broadcast_to(np.array(default, dtype=kind), len(self._line))
        start, stop = self._cells(name)
        which = np.select([self._equal(start, stop, word) for word in ("", *allowed)], range(len(allowed) + 1), -1)
        if (which < 0).any():
            raise self._refused(f"a {name} of {', '.join(allowed)}", name, int(np.argmax(which < 0)))
        chosen: WordColumn = np.array([default, *allowed], dtype=kind)[which]
        return chosen

    def _cells(self, name: str) -> tuple[I64, I64]:
        """Where the (N,) cells of a column begin and end."""
        column = self._column[name]
        short = np.flatnonzero(self._n_commas < column)
        if len(short):
            n, line = len(self._column), self._line[short[0]]
            raise InputError(f"{self._path}: expected {n} cells in line {line}, found fewer")
        if not len(self._line):
            return self._starts, self._ends
        before, after = self._first_comma + column - 1, self._first_comma + column
        start = self._commas[before] + 1 if column else self._starts
        last = self._n_commas == column
        return start, np.where(last, self._ends, self._commas[np.where(last, 0, after)] if len(self._commas) else 0)

    def _equal(self, start: I64, stop: I64, word: str) -> Bool:
        same = stop - start == len(word)
        for i, letter in enumerate(word.encode()):
            same &= self._bytes[np.minimum(start + i, len(self._bytes) - 1)] == letter
        return np.asarray(same)

    def _text(self, name: str, row: int) -> str:
        start, stop = self._cells(name)
        return self._block[start[row] : stop[row]].decode()

    def _number(self, name: str, row: int, default: float) -> float:
        text = self._text(name, row)
        try:
            return float(text)
        except ValueError:
            if not text.strip():
                return default
            raise self._refused(f"a number in {name!r}", name, row) from None

    def _refused(self, expected: str, name: str, row: int) -> InputError:
        where = f"line {self._line[row]}"
        return InputError(f"{self._path}: expected {expected}, {where}, found {self._text(name, row)!r}")


def decimals(data: U8, start: I64, stop: I64) -> tuple[F64, Bool]:
    """Decimal numbers without an exponent, as ``float`` reads them.

    Args:
        data: (M,) ASCII.
        start, stop: (N,) where each number begins and ends in it.
    Returns:
        (N,) values, and (N,) whether a text is such a number, of at most 15 digits; the value means nothing elsewhere.
    """
    n = len(start)
    mantissa, scale = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    dots, odd = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.bool_)
    if not n:
        return mantissa.astype(np.float64), odd
    negative = (stop > start) & (data[np.minimum(start, len(data) - 1)] == ord("-"))
    at, digits = start + negative, np.zeros(n, dtype=np.int64)
    for i in range(min(int((stop - at).max()), _DIGITS_MAX + 1)):
        inside = at + i < stop
        letter = np.where(inside, data[np.minimum(at + i, len(data) - 1)], ord(" "))
        value = letter - np.uint8(ord("0"))
        digit, dot = value < 10, letter == ord(".")
        mantissa = np.where(digit, 10 * mantissa + value, mantissa)
        digits += digit
        dots += dot
        scale += digit & (dots > 0)
        odd |= inside & ~digit & ~dot
    plain = ~odd & (digits > 0) & (digits <= _DIGITS_MAX) & (dots <= 1) & (stop - at <= _DIGITS_MAX + 1)
    values = mantissa / 10.0**scale
    return np.where(negative, -values, values), plain
