"""What a function of this package returns that finds more than tracks, scores or a picture."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from calib.errors import printable
from planview.output.words import figure_text, flat_settings, words_of

if TYPE_CHECKING:
    from pandas import DataFrame

Found = TypeVar("Found", covariant=True)


@dataclass(frozen=True, eq=False, repr=False)
class Result(Generic[Found]):
    """What was found; printed, it is a line per value, and a table of what is several of a kind.

    Attributes:
        value: What was found, with all of its methods.
        values: It as plain values by name.
        rows: A table of it, where it is several of a kind.
        files: What was written.
        ok: False where a check or a run failed.
        text: What is printed in place of the values.
    """

    value: Found
    values: Mapping[str, Any] = field(default_factory=dict)
    rows: Sequence[Mapping[str, Any]] = ()
    files: Sequence[Path] = ()
    ok: bool = True
    text: str = ""

    def __repr__(self) -> str:
        return printable(self.text or text_of(self.values))

    def to_json(self) -> dict[str, Any]:
        """Plain values by name."""
        return dict(self.values)

    def to_dataframe(self) -> DataFrame:
        """A pandas DataFrame with a row for each of several, else one row of all values."""
        from pandas import DataFrame  # half a second

        return DataFrame([*self.rows] or [self.to_json()])


def text_of(values: Mapping[str, Any]) -> str:
    """Tables of what is several of a kind, then a line for every other value."""
    parts = list[str]()
    facts = list[tuple[str, str]]()
    for name, value in flat_settings(values).items():
        if isinstance(value, str | list) and not value:
            continue
        if not _holds(value, dict):
            each = value if _holds(value, str) else [value]
            facts += [(words_of(name), figure_text(one)) for one in each]
        elif any(_holds(cell, dict) for cell in value[0].values()):
            parts += map(text_of, value)
        else:
            parts.append(table_text([{words_of(key): figure_text(cell) for key, cell in row.items()} for row in value]))
    return "\n".join(filter(None, [*parts, aligned(facts)]))


def _holds(value: object, kind: type) -> bool:
    return isinstance(value, list) and isinstance(next(iter(value), None), kind)


def plain_values(found: object, *names: str) -> dict[str, Any]:
    """Attributes as plain values by name: angles in degrees, None for what is not known."""
    values: dict[str, Any] = {}
    for name in names:
        value = getattr(found, name)
        if name.endswith("_rad"):
            name = f"{name.removesuffix('_rad')}_deg"
            value = math.degrees(value)
        values[name] = None if value != value else value
    return values


def table_text(rows: Sequence[Mapping[str, str]]) -> str:
    """Rows below the names of their columns, without those that are empty (see ``aligned``)."""
    names = [name for name in rows[0] if any(row[name] not in ("", "-") for row in rows)]
    return aligned([names, *([row[name] for name in names] for row in rows)])


def aligned(rows: Iterable[Sequence[str]]) -> str:
    """Rows as lines with their cells below each other, the last one as wide as the terminal lets it."""
    table = [*rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)][:-1]
    left = sum(widths) + 2 * len(widths)
    wrapper = TextWrapper(break_long_words=False, break_on_hyphens=False, subsequent_indent=" " * left)
    wrapper.width = max(left + 20, shutil.get_terminal_size().columns)
    lines = []
    for *cells, last in table:
        wrapper.initial_indent = "".join(f"{cell:{width}}  " for cell, width in zip(cells, widths, strict=True))
        lines.append((wrapper.fill(last) or wrapper.initial_indent).rstrip())
    return "\n".join(lines)
