"""What a function of this package returns that finds more than tracks, scores or a picture."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from calib.errors import printable
from planview.output.folder import write_result

if TYPE_CHECKING:
    from pandas import DataFrame

Found = TypeVar("Found", covariant=True)


@dataclass(frozen=True, eq=False, repr=False)
class Result(Generic[Found]):
    """What was found; printed, it says so in words.

    Attributes:
        value: What was found, with all of its methods.
        text: It in words.
        values: It as plain values by name.
        rows: A table of it, where it is several of a kind.
        files: What was written.
        ok: False where a check or a run failed.
    """

    value: Found
    text: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    rows: Sequence[Mapping[str, Any]] = ()
    files: Sequence[Path] = ()
    ok: bool = True

    def __repr__(self) -> str:
        return printable(self.text)

    def to_json(self) -> dict[str, Any]:
        """Plain values by name."""
        return dict(self.values)

    def to_dataframe(self) -> DataFrame:
        """A pandas DataFrame with a row for each of several, else one row of all values."""
        from pandas import DataFrame  # half a second

        return DataFrame([*self.rows] or [self.to_json()])

    def save(self, path: Path | str) -> None:
        """Write the table into a .csv file, or all values as JSON. Raises WorkError: it cannot be written."""
        path = Path(path)
        if path.suffix == ".csv":
            write_result(path, str(self.to_dataframe().to_csv(index=False)))
        else:
            write_result(path, json.dumps(self.to_json(), indent=2) + "\n")


def table_text(rows: Sequence[Mapping[str, str]]) -> str:
    """Rows below the names of their columns (see ``aligned``)."""
    return aligned([tuple(rows[0]), *(tuple(row.values()) for row in rows)])


def aligned(rows: Iterable[Sequence[str]]) -> str:
    """Rows as lines with their cells below each other, the last one as wide as the terminal lets it."""
    table = [*rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)][:-1]
    left = sum(widths) + 2 * len(widths)
    room = max(20, shutil.get_terminal_size().columns - left)
    lines = []
    for *cells, last in table:
        first, *others = wrap(last, room, break_long_words=False, break_on_hyphens=False) or [""]
        start = "".join(f"{cell:{width}}  " for cell, width in zip(cells, widths, strict=True))
        lines.append(f"{start}{first}".rstrip())
        lines += [" " * left + other for other in others]
    return "\n".join(lines)


def plural(count: int, noun: str) -> str:
    """ "1 run", "2 runs"."""
    return f"{count} {noun}{'s' * (count != 1)}"
