"""From track ids to people: observed positions, and the stitching of a new id to an ended one."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Container, Iterable
from dataclasses import dataclass, field

from planview.analytics.geometry import PlaneName
from planview.analytics.params import AnalyticsParams
from planview.trajectories.state import TrackState

PERSON_M = 1.7
"""Height that a box is taken to show where only boxes are known: it gives metres to pixels [m]."""
_VELOCITY_S = 0.5
"""Sightings of this time give the velocity [s]."""


@dataclass(frozen=True)
class Sighting:
    """The observed position of a person in one frame; NaN where a plane is not known.

    Attributes:
        floor: (x, y) [m].
        image: (u, v) of the foot: middle of the box's lower edge [px].
        metre_px: pixels per metre there.
    """

    frame: int
    timestamp_s: float
    floor: tuple[float, float]
    image: tuple[float, float]
    metre_px: float

    def at(self, plane: PlaneName) -> tuple[float, float, float]:
        """(x, y, units per metre) in a plane."""
        return (*self.floor, 1.0) if plane == "floor" else (*self.image, self.metre_px)

    def metres(self) -> tuple[float, float]:
        """The place in metres, on the floor where known."""
        if math.isfinite(self.floor[0]):
            return self.floor
        return self.image[0] / self.metre_px, self.image[1] / self.metre_px


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

    @property
    def last(self) -> Sighting:
        return self.trail[-1]

    def observe(self, sighting: Sighting) -> None:
        self.trail.append(sighting)
        while len(self.trail) > 2 and sighting.timestamp_s - self.trail[1].timestamp_s >= _VELOCITY_S:
            self.trail.popleft()

    def predicted(self, timestamp_s: float) -> tuple[float, float]:
        """Place at a later time at constant velocity [m]."""
        (x0, y0), (x1, y1) = self.trail[0].metres(), self.last.metres()
        span = self.last.timestamp_s - self.trail[0].timestamp_s
        gain = (timestamp_s - self.last.timestamp_s) / span if span > 0 else 0.0
        return x1 + gain * (x1 - x0), y1 + gain * (y1 - y0)


class CountedPeople:
    """The people present, kept from their tracks frame by frame."""

    def __init__(self, params: AnalyticsParams) -> None:
        self._params = params
        self._of_id: dict[int, CountedPerson] = {}

    def update(
        self, frame: int, timestamp_s: float, tracks: Iterable[TrackState]
    ) -> tuple[list[tuple[CountedPerson, Sighting | None]], list[CountedPerson]]:
        """Take one frame's tracks.

        Returns:
            The people of this frame with their sightings (None when only predicted), and those gone for good.
        """
        sightings = [(track, _sighting(frame, timestamp_s, track)) for track in tracks]
        present: dict[int, tuple[CountedPerson, Sighting | None]] = {}
        for track, sighting in sorted(sightings, key=self._precedence):
            if sighting is None:
                continue
            person = self._of_id.get(track.track_id)
            if person is None:
                person = self._stitched(sighting, present)
            if person is None or id(person) in present:
                person = CountedPerson(track.track_id, timestamp_s)
            self._of_id[track.track_id] = person
            person.track_id, person.present_s = track.track_id, timestamp_s
            person.confirmed |= track.state == "confirmed"
            person.observe(sighting)
            present[id(person)] = person, sighting
        for track, sighting in sightings:
            person = self._of_id.get(track.track_id)
            if sighting is None and person is not None:
                person.present_s = timestamp_s
                present.setdefault(id(person), (person, None))
        return list(present.values()), self._gone(timestamp_s)

    def _precedence(self, observed: tuple[TrackState, Sighting | None]) -> tuple[int, int]:
        """Order of the tracks: the current id of a person, other known ids, new ids.

        So a person observed in this frame is not stitched to a new id, and an old id that comes back after a new one
        took over does not take the person back.
        """
        track_id = observed[0].track_id
        person = self._of_id.get(track_id)
        return (2 if person is None else int(person.track_id != track_id)), track_id

    def all(self) -> list[CountedPerson]:
        """All people that are not gone yet."""
        return list({id(person): person for person in self._of_id.values()}.values())

    def _stitched(self, sighting: Sighting, present: Container[int]) -> CountedPerson | None:
        """The unobserved person predicted nearest to the place of a new track, within stitch_m and stitch_s."""
        x, y = sighting.metres()
        best, nearest = None, self._params.stitch_m
        for person in self.all():
            gap = sighting.timestamp_s - person.last.timestamp_s
            if id(person) in present or not 0 < gap <= self._params.stitch_s:
                continue
            px, py = person.predicted(sighting.timestamp_s)
            distance = math.hypot(x - px, y - py)
            if distance <= nearest:
                best, nearest = person, distance
        return best

    def _gone(self, timestamp_s: float) -> list[CountedPerson]:
        limit = timestamp_s - self._params.stitch_s
        gone = [person for person in self.all() if person.present_s < limit]
        if gone:
            names = {id(person) for person in gone}
            self._of_id = {key: person for key, person in self._of_id.items() if id(person) not in names}
        return gone


def _sighting(frame: int, timestamp_s: float, track: TrackState) -> Sighting | None:
    """Observed position of a track; None for a prediction, or a track without any place."""
    if track.state == "lost":
        return None
    left, top, width, height = track.box_px
    metre_px = height / PERSON_M if height > 0 else math.nan
    sighting = Sighting(frame, timestamp_s, (track.x_m, track.y_m), (left + width / 2, top + height), metre_px)
    return sighting if math.isfinite(sum(sighting.metres())) else None
