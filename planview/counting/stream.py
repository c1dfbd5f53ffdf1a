"""Counting frame by frame: the same for a file of tracks and for a live run."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Container, Sequence
from dataclasses import dataclass, field
from itertools import repeat
from typing import NamedTuple

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


class Sighting(NamedTuple):
    """When and where a person was observed."""

    timestamp_s: float
    x_m: float
    y_m: float


@dataclass(eq=False)
class CountedPerson:
    """One or more track ids that are the same person."""

    track_id: int
    """The last id."""
    confirmed_s: float | None = None
    """Time at which one of the ids was first confirmed [s]."""
    present_s: float = 0.0
    """Time of the last row, predictions included [s]."""
    trail: deque[Sighting] = field(default_factory=deque)
    """The last sightings, newest last."""

    def observe(self, sighting: Sighting) -> None:
        trail, moment = self.trail, sighting.timestamp_s
        trail.append(sighting)
        # Sightings of this time give the velocity [s].
        while len(trail) > 2 and moment - trail[1].timestamp_s >= 0.5:
            trail.popleft()

    def predicted(self, timestamp_s: float) -> tuple[float, float]:
        """Place at a later time at constant velocity [m]."""
        (t0, x0, y0), (t1, x1, y1) = self.trail[0], self.trail[-1]
        gain = (timestamp_s - t1) / (t1 - t0) if t1 > t0 else 0.0
        return x1 + gain * (x1 - x0), y1 + gain * (y1 - y0)


class PresentPerson(NamedTuple):
    """A person of this frame, and the row in which it is observed; None when it is only predicted."""

    person: CountedPerson
    row: TrackRow | None


class CountedPeople:
    """The people present, kept from their tracks frame by frame."""

    def __init__(self, params: AnalyticsParams) -> None:
        self._params = params
        self._of_id: dict[int, CountedPerson] = {}

    def update(self, timestamp_s: float, rows: Sequence[TrackRow]) -> tuple[list[PresentPerson], list[CountedPerson]]:
        """The people of the next frame, and those gone for good."""
        present: dict[CountedPerson, PresentPerson] = {}
        of_id = self._of_id

        def precedence(row: TrackRow) -> tuple[int, int]:
            # The current id of a person, other known ids, new ids: so a person observed in this frame is not stitched
            # to a new id, and an old id that comes back after a new one took over does not take the person back.
            person = of_id.get(row.track_id)
            return (2 if person is None else int(person.track_id != row.track_id)), row.track_id

        for row in sorted([row for row in rows if row.observed], key=precedence):
            person = of_id.get(row.track_id)
            if person is None:
                person = self._stitched(timestamp_s, row, present)
            if person is None or person in present:
                person = CountedPerson(row.track_id)
            of_id[row.track_id] = person
            person.track_id, person.present_s = row.track_id, timestamp_s
            if row.confirmed and person.confirmed_s is None:
                person.confirmed_s = timestamp_s
            person.observe(Sighting(timestamp_s, row.x_m, row.y_m))
            present[person] = PresentPerson(person, row)
        for row in rows:
            person = None if row.observed else of_id.get(row.track_id)
            if person is not None:
                person.present_s = timestamp_s
                present.setdefault(person, PresentPerson(person, None))
        limit = timestamp_s - self._params.stitch_s
        gone = dict.fromkeys(person for person in of_id.values() if person.present_s < limit)
        if gone:
            self._of_id = {key: person for key, person in of_id.items() if person not in gone}
        return list(present.values()), list(gone)

    def _stitched(self, timestamp_s: float, row: TrackRow, present: Container[CountedPerson]) -> CountedPerson | None:
        """The unobserved person predicted nearest to the place of a new track, within stitch_m and stitch_s."""
        best, nearest = None, self._params.stitch_m
        for person in dict.fromkeys(self._of_id.values()):
            gap = timestamp_s - person.trail[-1].timestamp_s
            if person in present or not 0 < gap <= self._params.stitch_s:
                continue
            x, y = person.predicted(timestamp_s)
            distance = math.hypot(row.x_m - x, row.y_m - y)
            if distance <= nearest:
                best, nearest = person, distance
        return best


@dataclass(eq=False)
class _Memory:
    """What is remembered of one person; ``events`` and ``stays`` wait until the person is old enough for their rule;
    at the rules ``visited`` the person is counted already."""

    states: list[WireState | AreaState]
    events: list[Event] = field(default_factory=list)
    stays: list[tuple[str, Stay]] = field(default_factory=list)
    visited: set[str] = field(default_factory=set)


class Analytics:
    """Tripwires and zones over tracks.

    Call ``update`` once per frame, in order; afterwards ``stays`` and the events returned hold everything
    (``planview.counting.totals``). ``people`` has each person once per rule and visit, however often it is crossed.
    """

    def __init__(self, rules: Rules, params: AnalyticsParams | None = None) -> None:
        self.rules = rules
        self.params = p = params or AnalyticsParams()
        self._rules: list[Wire | Area] = [
            *(Wire(*self._settled(rule, p.hysteresis_m)) for rule in rules.tripwires),
            *(Area(*self._settled(rule, p.zone_hysteresis_m)) for rule in rules.zones),
        ]
        self.reset()

    def reset(self) -> None:
        """Forget all people and all stays."""
        self._people = CountedPeople(self.params)
        self._memory: dict[CountedPerson, _Memory] = {}
        self._inside: dict[str, int] = {zone.name: 0 for zone in self.rules.zones}
        self.stays: dict[str, list[Stay]] = {zone.name: [] for zone in self.rules.zones}
        self.people: dict[str, int] = dict.fromkeys(
            (rule.name for rule in (*self.rules.tripwires, *self.rules.zones)), 0
        )

    @property
    def occupancy(self) -> dict[str, int]:
        """People in each zone now, those only predicted included."""
        return dict(self._inside)

    def update(self, frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> tuple[Event, ...]:
        """Take one frame's tracks and return the events that have become certain, by time.

        An event is dated to its moment, which lies before this frame by the time that the hysteresis and the age took.
        """
        return self.update_rows(frame, timestamp_s, self.rows(TrackPlaces.of_states(tracks)))

    def rows(self, places: TrackPlaces) -> list[TrackRow]:
        """Rows of tracks, of any number of frames, with where they are at every rule."""
        at_rules = [column.tolist() for rule in self._rules for column in rule.locate(places)]
        columns = (places.track_id, places.confirmed, places.observed, *places.metres().T)
        located = zip(*at_rules, strict=True) if at_rules else repeat((), len(places.track_id))
        return list(map(TrackRow, *(column.tolist() for column in columns), located))

    def update_rows(self, frame: int, timestamp_s: float, rows: Sequence[TrackRow]) -> tuple[Event, ...]:
        """``update`` with rows of the frame as ``rows`` gives them."""
        present, gone = self._people.update(timestamp_s, rows)
        events: list[Event] = []
        self._inside = dict.fromkeys(self._inside, 0)
        for person, row in present:
            memory = self._memory.get(person)
            if memory is None:
                states: list[WireState | AreaState] = [
                    WireState(rule) if isinstance(rule, Wire) else AreaState() for rule in self._rules
                ]
                memory = self._memory[person] = _Memory(states)
            if row is not None:
                values = iter(row.at_rules)
                for rule, state in zip(self._rules, memory.states, strict=True):
                    before = state.stay
                    passage = state.update(frame, timestamp_s, next(values), next(values))
                    if passage is not None:
                        first, moment, kind, way = passage
                        memory.events.append(Event(first, moment, rule.name, kind, person.track_id, way))
                    if state.stay is not None and before is None:
                        memory.stays.append((rule.name, state.stay))
            if person.confirmed_s is not None and (memory.events or memory.stays):
                events += self._release(person, memory, timestamp_s - person.confirmed_s)
            for rule, state in zip(self._rules, memory.states, strict=True):
                if state.stay is not None and state.stay.counted:
                    self._inside[rule.name] += 1
        for person in gone:
            self._memory.pop(person, None)
        return tuple(sorted(events, key=lambda e: e.timestamp_s))

    def _release(self, person: CountedPerson, memory: _Memory, age_s: float) -> list[Event]:
        """Events of a confirmed person old enough for their rules; stays become counted at the same time."""
        ready = {rule.name for rule in self._rules if age_s >= rule.min_age_s}
        for name, stay in memory.stays:
            if name in ready:
                stay.counted = True
                self.stays[name].append(stay)
        released = [event for event in memory.events if event.rule in ready]
        visited = {event.rule for event in released} | {name for name, stay in memory.stays if stay.counted}
        for name in visited - memory.visited:
            self.people[name] += 1
        memory.visited |= visited
        memory.stays = [(name, stay) for name, stay in memory.stays if name not in ready]
        memory.events = [event for event in memory.events if event.rule not in ready]
        return released

    def _settled(self, rule: Placed, hysteresis_m: float) -> tuple[str, F64, PlaneName, float, float]:
        """Name, points and plane of a rule, with its own hysteresis and age or those of all rules."""
        margin_m = hysteresis_m if rule.hysteresis_m is None else rule.hysteresis_m
        age_s = self.params.min_age_s if rule.min_age_s is None else rule.min_age_s
        return rule.name, rule.points if rule.counted is None else rule.counted, rule.plane, margin_m, age_s
