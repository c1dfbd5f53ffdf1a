"""What was counted in all, per interval, and over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calib.types import F64, I64
from planview.counting.clock import Span
from planview.counting.events import Event
from planview.counting.rules import Placed, Queue, Rules
from planview.counting.zone import Stay


@dataclass(frozen=True, eq=False)
class Counts:
    """All events and stays of a run, with the rules that made them.

    Attributes:
        events: by time.
        stays: of every zone, by their beginning.
        people: of every tripwire and zone, each person once per visit.
        span: the time that the recording covers.
        interval_s: length of the intervals of the totals [s].
    """

    rules: Rules
    events: Sequence[Event]
    stays: dict[str, list[Stay]]
    people: dict[str, int]
    span: Span
    interval_s: float

    def to_json(self) -> dict[str, Any]:
        """The object of ``count --json`` and counts.json: ``rules`` by name, the totals per interval within."""
        rules: dict[str, Any] = {rule.name: self._wire(rule.name) | _place(rule) for rule in self.rules.tripwires}
        rules |= {rule.name: self._zone(rule.name) | _place(rule) for rule in self.rules.zones}
        rules |= {queue.name: self._queue(queue) for queue in self.rules.queues}
        return {
            "rules": rules,
            "start_s": self.span.start_s,
            "duration_s": self.span.duration_s,
            "interval_s": self.interval_s,
        }

    def occupancy(self, zone: str, times_s: F64) -> I64:
        """(N,) people in a zone at times [s]."""
        return occupancy_at(self.stays[zone], times_s, self.span.frame_s)

    def _wire(self, name: str) -> dict[str, Any]:
        crossings = [event for event in self.events if event.rule == name]
        return {
            "kind": "tripwire",
            **_by_direction(crossings),
            "people": self.people[name],
            "intervals": [{"start_s": start, **_by_direction(group)} for start, group in self._intervals(crossings)],
        }

    def _zone(self, name: str) -> dict[str, Any]:
        stays, events = self.stays[name], [event for event in self.events if event.rule == name]
        dwell = [stay.dwell_s + (0.0 if stay.left else self.span.frame_s) for stay in stays]
        return {
            "kind": "zone",
            **_passages(events),
            "people": self.people[name],
            "mean_occupancy": sum(dwell) / self.span.duration_s if self.span.duration_s > 0 else 0.0,
            "max_occupancy": over_frames(stays, self.span).max,
            "mean_dwell_s": float(np.mean(dwell)) if dwell else 0.0,
            "max_dwell_s": max(dwell, default=0.0),
            "stays": len(stays),
            "appeared_inside": sum(not stay.entered for stay in stays),
            "vanished_inside": sum(not stay.left for stay in stays),
            "occupancy": self._changes(stays),
            "intervals": [
                {"start_s": start, **_passages(group), "mean_occupancy": self._mean_within(stays, start)}
                for start, group in self._intervals(events)
            ],
        }

    def _queue(self, queue: Queue) -> dict[str, Any]:
        """A stay of at least min_wait_s is waiting, from entering the zone until leaving it."""
        waits = [stay for stay in self.stays[queue.zone] if stay.dwell_s >= queue.min_wait_s]
        length = over_frames(waits, self.span)
        waited = [stay.dwell_s for stay in waits]
        return {
            "kind": "queue",
            "zone": queue.zone,
            "mean_length": length.mean,
            "max_length": length.max,
            "mean_wait_s": float(np.mean(waited)) if waited else 0.0,
            "max_wait_s": max(waited, default=0.0),
            "waited": len(waits),
            "served": sum(stay.left for stay in waits),
            "length": self._changes(waits),
            "intervals": [
                {"start_s": float(start), "mean_length": self._mean_within(waits, float(start))}
                for start in self.span.interval_starts(
                    self.interval_s, [t for s in waits for t in (s.start_s, s.end_s)]
                )
            ],
        }

    def _changes(self, stays: Sequence[Stay]) -> list[tuple[float, int]]:
        """(time, people from then on) at the beginning and at every change."""
        ends = [_end(stay, self.span.frame_s) for stay in stays]
        times = np.unique([self.span.start_s, *(stay.start_s for stay in stays), *ends])
        numbers = occupancy_at(stays, times, self.span.frame_s)
        return [(round(float(t), 4), int(n)) for t, n in zip(times, numbers, strict=True)]

    def _intervals(self, events: Sequence[Event]) -> list[tuple[float, list[Event]]]:
        starts = self.span.interval_starts(self.interval_s, [event.timestamp_s for event in events])
        groups: list[list[Event]] = [[] for _ in starts]
        indices = np.searchsorted(starts, [event.timestamp_s for event in events], side="right") - 1
        for event, index in zip(events, np.clip(indices, 0, None), strict=True):
            groups[index].append(event)
        return [(float(start), group) for start, group in zip(starts, groups, strict=True)]

    def _mean_within(self, stays: Sequence[Stay], start_s: float) -> float:
        """Mean number of people over the interval from start_s (over the recorded part of the last)."""
        end_s = min(start_s + self.interval_s, self.span.end_s)
        inside = sum(max(0.0, min(_end(stay, self.span.frame_s), end_s) - max(stay.start_s, start_s)) for stay in stays)
        return inside / (end_s - start_s) if end_s > start_s else 0.0


def occupancy_at(stays: Sequence[Stay], times_s: F64, frame_s: float) -> I64:
    """(N,) number of stays under way at times [s]; a stay whose end was not observed lasts to the end of its frame."""
    starts = np.sort([stay.start_s for stay in stays])
    ends = np.sort([_end(stay, frame_s) for stay in stays])
    slack = 1e-6  # timestamps in files have four decimals
    return np.searchsorted(starts, times_s + slack, side="right") - np.searchsorted(ends, times_s + slack, side="right")


class OverFrames(NamedTuple):
    """Number of people over all frames: its greatest value and its mean."""

    max: int
    mean: float


def over_frames(stays: Sequence[Stay], span: Span) -> OverFrames:
    """What ``occupancy_at`` gives at all frames, at the cost of the stays and not of the time.

    The number is greatest at the first frame of some stay; the mean counts the frames of every stay.
    """
    if not stays:
        return OverFrames(0, 0.0)
    slack = 1e-6  # as in occupancy_at
    first = span.first_frames(np.array([stay.start_s for stay in stays]) - slack)
    last = span.first_frames(np.array([_end(stay, span.frame_s) for stay in stays]) - slack)
    at = np.minimum(first, span.n_frames - 1) * span.frame_s + span.start_s
    return OverFrames(int(occupancy_at(stays, at, span.frame_s).max()), float((last - first).sum()) / span.n_frames)


def _end(stay: Stay, frame_s: float) -> float:
    return stay.end_s if stay.left else stay.end_s + frame_s


def _place(rule: Placed) -> dict[str, Any]:
    """Where a rule was applied, for pictures."""
    return {"plane": rule.plane, "points": rule.points.tolist()}


def _by_direction(events: Sequence[Event]) -> dict[str, int]:
    count = Counter(event.direction for event in events)
    return {"left_to_right": count["left_to_right"], "right_to_left": count["right_to_left"]}


def _passages(events: Sequence[Event]) -> dict[str, int]:
    count = Counter(event.kind for event in events)
    return {"entries": count["entry"], "exits": count["exit"]}
