"""Totals of counted rules over a recording, with the time of every frame, and their scores against true counts."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64
from planview.counting.events import Direction, Event
from planview.counting.rules import AnalyticsParams, Placed, Queue, Rules
from planview.counting.stream import Analytics, Stay, TrackPlaces
from planview.evaluation.metrics import best_pairs
from planview.evaluation.result import PEOPLE_GROUPS
from planview.trajectories.clock import Clock, Span
from planview.trajectories.table import IGNORED, Trajectories, WordColumn

INTERVALS_MAX = 10_080
"""Intervals of the totals at most, a week of minutes: where the clock has jumped they are longer."""


@dataclass(frozen=True, eq=False)
class Counts:
    """All events and stays of a run, by time, with the rules that made them."""

    rules: Rules
    events: Sequence[Event]
    stays: dict[str, list[Stay]]
    """Stays in every zone."""
    people: dict[str, int]
    """People at every tripwire and zone, each once per visit."""
    span: Span
    interval_s: float
    """Length of the intervals of the totals [s]."""

    @staticmethod
    def of(analytics: Analytics, events: Sequence[Event], span: Span) -> Counts:
        """All that an analysis has counted, at its end."""
        stays = {}
        for name, of_zone in analytics.stays.items():
            stays[name] = sorted(of_zone, key=lambda stay: stay.start_s)
        ordered = sorted(events, key=lambda event: event.timestamp_s)
        interval_s = max(analytics.params.interval_s, span.duration_s / INTERVALS_MAX)
        return Counts(analytics.rules, ordered, stays, analytics.people, span, interval_s)

    def to_json(self) -> dict[str, Any]:
        """The totals as ``count --json`` and counts.json have them: ``rules`` by name, with totals per interval."""
        rules: dict[str, Any] = {rule.name: self._wire(rule) for rule in self.rules.tripwires}
        rules |= {rule.name: self._zone(rule.name) for rule in self.rules.zones}
        for rule in (*self.rules.tripwires, *self.rules.zones):  # where it was applied, for pictures
            rules[rule.name] |= {"plane": rule.plane, "points": rule.points.tolist()}
        rules |= {queue.name: self._queue(queue) for queue in self.rules.queues}
        span = {"start_s": self.span.start_s, "duration_s": self.span.duration_s}
        return {"rules": rules, **span, "interval_s": self.interval_s}

    def occupancy(self, zone: str, times_s: F64) -> I64:
        """(N,) people in a zone at times [s]."""
        return self._number(self.stays[zone], times_s)

    def _wire(self, wire: Placed) -> dict[str, Any]:
        crossings = [event for event in self.events if event.rule == wire.name]
        return {
            "kind": "tripwire",
            **({"inward": wire.inward} if wire.inward else {}),
            **_by_direction(crossings, wire.inward),
            "people": self.people[wire.name],
            "intervals": self._intervals(lambda *span: _by_direction(_between(crossings, *span), wire.inward)),
        }

    def _zone(self, name: str) -> dict[str, Any]:
        stays = self.stays[name]
        events = [event for event in self.events if event.rule == name]
        begins, ends = _times(stays, self.span.frame_s)
        dwell_s = ends - begins
        changes = self._changes(stays)
        return {
            "kind": "zone",
            **_passages(events),
            "people": self.people[name],
            "mean_occupancy": self._mean(stays, self.span.start_s, self.span.end_s),
            "max_occupancy": max(number for _, number in changes),
            "mean_dwell_s": float(dwell_s.sum()) / max(1, len(stays)),
            "max_dwell_s": float(dwell_s.max(initial=0.0)),
            "stays": len(stays),
            "appeared_inside": sum(not stay.entered for stay in stays),
            "vanished_inside": sum(not stay.left for stay in stays),
            "occupancy": changes,
            "intervals": self._intervals(
                lambda *span: _passages(_between(events, *span)) | {"mean_occupancy": self._mean(stays, *span)}
            ),
        }

    def _queue(self, queue: Queue) -> dict[str, Any]:
        """A stay of at least min_wait_s is waiting, from entering the zone until leaving it."""
        waits = [stay for stay in self.stays[queue.zone] if stay.dwell_s >= queue.min_wait_s]
        waited_s = np.array([stay.dwell_s for stay in waits])
        changes = self._changes(waits)
        return {
            "kind": "queue",
            "zone": queue.zone,
            "mean_length": self._mean(waits, self.span.start_s, self.span.end_s),
            "max_length": max(number for _, number in changes),
            "mean_wait_s": float(waited_s.sum()) / max(1, len(waits)),
            "max_wait_s": float(waited_s.max(initial=0.0)),
            "waited": len(waits),
            "served": sum(stay.left for stay in waits),
            "length": changes,
            "intervals": self._intervals(lambda *span: {"mean_length": self._mean(waits, *span)}),
        }

    def _intervals(self, figures: Callable[[float, float], Mapping[str, float]]) -> list[dict[str, float]]:
        """Figures from the beginning to the end of every interval [s]; the last one ends with the recording."""
        count = max(1, math.ceil((self.span.duration_s - 1e-9) / self.interval_s))
        starts = [self.span.start_s + n * self.interval_s for n in range(count)]
        ends = [*starts[1:], max(self.span.end_s, starts[-1])]
        return [{"start_s": start, **figures(start, end)} for start, end in zip(starts, ends, strict=True)]

    def _changes(self, stays: Sequence[Stay]) -> list[tuple[float, int]]:
        """(time, people from then on) at the beginning and at every change."""
        begins, ends = _times(stays, self.span.frame_s)
        times_s = np.unique([self.span.start_s, *begins, *ends])
        numbers = self._number(stays, times_s)
        return [(round(time_s, 4), number) for time_s, number in zip(times_s.tolist(), numbers.tolist(), strict=True)]

    def _number(self, stays: Sequence[Stay], times_s: F64) -> I64:
        """(N,) stays under way at times [s], which have four decimals in files."""
        begins, ends = _times(stays, self.span.frame_s)
        begun = np.searchsorted(np.sort(begins), times_s + 1e-6, side="right")
        done = np.searchsorted(np.sort(ends), times_s + 1e-6, side="right")
        return begun - done

    def _mean(self, stays: Sequence[Stay], start_s: float, end_s: float) -> float:
        """Mean number of people from one time to another."""
        if end_s <= start_s:
            return 0.0
        begins, ends = _times(stays, self.span.frame_s)
        inside_s = np.maximum(0.0, np.minimum(ends, end_s) - np.maximum(begins, start_s)).sum()
        return float(inside_s) / (end_s - start_s)


def _between(events: Sequence[Event], start_s: float, end_s: float) -> Sequence[Event]:
    """Events in an interval, of events in order of time."""
    first = bisect_left(events, start_s, key=lambda event: event.timestamp_s)
    last = bisect_left(events, end_s, key=lambda event: event.timestamp_s)
    return events[first:last]


def _times(stays: Sequence[Stay], frame_s: float) -> tuple[F64, F64]:
    """(N,) begins and ends [s]; a stay whose end was not observed lasts to the end of its frame."""
    ends = [stay.end_s if stay.left else stay.end_s + frame_s for stay in stays]
    return np.array([stay.start_s for stay in stays], dtype=np.float64), np.array(ends, dtype=np.float64)


def _by_direction(events: Sequence[Event], inward: Direction) -> dict[str, int]:
    count = Counter(event.direction for event in events)
    numbers = {"left_to_right": count["left_to_right"], "right_to_left": count["right_to_left"]}
    if inward:
        numbers |= {"in": count[inward], "out": len(events) - count[inward]}
    return numbers


def _passages(events: Sequence[Event]) -> dict[str, int]:
    count = Counter(event.kind for event in events)
    return {"entries": count["entry"], "exits": count["exit"]}


def count_tracks(
    tracks: Trajectories,
    rules: Rules,
    params: AnalyticsParams | None = None,
    *,
    clock: Clock | None = None,
    n_frames: int = 0,
) -> Counts:
    """Apply rules to tracks, with the time of their frames or another clock; a recording of unknown length ends with
    the last row. Raises InputError: the tracks have no place in the plane of a rule, or no times."""
    _require_places(tracks, rules)
    clock = clock or Clock(tracks)
    analytics = Analytics(rules, params)
    events: list[Event] = []
    frames, starts = np.unique(tracks.frame, return_index=True)
    moments = clock.at(frames)
    bounds = np.append(starts, len(tracks))
    # Rows of a thousand frames are located at a time, so that memory does not grow with the recording.
    for first in range(0, len(frames), 1000):
        last = min(first + 1000, len(frames))
        begin = bounds[first]
        rows = analytics.rows(TrackPlaces.of_rows(tracks, slice(begin, bounds[last])))
        for place in range(first, last):
            of_frame = rows[bounds[place] - begin : bounds[place + 1] - begin]
            events += analytics.update_rows(int(frames[place]), float(moments[place]), of_frame)
    last_frame = int(tracks.frame.max(initial=-1))
    return Counts.of(analytics, events, clock.span(max(n_frames, last_frame + 1)))


def _require_places(tracks: Trajectories, rules: Rules) -> None:
    """Raises InputError: there are rows, and none has a place in the plane of a rule."""
    for rule in (*rules.tripwires, *rules.zones):
        places = tracks.x_m + tracks.y_m
        need = "floor positions"
        if rule.plane == "image":
            places = tracks.box_px.sum(axis=1)
            need = "boxes, or with a camera,"
        if len(tracks) and not np.isfinite(places).any():
            raise InputError(
                f"{rules.source}: expected tracks with {need} for rule {rule.name!r}, found none in any row"
            )


def count_truth(
    truth: Trajectories, rules: Rules, clock: Clock, params: AnalyticsParams | None = None, n_frames: int = 0
) -> Counts:
    """The true counts: the same rules on true positions, without a minimum age and without stitching of ids.

    A crossing means the same for truth: a person that steps back within the hysteresis has not crossed, which is also
    how crossings are counted by hand. The outline of a zone is taken as it is, but for sway. Clock and parameters are
    those of the tracks.
    """
    params = (params or AnalyticsParams()).model_copy(update={"stitch_s": 0.0})
    # For true occupancy: how far a head sways when a person stands on the outline [m].
    visible = truth.where(truth.visible != IGNORED)
    return count_tracks(visible, rules.of_truth(0.05), params, clock=clock, n_frames=n_frames)


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


def score_counts(true: Counts, counted: Counts, window_s: float) -> CountScores:
    """Score all rules against the counts of the truth."""
    times = counted.span.frame_times()
    occupancy = {
        zone.name: occupancy_groups(true.occupancy(zone.name, times), counted.occupancy(zone.name, times))
        for zone in counted.rules.zones
    }
    return CountScores(score_events(true.events, counted, window_s).crossings, occupancy)


def score_events(true: Sequence[Event], counted: Counts, window_s: float) -> CountScores:
    """Score the tripwires against true crossings."""
    crossings = {
        wire.name: crossing_scores(_of(true, wire.name), _of(counted.events, wire.name), window_s)
        for wire in counted.rules.tripwires
    }
    return CountScores(crossings, {})


def crossing_scores(true: Sequence[Event], counted: Sequence[Event], window_s: float) -> CrossingScores:
    """Match crossings of one line one to one: most matches within the window, then the smallest time differences."""
    pairs = _match(true, counted, window_s, same=True)
    rest_true = [event for place, event in enumerate(true) if place not in pairs[:, 0]]
    rest_found = [event for place, event in enumerate(counted) if place not in pairs[:, 1]]
    turned = _match(rest_true, rest_found, window_s, same=False)
    late_s = np.array([counted[b].timestamp_s - true[a].timestamp_s for a, b in pairs])
    true_ways = Counter(event.direction for event in true)
    found_ways = Counter(event.direction for event in counted)
    matched = len(pairs)
    wrong = len(rest_true) + len(rest_found)
    return CrossingScores(
        true_left_to_right=true_ways["left_to_right"],
        true_right_to_left=true_ways["right_to_left"],
        found_left_to_right=found_ways["left_to_right"],
        found_right_to_left=found_ways["right_to_left"],
        matched=matched,
        wrong_direction=len(turned),
        accuracy=_share(len(true) - abs(len(counted) - len(true)), len(true)),
        strict_accuracy=_share(len(true) - wrong, len(true)),
        precision=_share(matched, len(counted)),
        recall=_share(matched, len(true)),
        timing_mean_s=float(late_s.mean()) if matched else None,
        timing_std_s=float(late_s.std()) if matched else None,
    )


def _share(part: int, whole: int) -> float | None:
    """A share, not below 0; None of nothing."""
    return max(0.0, part / whole) if whole else None


def occupancy_groups(true: I64, counted: I64) -> list[OccupancyGroup]:
    """Table 4 of two (N,) series: share of right numbers and their errors, by the true number."""
    difference = (counted - true).astype(np.float64)
    groups = []
    for name, low, high in PEOPLE_GROUPS:
        chosen = difference[(true >= low) & (true <= high)]
        if not len(chosen):
            groups.append(OccupancyGroup(name, 0, None, None, None))
            continue
        right_percent = 100.0 * float((chosen == 0).mean())
        groups.append(
            OccupancyGroup(name, len(chosen), right_percent, float(chosen.mean()), float(np.abs(chosen).mean()))
        )
    return groups


def _match(true: Sequence[Event], counted: Sequence[Event], window_s: float, *, same: bool) -> I64:
    """(K, 2) indices of matches of the same, or of opposite, directions."""
    true_s, true_way = _times_and_ways(true)
    found_s, found_way = _times_and_ways(counted)
    apart_s = np.abs(found_s - true_s[:, None])
    is_alike = found_way == true_way[:, None]
    rows, cols = np.nonzero((apart_s <= window_s) & (is_alike == same))
    # One pair more weighs more than all time differences: the number of matches comes first.
    weight = (window_s + 1.0) * (min(apart_s.shape) + 1) - apart_s[rows, cols]
    chosen = best_pairs(rows, cols, weight, np.zeros(len(rows), dtype=np.int64))
    return np.column_stack([rows[chosen], cols[chosen]])


def _times_and_ways(events: Sequence[Event]) -> tuple[F64, WordColumn]:
    """(N,) times [s] and directions of events."""
    times_s = np.array([event.timestamp_s for event in events], dtype=np.float64)
    ways = np.array([event.direction for event in events], dtype=np.str_)
    return times_s, ways


def _of(events: Sequence[Event], rule: str) -> list[Event]:
    return [event for event in events if event.rule == rule and event.kind == "crossing"]
