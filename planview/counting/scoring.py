"""Counts against true counts, so that errors of opposite sign cannot cancel unseen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calib.types import I64
from planview.counting.events import Direction, Event
from planview.counting.totals import Counts
from planview.evaluation.metrics import best_pairs
from planview.evaluation.result import PEOPLE_GROUPS


@dataclass(frozen=True)
class CrossingScores:
    """Crossings of one tripwire matched to true ones; None where there are none.

    Attributes:
        matched: found and true within the time window and in the same direction.
        wrong_direction: pairs within the window that are left, of opposite directions.
        accuracy: 1 - |found - true| / true, as in table 3 of Zhang et al. 2008.
        strict_accuracy: 1 - (missed + extra) / true per direction, where opposite errors add up; not below 0.
        timing_mean_s, timing_std_s: found minus true time of matches.
    """

    true_left_to_right: int
    true_right_to_left: int
    found_left_to_right: int
    found_right_to_left: int
    matched: int
    wrong_direction: int
    accuracy: float | None
    strict_accuracy: float | None
    precision: float | None
    recall: float | None
    timing_mean_s: float | None
    timing_std_s: float | None


@dataclass(frozen=True)
class OccupancyGroup:
    """Frames with a true number of people in a range: %A and E(delta) of table 4 (Zhang et al. 2008), and E|delta|."""

    people: str
    frames: int
    right_percent: float | None
    mean_difference: float | None
    mean_absolute_difference: float | None


@dataclass(frozen=True)
class CountScores:
    """Scores per rule: crossings of tripwires, occupancy of zones."""

    crossings: dict[str, CrossingScores]
    occupancy: dict[str, list[OccupancyGroup]]

    def to_json(self) -> dict[str, Any]:
        rules: dict[str, Any] = {name: asdict(score) for name, score in self.crossings.items()}
        rules |= {name: {"groups": [asdict(group) for group in table]} for name, table in self.occupancy.items()}
        return {"rules": rules}


def score_counts(true: Counts, found: Counts, window_s: float) -> CountScores:
    """Score all rules against the counts of the truth."""
    times = found.span.frame_times()
    occupancy = {
        zone.name: occupancy_groups(true.occupancy(zone.name, times), found.occupancy(zone.name, times))
        for zone in found.rules.zones
    }
    return CountScores(score_events(true.events, found, window_s).crossings, occupancy)


def score_events(true: Sequence[Event], found: Counts, window_s: float) -> CountScores:
    """Score the tripwires against true crossings."""
    crossings = {
        wire.name: crossing_scores(_of(true, wire.name), _of(found.events, wire.name), window_s)
        for wire in found.rules.tripwires
    }
    return CountScores(crossings, {})


def crossing_scores(true: Sequence[Event], found: Sequence[Event], window_s: float) -> CrossingScores:
    """Match crossings of one line one to one: most matches within the window, then the smallest time differences."""
    pairs = _match(true, found, window_s, same=True)
    rest_true = [event for i, event in enumerate(true) if i not in pairs[:, 0]]
    rest_found = [event for i, event in enumerate(found) if i not in pairs[:, 1]]
    turned = _match(rest_true, rest_found, window_s, same=False)
    late = np.array([found[j].timestamp_s - true[i].timestamp_s for i, j in pairs])
    n_true, n_found, n = len(true), len(found), len(pairs)
    wrong = (n_true - n) + (n_found - n)
    return CrossingScores(
        true_left_to_right=_count(true, "left_to_right"),
        true_right_to_left=_count(true, "right_to_left"),
        found_left_to_right=_count(found, "left_to_right"),
        found_right_to_left=_count(found, "right_to_left"),
        matched=n,
        wrong_direction=len(turned),
        accuracy=max(0.0, 1.0 - abs(n_found - n_true) / n_true) if n_true else None,
        strict_accuracy=max(0.0, 1.0 - wrong / n_true) if n_true else None,
        precision=n / n_found if n_found else None,
        recall=n / n_true if n_true else None,
        timing_mean_s=float(late.mean()) if n else None,
        timing_std_s=float(late.std()) if n else None,
    )


def _count(events: Sequence[Event], direction: Direction) -> int:
    return sum(event.direction == direction for event in events)


def occupancy_groups(true: I64, found: I64) -> list[OccupancyGroup]:
    """Table 4 of two (N,) series: how often the number is right and by how much it is off, by the true number."""
    difference = (found - true).astype(np.float64)
    groups = []
    for name, low, high in PEOPLE_GROUPS:
        mine = difference[(true >= low) & (true <= high)]
        figures = [float(v.mean()) if len(mine) else None for v in (100.0 * (mine == 0), mine, np.abs(mine))]
        groups.append(OccupancyGroup(name, len(mine), *figures))
    return groups


def _match(true: Sequence[Event], found: Sequence[Event], window_s: float, *, same: bool) -> I64:
    """(K, 2) indices of matches of the same, or of opposite, directions."""
    apart = np.array([[abs(f.timestamp_s - t.timestamp_s) for f in found] for t in true]).reshape(len(true), len(found))
    alike = np.array([[f.direction == t.direction for f in found] for t in true]).reshape(apart.shape)
    rows, cols = np.nonzero((apart <= window_s) & (alike == same))
    # One pair more weighs more than all time differences: the number of matches comes first.
    weight = (window_s + 1.0) * (min(apart.shape) + 1) - apart[rows, cols]
    chosen = best_pairs(rows, cols, weight, np.zeros(len(rows), dtype=np.int64))
    return np.column_stack([rows[chosen], cols[chosen]])


def _of(events: Sequence[Event], rule: str) -> list[Event]:
    return [event for event in events if event.rule == rule and event.kind == "crossing"]
