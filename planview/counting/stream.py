"""Counting frame by frame: the same for a file of tracks and for a live run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import repeat

from calib.types import F64, I64, Bool
from planview.counting.changes import Changes, changes
from planview.counting.events import Event
from planview.counting.geometry import PlaneName
from planview.counting.params import AnalyticsParams
from planview.counting.people import CountedPeople, CountedPerson, TrackRow
from planview.counting.places import Places
from planview.counting.rules import Placed, Rules
from planview.counting.tripwire import Wire, WireState
from planview.counting.zone import Area, AreaState, Stay
from planview.trajectories.state import TrackState


@dataclass(eq=False)
class _Memory:
    """What is remembered of one person; ``events`` and ``stays`` wait until the person is old enough for their rule;
    at the rules ``visited`` the person is counted already."""

    wires: list[WireState]
    areas: list[AreaState]
    events: list[Event] = field(default_factory=list)
    stays: list[tuple[str, Stay]] = field(default_factory=list)
    visited: set[str] = field(default_factory=set)


class Analytics:
    """Tripwires and zones over tracks.

    Call ``update`` once per frame, in order; afterwards ``stays`` and the events returned tell everything
    (``planview.counting.totals``). ``people`` has each person once per rule and visit, however often it is crossed.

    Args:
        rules: what to count.
        params: when a person counts.
    """

    def __init__(self, rules: Rules, params: AnalyticsParams | None = None) -> None:
        self.rules = rules
        self.params = p = params or AnalyticsParams()
        self._wires = [Wire(*self._settled(rule, p.hysteresis_m)) for rule in rules.tripwires]
        self._areas = [Area(*self._settled(rule, p.zone_hysteresis_m)) for rule in rules.zones]
        self.reset()

    def reset(self) -> None:
        """Forget all people and all stays."""
        self._people = CountedPeople(self.params)
        self._memory: dict[CountedPerson, _Memory] = {}
        self._inside: dict[str, int] = {area.name: 0 for area in self._areas}
        self.stays: dict[str, list[Stay]] = {area.name: [] for area in self._areas}
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
        return self.update_rows(frame, timestamp_s, self.rows(Places.of_states(tracks)))

    def rows(self, places: Places, changing: Bool | None = None) -> list[TrackRow]:
        """Rows of tracks, of any number of frames, with where they are at every rule.

        Args:
            changing: (N,) rows that may change sides (``changes``); all by default. The others are not located.
        """
        wires, areas = ([rule.locate(places) for rule in rules] for rules in (self._wires, self._areas))
        at_rules = [column.tolist() for located in (*wires, *areas) for column in located]
        columns = (places.track_id, places.confirmed, places.observed, *places.metres().T)
        located = zip(*at_rules, strict=True) if at_rules else repeat((), len(places.track_id))
        asked = repeat(True) if changing is None else changing.tolist()
        shown = (at if ask else () for at, ask in zip(located, asked, strict=False))
        return list(map(TrackRow, *(column.tolist() for column in columns), shown))

    def changes(self, frame: I64, moments_s: F64, places: Places) -> Changes:
        """What ``update_rows`` needs of a table (``planview.counting.changes``)."""
        return changes(frame, moments_s, places, [*self._wires, *self._areas])

    def update_rows(self, frame: int, timestamp_s: float, rows: Sequence[TrackRow]) -> tuple[Event, ...]:
        """``update`` with rows of the frame as ``rows`` gives them."""
        present, gone = self._people.update(timestamp_s, rows)
        events: list[Event] = []
        self._inside = dict.fromkeys(self._inside, 0)
        for person, row in present:
            memory = self._memory.get(person) or self._remember(person)
            if row is not None and row.at_rules:
                self._look(person, frame, timestamp_s, row.at_rules, memory)
            if person.confirmed and (memory.events or memory.stays):
                events += self._release(person, memory, timestamp_s)
            for area, state in zip(self._areas, memory.areas, strict=True):
                if state.stay is not None and state.stay.counted:
                    self._inside[area.name] += 1
        for person in gone:
            self._memory.pop(person, None)
        return tuple(sorted(events, key=lambda e: e.timestamp_s))

    def _look(
        self, person: CountedPerson, frame: int, timestamp_s: float, at_rules: tuple[float, ...], memory: _Memory
    ) -> None:
        values = iter(at_rules)
        for wire, at_wire in zip(self._wires, memory.wires, strict=True):
            crossing = at_wire.update(frame, timestamp_s, next(values), next(values))
            if crossing is not None:
                moment = crossing.frame, crossing.timestamp_s
                memory.events.append(Event(*moment, wire.name, "crossing", person.track_id, crossing.direction))
        for area, at_area in zip(self._areas, memory.areas, strict=True):
            before = at_area.stay
            passage = at_area.update(frame, timestamp_s, next(values), next(values))
            if passage is not None:
                moment = passage.frame, passage.timestamp_s
                memory.events.append(Event(*moment, area.name, passage.kind, person.track_id))
            if at_area.stay is not None and before is None:
                memory.stays.append((area.name, at_area.stay))

    def _release(self, person: CountedPerson, memory: _Memory, timestamp_s: float) -> list[Event]:
        """Events of a confirmed person old enough for their rules; stays become counted at the same time."""
        age = timestamp_s - person.start_s
        ready = {wire.name for wire in self._wires if age >= wire.min_age_s}
        ready |= {area.name for area in self._areas if age >= area.min_age_s}
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

    def _remember(self, person: CountedPerson) -> _Memory:
        memory = _Memory([WireState(wire) for wire in self._wires], [AreaState() for _ in self._areas])
        self._memory[person] = memory
        return memory

    def _settled(self, rule: Placed, hysteresis_m: float) -> tuple[str, F64, PlaneName, float, float]:
        """Name, points and plane of a rule, with its own hysteresis and age or those of all rules."""
        margin_m = hysteresis_m if rule.hysteresis_m is None else rule.hysteresis_m
        age_s = self.params.min_age_s if rule.min_age_s is None else rule.min_age_s
        return rule.name, rule.points, rule.plane, margin_m, age_s
