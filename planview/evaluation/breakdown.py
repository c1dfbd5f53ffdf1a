"""Matches and position errors by distance, by visibility and by number of people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from calib.types import F64, I64, AnyArray, Bool


class ValueRange(NamedTuple):
    """From ``low``, below ``high``."""

    low: float
    high: float

    def contains(self, values: AnyArray) -> Bool:
        return np.asarray((values >= self.low) & (values < self.high))

    def __str__(self) -> str:
        return f"{self.low:g}+" if math.isinf(self.high) else f"{self.low:g}-{self.high:g}"


DISTANCES_M = tuple(ValueRange(*pair) for pair in ((0, 2), (2, 4), (4, 6), (6, 8), (8, 12), (12, math.inf)))
"""Our choice: the depth noise of a stereo pair grows with the square of the distance."""
_TOP = (0.75, math.nextafter(1, 2))  # fully visible belongs to the last
VISIBILITIES = tuple(ValueRange(*pair) for pair in ((0, 0.25), (0.25, 0.5), (0.5, 0.75), _TOP))
PEOPLE_GROUPS = (("0", 0, 0.0), ("1-2", 1, 2.0), ("3-5", 3, 5.0), ("6-9", 6, 9.0), ("10+", 10, math.inf))
"""(name, first, last): numbers of people as table 4 of Zhang et al. 2008 groups them."""


@dataclass(frozen=True, eq=False)
class TruthRows:
    """What is known of every truth row that counts, (N,) each.

    Attributes:
        distance_m: from the origin of the truth's floor frame (below the camera in our own recordings) [m]; may be NaN.
        visible: unoccluded fraction.
        people: people that count in the same frame.
        matched: whether a track matches.
        position_error_m: floor distance to it [m]; NaN where there is none.
    """

    distance_m: F64
    visible: F64
    people: I64
    matched: Bool
    position_error_m: F64

    @staticmethod
    def joined(parts: Sequence[TruthRows]) -> TruthRows:
        """The rows of all parts, in their order."""
        names = TruthRows.__dataclass_fields__
        return TruthRows(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


@dataclass(frozen=True)
class GroupScores:
    """Truth rows of one group, how many are matched, and their position error [m]; None without any."""

    group: str
    truth_rows: int
    matches: int
    position_error_mean_m: float | None
    position_error_std_m: float | None


def by_distance(rows: TruthRows) -> list[GroupScores]:
    return [_group(rows, str(interval), interval.contains(rows.distance_m)) for interval in DISTANCES_M]


def by_visibility(rows: TruthRows) -> list[GroupScores]:
    return [_group(rows, str(interval), interval.contains(rows.visible)) for interval in VISIBILITIES]


def by_people(rows: TruthRows) -> list[GroupScores]:
    """By the number of people in the frame; without people there are no rows."""
    return [
        _group(rows, name, (rows.people >= first) & (rows.people <= last)) for name, first, last in PEOPLE_GROUPS[1:]
    ]


def breakdown_json(rows: TruthRows) -> dict[str, list[dict[str, Any]]]:
    """The three tables by their keys."""
    tables = {"by_distance": by_distance(rows), "by_visibility": by_visibility(rows), "by_people": by_people(rows)}
    return {key: [asdict(group) for group in table] for key, table in tables.items()}


def _group(rows: TruthRows, name: str, members: Bool) -> GroupScores:
    errors = rows.position_error_m[members]
    errors = errors[np.isfinite(errors)]
    mean, std = (float(errors.mean()), float(errors.std())) if len(errors) else (None, None)
    return GroupScores(name, int(members.sum()), int(rows.matched[members].sum()), mean, std)
