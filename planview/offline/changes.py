"""``refinement.csv``: every change with its reason."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import Literal, NamedTuple

CHANGE_COLUMNS = ("id", "first_frame", "last_frame", "kind", "reason", "value")


class Change(NamedTuple):
    """A row of refinement.csv.

    Attributes:
        track_id: the id after refinement.
        first_frame, last_frame: the frames that changed.
        kind: "begin" (tentative rows confirmed), "exchange" (a mended exchange of ids undone from its contact), "fill"
            (a gap interpolated), "join" (another id made one with this) or "smooth" (positions moved).
        reason: one clause with the numbers that decided it.
        value: frames confirmed, time that an exchange was moved back [s], frames filled, cost of the join, or root mean
            square movement [m].
    """

    track_id: int
    first_frame: int
    last_frame: int
    kind: Literal["begin", "exchange", "fill", "join", "smooth"]
    reason: str
    value: float


def changes_csv(changes: Iterable[Change]) -> str:
    """The text of refinement.csv."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CHANGE_COLUMNS)
    writer.writerows((*change[:5], f"{change.value:.4f}") for change in changes)
    return file.getvalue()
