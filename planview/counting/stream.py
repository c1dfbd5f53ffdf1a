"""Counting frame by frame: the same for a file of tracks and for a live run."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from calib.carried import Carried
from calib.types import F64
from planview.counting.events import Event
from planview.counting.passages import Area, AreaState, Stay, TrackPlaces, Wire, WireState
from planview.counting.rules import AnalyticsParams, Placed, PlaneName, Rules
from planview.trajectories.state import TrackState


class TrackRow(NamedTuple):
    """One track in one frame; ``at_rules``: two numbers per rule, as ``Wire.locate`` and ``Area.locate`` give them."""

    track_id: int
    confirmed: bool
    observed: bool
    x_m: float
    y_m: float
    at_rules: tuple[float, ...]


@dataclass(eq=False)
class CountedPerson:
    """One or more track ids that are the same person, and what is remembered of it."""

    track_id: int
    """The last id."""
    states: list[WireState | AreaState]
    """At every rule."""
    confirmed_s: float | None = None
    """Time at which one of the ids was first confirmed [s]."""
    present_s: float = 0.0
    """Time of the last row, predictions included [s]."""
    row: TrackRow | None = None
    """The row of this frame; None where the person is only predicted."""
    trail: deque[tuple[float, float, float]] = field(default_factory=deque)
    """Times [s] and places [m] of the last sightings, newest last."""
    events: list[Event] = field(default_factory=list)
    """These wait until the person is old enough for their rule, as do ``stays``."""
    stays: list[tuple[str, Stay]] = field(default_factory=list)
    visited: set[str] = field(default_factory=set)
    """Rules at which the person is counted already."""

    def observe(self, timestamp_s: float, row: TrackRow) -> None:
        self.track_id, self.present_s, self.row = row.track_id, timestamp_s, row
        if row.confirmed and self.confirmed_s is None:
            self.confirmed_s = timestamp_s
        self.trail.append((timestamp_s, row.x_m, row.y_m))
        # Sightings of half a second give the velocity.
        while len(self.trail) > 2 and timestamp_s - self.trail[1][0] >= 0.5:
            self.trail.popleft()

    def predicted(self, timestamp_s: float) -> tuple[float, float]:
        """Place at a later time at constant velocity [m]."""
        (t0, x0, y0), (t1, x1, y1) = self.trail[0], self.trail[-1]
        gain = (timestamp_s - t1) / (t1 - t0) if t1 > t0 else 0.0
        return x1 + gain * (x1 - x0), y1 + gain * (y1 - y0)


class Analytics(Carried):
    """Tripwires and zones over tracks.

    Call ``update`` once per frame, in order; afterwards ``stays`` and the events returned hold everything
    (``planview.counting.totals``). ``people`` has each person once per rule and visit, however often it is crossed.
    """

    CARRIED = "_of_id", "stays", "people"

    def __init__(self, rules: Rules, params: AnalyticsParams | None = None) -> None:
        self.rules = rules
        self.params = p = params or AnalyticsParams()
        self._rules: list[Wire | Area] = [
            *(Wire(*self._settled(rule, p.hysteresis_m)) for rule in rules.tripwires),
            *(Area(*self._settled(rule, p.zone_hysteresis_m)) for rule in rules.zones),
        ]
        self._of_id: dict[int, CountedPerson] = {}
        self.stays: dict[str, list[Stay]] = {zone.name: [] for zone in rules.zones}
        self.people: dict[str, int] = dict.fromkeys((rule.name for rule in (*rules.tripwires, *rules.zones)), 0)

    def update(self, frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> tuple[Event, ...]:
        """Take one frame's tracks and return the events that have become certain, by time.

        An event is dated to its moment, which lies before this frame by the time that the hysteresis and the age took.
        """
        return self.update_rows(frame, timestamp_s, self.rows(TrackPlaces.of_states(tracks)))

    def rows(self, places: TrackPlaces) -> list[TrackRow]:
        """Rows of tracks, of any number of frames, with where they are at every rule."""
        at_rules = [column.tolist() for rule in self._rules for column in rule.locate(places)]
        columns = (places.track_id, places.state == "confirmed", places.observed, *places.metres().T)
        return list(map(TrackRow, *(column.tolist() for column in columns), zip(*at_rules, strict=True)))

    def update_rows(self, frame: int, timestamp_s: float, rows: Sequence[TrackRow]) -> tuple[Event, ...]:
        """``update`` with rows of the frame as ``rows`` gives them."""
        events: list[Event] = []
        for person in self._present(timestamp_s, rows):
            if person.row is not None:
                values = iter(person.row.at_rules)
                for rule, state in zip(self._rules, person.states, strict=True):
                    before = state.stay
                    passage = state.update(frame, timestamp_s, next(values), next(values))
                    if passage is not None:
                        first, moment, kind, way = passage
                        person.events.append(Event(first, moment, rule.name, kind, person.track_id, way))
                    if state.stay is not None and before is None:
                        person.stays.append((rule.name, state.stay))
            if person.confirmed_s is not None and (person.events or person.stays):
                events += self._release(person, timestamp_s - person.confirmed_s)
        return tuple(sorted(events, key=lambda e: e.timestamp_s))

    def _present(self, timestamp_s: float, rows: Sequence[TrackRow]) -> list[CountedPerson]:
        """The people of the next frame; those gone for good are forgotten."""
        present: dict[CountedPerson, None] = {}
        of_id = self._of_id

        def precedence(row: TrackRow) -> tuple[int, int]:
            # The current id of a person, other known ids, new ids: so a person observed in this frame is not stitched
            # to a new id, and an old id that comes back after a new one took over does not take the person back.
            person = of_id.get(row.track_id)
            return (2 if person is None else int(person.track_id != row.track_id)), row.track_id

        for row in sorted([row for row in rows if row.observed], key=precedence):
            person = of_id.get(row.track_id) or self._stitched(timestamp_s, row, present)
            if person is None or person in present:
                person = CountedPerson(
                    row.track_id, [WireState(rule) if isinstance(rule, Wire) else AreaState() for rule in self._rules]
                )
            of_id[row.track_id] = person
            person.observe(timestamp_s, row)
            present[person] = None
        for row in rows:
            person = None if row.observed else of_id.get(row.track_id)
            if person is not None and person not in present:
                person.present_s, person.row, present[person] = timestamp_s, None, None
        limit = timestamp_s - self.params.stitch_s
        self._of_id = {key: person for key, person in of_id.items() if person.present_s >= limit}
        return list(present)

    def _stitched(self, timestamp_s: float, row: TrackRow, present: Container[CountedPerson]) -> CountedPerson | None:
        """The unobserved person predicted nearest to the place of a new track, within stitch_m and stitch_s."""
        best, nearest = None, self.params.stitch_m
        for person in dict.fromkeys(self._of_id.values()):
            gap = timestamp_s - person.trail[-1][0]
            if person in present or not 0 < gap <= self.params.stitch_s:
                continue
            x, y = person.predicted(timestamp_s)
            distance = math.hypot(row.x_m - x, row.y_m - y)
            if distance <= nearest:
                best, nearest = person, distance
        return best

    def _release(self, person: CountedPerson, age_s: float) -> list[Event]:
        """Events of a confirmed person old enough for their rules; stays count from the same time."""
        ready = {rule.name for rule in self._rules if age_s >= rule.min_age_s}
        for name, stay in person.stays:
            if name in ready:
                self.stays[name].append(stay)
        events = [e if e.track_id > 0 else replace(e, track_id=person.track_id) for e in person.events]
        released = [event for event in events if event.rule in ready]
        visited = {event.rule for event in released} | {name for name, _ in person.stays if name in ready}
        for name in visited - person.visited:
            self.people[name] += 1
        person.visited |= visited
        person.stays = [(name, stay) for name, stay in person.stays if name not in ready]
        person.events = [event for event in person.events if event.rule not in ready]
        return released

    def _settled(self, rule: Placed, hysteresis_m: float) -> tuple[str, F64, PlaneName, float, float]:
        """Name, points and plane of a rule, with its own hysteresis and age or those of all rules."""
        margin_m = hysteresis_m if rule.hysteresis_m is None else rule.hysteresis_m
        age_s = self.params.min_age_s if rule.min_age_s is None else rule.min_age_s
        return rule.name, rule.points if rule.counted is None else rule.counted, rule.plane, margin_m, age_s
