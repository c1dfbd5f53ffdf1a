"""Counting frame by frame, alike for a file of tracks and a live run: people pass tripwires and stay in zones."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import numpy as np

from calib.carried import Carried
from calib.types import F64, I64, Bool
from planview.counting.events import Direction, Event, EventKind
from planview.counting.rules import AnalyticsParams, Outline, Placed, PlaneName, Rules
from planview.trajectories.ends import BOX_M, has_ended, is_jump
from planview.trajectories.state import TrackState
from planview.trajectories.table import Trajectories, WordColumn


@dataclass(frozen=True, eq=False)
class TrackPlaces:
    """Rows of tracks: (N,) ids and states, (N, 2) places on the floor [m], and (N, 4) boxes left, top, width, height
    [px]."""

    track_id: I64
    state: WordColumn
    floor_m: F64
    box_px: F64

    @staticmethod
    def of_states(tracks: Sequence[TrackState]) -> TrackPlaces:
        """One frame's tracks."""
        return TrackPlaces(
            np.array([track.track_id for track in tracks], dtype=np.int64),
            np.array([track.state for track in tracks], dtype=np.str_),
            np.array([(track.x_m, track.y_m) for track in tracks], dtype=np.float64).reshape(-1, 2),
            np.array([track.box_px for track in tracks], dtype=np.float64).reshape(-1, 4),
        )

    @staticmethod
    def of_rows(tracks: Trajectories, rows: slice | I64) -> TrackPlaces:
        """Rows of a table."""
        floor_m = np.column_stack([tracks.x_m[rows], tracks.y_m[rows]])
        return TrackPlaces(tracks.track_id[rows], tracks.state[rows], floor_m, tracks.box_px[rows])

    def within(self, plane: PlaneName) -> tuple[F64, F64, F64]:
        """(N,) x and y in a plane and its units per metre there, NaN where unknown: on the floor, or of the foot in the
        image, the middle of the box's lower edge."""
        if plane == "floor":
            return self.floor_m[:, 0], self.floor_m[:, 1], np.ones(len(self.floor_m))
        left, top, width, height = self.box_px.T
        return left + width / 2, top + height, np.where(height > 0, height / BOX_M, np.nan)

    def best(self) -> tuple[F64, F64, F64]:
        """(N,) x, y and units per metre on the floor where that is known, else in the image."""
        is_on_floor = np.isfinite(self.floor_m).all(axis=1)
        x, y, per_m = np.where(is_on_floor, self.within("floor"), self.within("image"))
        return x, y, per_m

    def are_observed(self) -> Bool:
        """(N,) mask of the rows that have a place and are more than a prediction."""
        x, y, per_m = self.best()
        return np.asarray((self.state != "lost") & np.isfinite(x + y + per_m))


class Sight(NamedTuple):
    """A sighting relative to a rule: its distance left of a line or inside a zone, negative on the other side, and its
    place along a line, 0 at its first and 1 at its second point."""

    frame: int
    timestamp_s: float
    inside_m: float
    along: float = 0.0

    def is_opposite(self, later: Sight) -> bool:
        """True if the rule lies between two sightings."""
        return (self.inside_m >= 0) != (later.inside_m >= 0)

    def share_to(self, later: Sight) -> float:
        """The place between two sightings on different sides where the rule is passed, from 0 to 1."""
        return self.inside_m / (self.inside_m - later.inside_m)

    def passing(self, later: Sight) -> tuple[int, float]:
        """The first frame at or after the rule is passed, and the moment."""
        share = self.share_to(later)
        moment = self.timestamp_s + share * (later.timestamp_s - self.timestamp_s)
        return math.ceil(self.frame + share * (later.frame - self.frame)), moment


class Passage(NamedTuple):
    """A rule passed: the first frame at or after the moment, the moment, and which way."""

    frame: int
    timestamp_s: float
    kind: EventKind
    direction: Direction = ""


UNDO_S = 2.0
"""A jump back over the line within this time of a crossing waits as long before it counts [s]."""


class Wire:
    """A tripwire of (2, 2) points; on its sides, a person counts from ``hysteresis_m`` away."""

    def __init__(self, name: str, points: F64, plane: PlaneName, hysteresis_m: float, min_age_s: float) -> None:
        self.name = name
        self.plane = plane
        self.hysteresis_m = hysteresis_m
        self.min_age_s = min_age_s
        self._start: list[float] = points[0].tolist()
        self._length = float(np.hypot(*(points[1] - points[0])))
        self._ahead: list[float] = ((points[1] - points[0]) / self._length).tolist()
        self._left_sign = 1.0 if plane == "floor" else -1.0  # y points down in images

    def new_state(self) -> WireState:
        """A person who has not been seen at the wire."""
        return WireState(self.hysteresis_m, self.min_age_s)

    def locate(self, places: TrackPlaces) -> tuple[F64, F64]:
        """(N,) distance left of the line [m], and place along it from 0 to 1; NaN when not known in this plane."""
        x, y, unit = places.within(self.plane)
        dx = x - self._start[0]
        dy = y - self._start[1]
        ahead = self._ahead[0] * dx + self._ahead[1] * dy
        left = self._left_sign * (self._ahead[0] * dy - self._ahead[1] * dx)
        return left / unit, np.where(np.isfinite(x + y + unit), ahead / self._length, np.nan)


@dataclass(eq=False)
class WireState:
    """One person at one wire.

    The side changes where the person is observed far enough on the other one. That is a crossing if the steps since
    then went through the wire, and not around its end. A crossing in a jump waits: it counts when the person stays, and
    is dropped when the person comes back through the wire, since the jump was an error of measurement then.
    """

    hysteresis_m: float
    min_age_s: float
    last: Sight | None = None
    side: int = 0
    """1 left, -1 right, 0 not yet observed far enough from the line."""
    net: int = 0
    """Steps through the wire since then, 1 to the left, -1 to the right."""
    step: tuple[int, float, bool] = (0, 0.0, False)
    """The last of them: first frame after it, moment, whether nobody walks so fast."""
    crossed_s: float = -math.inf
    waiting: tuple[Passage, float] | None = None
    """A crossing in a jump, and how long it waits [s]."""
    stay: ClassVar[None] = None
    """Nobody stays on a line."""

    def update(self, frame: int, timestamp_s: float, side_m: float, along: float) -> Passage | None:
        """The crossing that is certain now; dated to when the line was passed."""
        if not math.isfinite(along):
            return None
        now = Sight(frame, timestamp_s, side_m, along)
        if self.last is not None:
            self._step_to(self.last, now)
        self.last = now
        crossing = None
        if abs(side_m) >= self.hysteresis_m:
            crossing = self._crossing_to(1 if side_m >= 0 else -1)
        if self.waiting is not None and timestamp_s - self.waiting[0].timestamp_s >= self.waiting[1]:
            crossing = self.waiting[0]
            self.waiting = None
        if crossing is not None:
            self.crossed_s = crossing.timestamp_s
        return crossing

    def _step_to(self, last: Sight, now: Sight) -> None:
        """Remember a step through the wire; beyond the wire's ends its extension is passed, which does not count."""
        if not last.is_opposite(now):
            return
        along = last.along + last.share_to(now) * (now.along - last.along)
        if 0.0 <= along <= 1.0:
            step_s = now.timestamp_s - last.timestamp_s
            self.step = *last.passing(now), bool(is_jump(step_s, abs(now.inside_m - last.inside_m)))
            self.net += 1 if now.inside_m >= 0 else -1

    def _crossing_to(self, side: int) -> Passage | None:
        """The crossing to a side on which the person is now far enough from the line; None where it waits."""
        has_crossed = self.side == -side and self.net * side > 0
        self.side = side
        self.net = 0
        if not has_crossed:
            return None
        if self.waiting is not None:
            self.waiting = None
            return None
        frame, moment, in_jump = self.step
        crossing = Passage(frame, moment, "crossing", "right_to_left" if side > 0 else "left_to_right")
        if not in_jump:
            return crossing
        is_soon = moment - self.crossed_s <= UNDO_S  # then it is likely to undo that crossing
        self.waiting = crossing, UNDO_S if is_soon else self.min_age_s
        return None


@dataclass(eq=False)
class Stay:
    """One person inside, until the last observation so far."""

    start_s: float
    end_s: float
    entered: bool
    """True for a person who came in over the outline, false for a track that began inside."""
    left: bool = False
    """True for a person who went out over the outline, false for a track that ended inside, or is still there."""

    @property
    def dwell_s(self) -> float:
        return self.end_s - self.start_s


class Area:
    """A zone of (N, 2) corners; a person is inside or outside from ``hysteresis_m`` beyond the outline."""

    def __init__(self, name: str, points: F64, plane: PlaneName, hysteresis_m: float, min_age_s: float) -> None:
        self.name = name
        self.plane = plane
        self.min_age_s = min_age_s
        self._outline = Outline(points)
        self._hysteresis_m = hysteresis_m
        # People in the middle of a narrow zone are inside.
        self._margin_limit = 0.25 * self._outline.inner_radius()

    def new_state(self) -> AreaState:
        """A person who has not been seen at the zone."""
        return AreaState()

    def locate(self, places: TrackPlaces) -> tuple[F64, F64]:
        """(N,) depth inside (negative outside) and the margin that decides [m]; NaN when not known in this plane."""
        x, y, unit = places.within(self.plane)
        margin = np.minimum(self._hysteresis_m, self._margin_limit / unit)
        is_known = np.isfinite(x + y + unit)
        return self._outline.depth(x, y) / unit, np.where(is_known, margin, np.nan)


@dataclass(eq=False)
class AreaState:
    """One person at one zone. ``stay`` is the current one, None outside."""

    last: Sight | None = None
    passed: tuple[int, float] = (0, 0.0)
    stay: Stay | None = None

    def update(self, frame: int, timestamp_s: float, depth_m: float, margin_m: float) -> Passage | None:
        """An entry or exit once the person is far enough in or out, dated to when the outline was passed."""
        if not math.isfinite(margin_m):
            return None
        now = Sight(frame, timestamp_s, depth_m)
        before = self.last
        self.last = now
        if before is not None and before.is_opposite(now):
            self.passed = before.passing(now)
        if self.stay is None:
            if before is None and depth_m >= 0:
                self.stay = Stay(timestamp_s, timestamp_s, entered=False)
            elif depth_m >= margin_m:
                self.stay = Stay(self.passed[1], timestamp_s, entered=True)
                return Passage(*self.passed, "entry")
            return None
        if depth_m <= -margin_m and depth_m < 0:
            self.stay.end_s = self.passed[1]
            self.stay.left = True
            self.stay = None
            return Passage(*self.passed, "exit")
        self.stay.end_s = timestamp_s
        return None


class TrackRow(NamedTuple):
    """One track in one frame: its place and units per metre (``TrackPlaces.best``), and two numbers per rule, as
    ``Wire.locate`` and ``Area.locate`` give them."""

    track_id: int
    confirmed: bool
    observed: bool
    x: float
    y: float
    per_m: float
    at_rules: tuple[float, ...]


class Seen(NamedTuple):
    """A place where a person was seen."""

    timestamp_s: float
    x: float
    y: float
    per_m: float


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
    trail: deque[Seen] = field(default_factory=deque)
    """The last sightings, newest last."""
    events: list[Event] = field(default_factory=list)
    """These wait until the person is old enough for their rule, as do ``stays``."""
    stays: list[tuple[str, Stay]] = field(default_factory=list)
    visited: set[str] = field(default_factory=set)
    """Rules at which the person is counted already."""

    def observe(self, timestamp_s: float, row: TrackRow) -> None:
        """Take the row of a frame."""
        self.track_id = row.track_id
        self.present_s = timestamp_s
        self.row = row
        if row.confirmed and self.confirmed_s is None:
            self.confirmed_s = timestamp_s
        self.trail.append(Seen(timestamp_s, row.x, row.y, row.per_m))
        # Sightings of half a second give the velocity.
        while len(self.trail) > 2 and timestamp_s - self.trail[1].timestamp_s >= 0.5:
            self.trail.popleft()

    def has_ended(self, timestamp_s: float, row: TrackRow) -> bool:
        """True if a row of the same id begins another track."""
        last = self.trail[-1]
        moved_m = _apart_m(last, row.x - last.x, row.y - last.y, row)
        return bool(has_ended(timestamp_s - self.present_s, timestamp_s - last.timestamp_s, moved_m))

    def away_m(self, timestamp_s: float, row: TrackRow) -> float:
        """Distance of a row from where the person would be then at constant velocity [m]."""
        first = self.trail[0]
        last = self.trail[-1]
        span_s = last.timestamp_s - first.timestamp_s
        gain = (timestamp_s - last.timestamp_s) / span_s if span_s > 0 else 0.0
        x = last.x + gain * (last.x - first.x)
        y = last.y + gain * (last.y - first.y)
        return _apart_m(last, row.x - x, row.y - y, row)


def _apart_m(seen: Seen, dx: float, dy: float, row: TrackRow) -> float:
    """A distance in metres; 0 between the floor and the image, where none is known."""
    if (seen.per_m == 1.0) != (row.per_m == 1.0):
        return 0.0
    return math.hypot(dx, dy) / max(seen.per_m, row.per_m)


class Analytics(Carried):
    """Tripwires and zones over tracks.

    Call ``update`` once per frame, in order; afterwards ``stays`` and the events returned hold everything
    (``planview.counting.totals``). ``people`` has each person once per rule and visit, however often it is crossed.
    """

    CARRIED = "_of_id", "_ended", "stays", "people"
    RECORDS = CountedPerson, WireState, AreaState, Sight, Seen, Passage, Event, Stay, TrackRow

    def __init__(self, rules: Rules, params: AnalyticsParams | None = None) -> None:
        self.rules = rules
        self.params = params or AnalyticsParams()
        self._rules: list[Wire | Area] = []
        for wire in rules.tripwires:
            points = wire.points if wire.counted is None else wire.counted
            limits = self._limits(wire, self.params.hysteresis_m)
            self._rules.append(Wire(wire.name, points, wire.plane, *limits))
        for zone in rules.zones:
            limits = self._limits(zone, self.params.zone_hysteresis_m)
            self._rules.append(Area(zone.name, zone.points, zone.plane, *limits))
        self.reset()

    def _limits(self, rule: Placed, hysteresis_m: float) -> tuple[float, float]:
        """A rule's own hysteresis and age, or those of all rules."""
        margin_m = hysteresis_m if rule.hysteresis_m is None else rule.hysteresis_m
        age_s = self.params.min_age_s if rule.min_age_s is None else rule.min_age_s
        return margin_m, age_s

    def reset(self) -> None:
        """Forget everybody."""
        self._of_id: dict[int, CountedPerson] = {}
        self._ended: list[CountedPerson] = []  # whose id is used again, or no more
        self.stays: dict[str, list[Stay]] = {zone.name: [] for zone in self.rules.zones}
        self.people: dict[str, int] = dict.fromkeys((rule.name for rule in self._rules), 0)

    def update(self, frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> tuple[Event, ...]:
        """Take one frame's tracks and return the events that have become certain, by time.

        An event is dated to its moment, which lies before this frame by the time that the hysteresis and the age took.
        """
        return self.update_rows(frame, timestamp_s, self.rows(TrackPlaces.of_states(tracks)))

    def rows(self, places: TrackPlaces) -> list[TrackRow]:
        """Rows of tracks, of any number of frames, with where they are at every rule."""
        at_rules = []
        for rule in self._rules:
            at_rules += [column.tolist() for column in rule.locate(places)]
        columns = (places.track_id, places.state == "confirmed", places.are_observed(), *places.best())
        lists = [column.tolist() for column in columns]
        return list(map(TrackRow, *lists, zip(*at_rules, strict=True)))

    def update_rows(self, frame: int, timestamp_s: float, rows: Sequence[TrackRow]) -> tuple[Event, ...]:
        """``update`` with rows of the frame as ``rows`` gives them."""
        events: list[Event] = []
        for person in self._present(timestamp_s, rows):
            if person.row is not None:
                self._apply_rules(frame, timestamp_s, person, iter(person.row.at_rules))
            if person.confirmed_s is not None and (person.events or person.stays):
                events += self._release(person, timestamp_s - person.confirmed_s)
        return tuple(sorted(events, key=lambda event: event.timestamp_s))

    def _apply_rules(self, frame: int, timestamp_s: float, person: CountedPerson, at_rules: Iterator[float]) -> None:
        """Take where a person is at every rule in this frame."""
        for rule, state in zip(self._rules, person.states, strict=True):
            before = state.stay
            passage = state.update(frame, timestamp_s, next(at_rules), next(at_rules))
            if passage is not None:
                first, moment, kind, way = passage
                person.events.append(Event(first, moment, rule.name, kind, person.track_id, way))
            if state.stay is not None and before is None:
                person.stays.append((rule.name, state.stay))

    def _present(self, timestamp_s: float, rows: Sequence[TrackRow]) -> list[CountedPerson]:
        """The people of the next frame."""
        self._forget(timestamp_s)
        present: dict[CountedPerson, None] = {}

        def precedence(row: TrackRow) -> tuple[int, int]:
            # The current id of a person, other known ids, new ids: so a person observed in this frame is not stitched
            # to a new id, and an old id that comes back after a new one took over does not take the person back.
            person = self._of_id.get(row.track_id)
            return (2 if person is None else int(person.track_id != row.track_id)), row.track_id

        for row in sorted([row for row in rows if row.observed], key=precedence):
            person = self._person_of(timestamp_s, row, present)
            self._of_id[row.track_id] = person
            person.observe(timestamp_s, row)
            present[person] = None
        for row in rows:
            hidden = None if row.observed else self._of_id.get(row.track_id)
            if hidden is not None and hidden not in present:
                hidden.present_s = timestamp_s
                hidden.row = None
                present[hidden] = None
        return list(present)

    def _forget(self, timestamp_s: float) -> None:
        """Let tracks end that have had no row for long, and forget those that no other track can continue."""
        for track_id, person in list(self._of_id.items()):
            if has_ended(timestamp_s - person.present_s):
                self._ended.append(self._of_id.pop(track_id))
        earliest_s = timestamp_s - self.params.stitch_s
        self._ended = [person for person in self._ended if person.present_s >= earliest_s]

    def _person_of(self, timestamp_s: float, row: TrackRow, present: Container[CountedPerson]) -> CountedPerson:
        """The person of a row: with its id, or who walked to its place under another id, or somebody new."""
        person = self._of_id.get(row.track_id)
        if person is not None and person not in present and person.has_ended(timestamp_s, row):
            self._ended.append(self._of_id.pop(row.track_id))
            person = None
        if person is None:
            person = self._predecessor(timestamp_s, row, present)
        if person is None or person in present:
            person = CountedPerson(row.track_id, [rule.new_state() for rule in self._rules])
        return person

    def _predecessor(
        self, timestamp_s: float, row: TrackRow, present: Container[CountedPerson]
    ) -> CountedPerson | None:
        """The unobserved person predicted nearest to the place of a new track, within stitch_m and stitch_s."""
        best = None
        nearest_m = self.params.stitch_m
        for person in dict.fromkeys([*self._of_id.values(), *self._ended]):
            gap_s = timestamp_s - person.trail[-1].timestamp_s
            if person in present or not 0 < gap_s <= self.params.stitch_s:
                continue
            away_m = person.away_m(timestamp_s, row)
            if away_m <= nearest_m:
                best = person
                nearest_m = away_m
        return best

    def _release(self, person: CountedPerson, age_s: float) -> list[Event]:
        """Events of a confirmed person old enough for their rules; stays count from the same time."""
        ready = {rule.name for rule in self._rules if age_s >= rule.min_age_s}
        released: list[Event] = []
        for event in person.events:
            if event.rule in ready:
                released.append(event if event.track_id > 0 else replace(event, track_id=person.track_id))
        visited = {event.rule for event in released}
        for name, stay in person.stays:
            if name in ready:
                self.stays[name].append(stay)
                visited.add(name)
        for name in visited - person.visited:
            self.people[name] += 1
        person.visited |= visited
        person.stays = [(name, stay) for name, stay in person.stays if name not in ready]
        person.events = [event for event in person.events if event.rule not in ready]
        return released
