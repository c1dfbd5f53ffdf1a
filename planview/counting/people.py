"""From track ids to people: observed positions, and the stitching of a new id to an ended one."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Container, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from planview.counting.params import AnalyticsParams

VELOCITY_S = 0.5
"""Sightings of this time give the velocity [s]."""


class TrackRow(NamedTuple):
    """One track in one frame.

    Attributes:
        observed: whether it has a place and is more than a prediction.
        x_m, y_m: the place in metres.
        at_rules: two numbers per rule, as ``Wire.locate`` and ``Area.locate`` give them; empty where nothing changes.
    """

    track_id: int
    confirmed: bool
    observed: bool
    x_m: float
    y_m: float
    at_rules: tuple[float, ...]


class Sighting(NamedTuple):
    """When and where a person was observed [s], [m]."""

    timestamp_s: float
    x_m: float
    y_m: float


@dataclass(eq=False)
class CountedPerson:
    """One or more track ids that are the same person.

    Attributes:
        track_id: the last id.
        start_s: time of the first sighting [s].
        confirmed: whether any of the ids was confirmed.
        present_s: time of the last row, predictions included [s].
        trail: the last sightings, newest last.
    """

    track_id: int
    start_s: float
    confirmed: bool = False
    present_s: float = 0.0
    trail: deque[Sighting] = field(default_factory=deque)

    def observe(self, sighting: Sighting) -> None:
        trail, moment = self.trail, sighting.timestamp_s
        trail.append(sighting)
        while len(trail) > 2 and moment - trail[1].timestamp_s >= VELOCITY_S:
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
        """Take one frame's rows.

        Returns:
            The people of this frame, and those gone for good.
        """
        present: dict[CountedPerson, PresentPerson] = {}
        of_id = self._of_id
        for row in sorted([row for row in rows if row.observed], key=self._precedence):
            person = of_id.get(row.track_id)
            if person is None:
                person = self._stitched(timestamp_s, row, present)
            if person is None or person in present:
                person = CountedPerson(row.track_id, timestamp_s)
            of_id[row.track_id] = person
            person.track_id, person.present_s = row.track_id, timestamp_s
            person.confirmed |= row.confirmed
            person.observe(Sighting(timestamp_s, row.x_m, row.y_m))
            present[person] = PresentPerson(person, row)
        for row in rows:
            person = None if row.observed else of_id.get(row.track_id)
            if person is not None:
                person.present_s = timestamp_s
                present.setdefault(person, PresentPerson(person, None))
        return list(present.values()), self._gone(timestamp_s)

    def _precedence(self, row: TrackRow) -> tuple[int, int]:
        """Order of the tracks: the current id of a person, other known ids, new ids.

        So a person observed in this frame is not stitched to a new id, and an old id that comes back after a new one
        took over does not take the person back.
        """
        person = self._of_id.get(row.track_id)
        return (2 if person is None else int(person.track_id != row.track_id)), row.track_id

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

    def _gone(self, timestamp_s: float) -> list[CountedPerson]:
        limit = timestamp_s - self._params.stitch_s
        gone = {person: None for person in self._of_id.values() if person.present_s < limit}
        if gone:
            self._of_id = {key: person for key, person in self._of_id.items() if person not in gone}
        return list(gone)
