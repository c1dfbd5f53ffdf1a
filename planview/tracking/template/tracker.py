"""The tracker: predict, match, locate, adapt, detect, retire."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F32
from planview.maps.builder import PlanViewMaps, Viewpoint
from planview.maps.grid import Grid
from planview.tracking.base import Decision, DecisionKind, Drawing, Observation, TrackerDebug
from planview.tracking.body_axis import AxisMeasurement, BodyAxis
from planview.tracking.detection import Candidate, NewPeople, inseparable
from planview.tracking.kalman import FloorKalman
from planview.tracking.template.matching import match_people
from planview.tracking.template.params import TemplateTrackerParams
from planview.tracking.template.state import Frame, Person
from planview.tracking.template.templates import blend, nearest_peak, renew, slipped
from planview.trajectories.state import TrackState


class TemplateTracker:
    """Tracks people in plan-view maps of height and occupancy.

    Each frame: predict everybody; match the most certain first (eq. 4) and clear the maps under him; locate heads and
    body axes; adapt templates and re-center slipped ones; look for new people in what is left, who may be lost ones;
    retire who is gone.
    """

    def __init__(self, params: TemplateTrackerParams | None = None, height_max_m: float = 2.4) -> None:
        self.params = params or TemplateTrackerParams()
        self._height_max_m = height_max_m
        self.reset()

    def reset(self) -> None:
        """Forget everybody; ids start again at 1."""
        self._people: list[Person] = []
        self._decisions: list[Decision] = []
        self._next_id = 1
        self._time_s = math.nan
        self._grid: Grid | None = None

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return tuple(self._decisions)

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame.

        Args:
            observation: with maps.
        Raises:
            ValueError: no maps, or time does not advance.
        """
        maps = observation.maps
        if maps is None:
            raise ValueError("expected an observation with plan-view maps, got none (this tracker needs stereo)")
        dt = observation.timestamp_s - self._time_s if self._people else 0.0
        if dt < 0:
            raise ValueError(f"expected time to advance, got {observation.timestamp_s} s after {self._time_s} s")
        self._time_s, self._grid, self._decisions = observation.timestamp_s, maps.grid, []
        frame = Frame(maps, self._template_size(maps.grid) // 2)
        axis = BodyAxis(maps.view.camera_m, self._height_max_m, self.params.axis)
        self._predict(dt)
        match_people(frame, self._people, self.params, self._height_max_m)
        self._judge()
        self._locate(maps, axis, dt)
        self._adapt(frame, dt)
        self._confirm(frame)
        self._detect(frame, axis)
        self._retire(maps.view)
        return tuple(_state(person) for person in self._people)

    def _predict(self, dt: float) -> None:
        p = self.params
        for person in self._people:
            kalman, axis = person.kalman, person.axis
            if person.state == "lost":
                kalman, axis = kalman.slowed(dt, p.slow_down_s), axis.slowed(dt, p.slow_down_s)
            person.kalman = kalman.predicted(dt, p.acceleration_std_mps2)
            person.axis = axis.predicted(dt, p.acceleration_std_mps2)

    def _judge(self) -> None:
        """Who was found, who was lost."""
        for person in self._people:
            if not person.matched:
                if person.state == "confirmed":
                    person.state = "lost"
                    self._decide(person, "lost", f"nothing like him within {person.reach_cells} cells", person.score)
                continue
            person.seen_s = self._time_s
            if person.state == "lost":
                person.state = "confirmed"
                self._decide(
                    person, "reacquired", f"seen again where predicted, score {person.score:.2f}", person.score
                )
            else:
                self._decide(person, "matched", f"score {person.score:.2f}", person.score)

    def _locate(self, maps: PlanViewMaps, axis: BodyAxis, dt: float) -> None:
        """Measure heads and update the filters.

        The position measured is that of the head's visible surface where it is where the template says, else the
        template's: in a group, templates slip between bodies before heads do.
        """
        found = [person for person in self._people if person.matched]
        where = np.array([person.at_m for person in found]).reshape(-1, 2)
        for person, measured in zip(found, axis(maps.points, where, self._reach_m()), strict=True):
            if self._trusted(person, measured):
                person.at_m = measured.seen_m
                person.offset_m = (measured.x_m - measured.seen_m[0], measured.y_m - measured.seen_m[1])
            self._update(person, measured, dt)
            person.too_low = measured.height_m < self.params.detection.height_min_m - self.params.sway_m

    def _trusted(self, person: Person, measured: AxisMeasurement) -> bool:
        if not measured.from_head:
            return False
        apart = math.hypot(measured.seen_m[0] - person.at_m[0], measured.seen_m[1] - person.at_m[1])
        grown = measured.height_m > person.tallest_m + self.params.grow_max_m
        return apart <= self.params.head_reach_m and not grown

    def _update(self, person: Person, measured: AxisMeasurement, dt: float) -> None:
        p, (x, y) = self.params, person.at_m
        # A body that is being hidden seems to move towards what hides it: the worse the match, the less it counts.
        std = p.position_std_m * max(1.0, person.score / p.score_good) ** 2
        person.kalman = person.kalman.updated(x, y, std)
        person.axis = person.axis.updated(x + person.offset_m[0], y + person.offset_m[1], std)
        if not math.isnan(measured.height_m):
            # What hides a head, or cuts it off at the border, makes somebody look lower, hardly ever taller.
            rising = measured.height_m > person.height_m
            keep = math.exp(-dt / (p.height_rise_s if rising else p.height_time_s))
            person.height_m = keep * person.height_m + (1 - keep) * measured.height_m
            person.tallest_m = max(person.tallest_m, person.height_m)

    def _adapt(self, frame: Frame, dt: float) -> None:
        """Blend templates of everybody found, then re-center the slipped ones; velocity and covariance stay."""
        found = [person for person in self._people if person.matched]
        people = frame.padded_cells([person.at_m for person in found])
        gain = 1.0 - math.exp(-dt / self.params.template_time_s)
        for i, person in enumerate(found):
            why = slipped(*blend(frame, person, people, i, gain), self.params)
            peak = nearest_peak(frame, person, people, i) if why else None
            if peak is None:
                continue
            moved = math.hypot(peak[0] - person.at_m[0], peak[1] - person.at_m[1])
            if moved < frame.maps.grid.cell_m:
                continue
            person.kalman, person.at_m = person.kalman.moved_to(*peak), peak
            people[i] = frame.padded_cells([peak])[0]
            blend(frame, person, people, i, 1.0)
            self._decide(person, "recentred", f"by {moved:.2f} m: {why}", moved)

    def _confirm(self, frame: Frame) -> None:
        """Believe who was tracked long enough, unless he may be a part of somebody known, or what he carries."""
        known = [person for person in self._people if person.state == "confirmed" and person.matched]
        for person in self._people:
            age = self._time_s - person.born_s
            if person.state != "tentative" or not person.matched or age < self.params.confirm_s - 1e-9:
                continue
            if any(self._piece_of(frame, person, other) for other in known) or self._put_down(person):
                continue
            person.state = "confirmed"
            known.append(person)
            self._decide(person, "confirmed", f"tracked for {age:.2f} s without a miss")

    def _put_down(self, person: Person) -> bool:
        """As low as somebody seated, and never moved since it appeared: people come walking, things are put down."""
        moved = math.hypot(person.at_m[0] - person.born_m[0], person.at_m[1] - person.born_m[1])
        return person.height_m < self.params.seated_m and moved < self.params.moved_m

    def _piece_of(self, frame: Frame, person: Person, other: Person) -> bool:
        """Not to be told apart from another, or within his reach and much smaller."""
        view, p = frame.maps.view, self.params
        if inseparable(view, person.at_m, other.at_m, p.ghost_m):
            return True
        # What is carried is held below the shoulders, and may be as large as a parcel.
        low = person.height_m < p.shoulder * other.height_m
        limit = p.parcel_area if low else p.piece_area
        small = self._seen_area(frame, person) < limit * self._seen_area(frame, other)
        return small and inseparable(view, person.at_m, other.at_m, p.arm_m)

    def _seen_area(self, frame: Frame, person: Person) -> float:
        """Visible surface within W_avg around a person [m^2]."""
        grid = frame.maps.grid
        row, col = (round(i) for i in grid.index_of(*person.at_m))
        half = round(self.params.width_m / 2 / grid.cell_m)
        rows, cols = slice(max(0, row - half), row + half + 1), slice(max(0, col - half), col + half + 1)
        return float(frame.maps.occupancy[rows, cols].sum())

    def _detect(self, frame: Frame, axis: BodyAxis) -> None:
        """New people in what is left of the maps: parts of somebody known, somebody lost, or somebody new."""
        finder = NewPeople(self.params.detection, axis, self.params.width_m)
        known = [person for person in self._people if person.matched]
        taken = [person.at_m for person in known]
        free = frame.free_height[frame.inner], frame.free_occupancy[frame.inner]
        for candidate in finder(frame.maps, *free, taken):
            lost = self._lost_match(candidate)
            if candidate.part_of is not None:
                self._draw_to(frame, known[candidate.part_of], candidate)
            elif lost is not None:
                self._reattach(frame, lost, candidate)
            else:
                self._born(frame, candidate)

    def _draw_to(self, frame: Frame, person: Person, candidate: Candidate) -> None:
        """Re-center on the main part of a body whose template holds a minor one.

        A far body's depth may fall into two clumps; the template has no reason of its own to leave the smaller.
        """
        if candidate.area_m2 < self.params.recentre_mass * self._seen_area(frame, person):
            return
        moved = math.hypot(candidate.x_m - person.at_m[0], candidate.y_m - person.at_m[1])
        person.jump(person.kalman.moved_to(candidate.x_m, candidate.y_m))
        renew(frame, person, [q for q in self._people if q.matched])
        self._decide(person, "recentred", f"by {moved:.2f} m: {candidate.area_m2:.2f} m2 seen there", moved)

    def _lost_match(self, candidate: Candidate) -> Person | None:
        """The lost person whom a newcomer continues best: near where he was seen or predicted, and no taller."""
        p, best, best_cost = self.params, None, math.inf
        for person in self._people:
            if person.state != "lost" or candidate.height_m > person.tallest_m + p.grow_max_m:
                continue
            distance = min(
                math.hypot(candidate.x_m - person.kalman.x_m, candidate.y_m - person.kalman.y_m),
                math.hypot(candidate.x_m - person.at_m[0], candidate.y_m - person.at_m[1]),
            )
            cost = distance / p.reattach_m + abs(candidate.height_m - person.height_m)
            reach_m = p.reach_m + p.speed_max_mps * (self._time_s - person.seen_s)
            if distance <= min(p.reattach_m, reach_m) and cost < best_cost:
                best, best_cost = person, cost
        return best

    def _born(self, frame: Frame, candidate: Candidate) -> None:
        n = self._template_size(frame.maps.grid)
        blank = np.zeros((n, n), dtype=np.float32)
        kalman = self._standing(candidate)
        person = Person(
            self._next_id, kalman, kalman, blank, blank.copy(), (candidate.x_m, candidate.y_m),
            (candidate.x_m, candidate.y_m), self._time_s, self._time_s, candidate.height_m, candidate.height_m,
        )  # fmt: skip
        self._next_id += 1
        self._people.append(person)
        self._settle(frame, person, candidate)
        seen = f"{candidate.height_m:.2f} m tall, {candidate.area_m2:.2f} m2 seen"
        self._decide(person, "spawned", seen, candidate.area_m2)

    def _reattach(self, frame: Frame, person: Person, candidate: Candidate) -> None:
        away = math.hypot(candidate.x_m - person.kalman.x_m, candidate.y_m - person.kalman.y_m)
        gone = self._time_s - person.seen_s
        person.jump(self._standing(candidate))
        person.seen_s, person.matched = self._time_s, True
        person.state, person.height_m = "confirmed", candidate.height_m
        self._settle(frame, person, candidate)
        self._decide(person, "reacquired", f"found {away:.2f} m from the prediction after {gone:.1f} s", away)

    def _settle(self, frame: Frame, person: Person, candidate: Candidate) -> None:
        """Templates and body axis at a candidate's place."""
        renew(frame, person, [q for q in self._people if q.matched])
        axis_x, axis_y = candidate.axis_m
        person.offset_m = (axis_x - candidate.x_m, axis_y - candidate.y_m)
        person.axis = person.kalman.moved_to(axis_x, axis_y)

    def _standing(self, candidate: Candidate) -> FloorKalman:
        p = self.params
        return FloorKalman.at(candidate.x_m, candidate.y_m, p.position_std_m, p.speed_std_mps)

    def _retire(self, view: Viewpoint) -> None:
        keep = []
        for person in self._people:
            gone = self._time_s - person.seen_s
            left = gone > self.params.left_s and self._at_border(person, view)
            if person.state == "tentative" and not person.matched:
                self._decide(person, "pruned", "missed before he was confirmed")
            elif person.state == "tentative" and person.too_low:
                self._decide(person, "pruned", "too low for a person before he was confirmed")
            elif person.state == "lost" and (left or gone > self.params.lost_s):
                why = "left the view" if left else "lost"
                self._decide(person, "pruned", f"{why} for {gone:.1f} s", gone)
            else:
                keep.append(person)
        self._people = keep

    def _at_border(self, person: Person, view: Viewpoint) -> bool:
        """Predicted head, give or take a torso, outside of the image."""
        r = self.params.width_m
        x, y, z = person.kalman.x_m, person.kalman.y_m, person.height_m
        return not all(view.sees(x + dx, y + dy, z) for dx, dy in ((-r, 0.0), (r, 0.0), (0.0, -r), (0.0, r)))

    def _template_size(self, grid: Grid) -> int:
        """2 W_avg in cells, odd, so that a template has a central cell."""
        return 2 * max(1, round(self.params.width_m / grid.cell_m)) + 1

    def _reach_m(self) -> float:
        return 1.25 * self.params.width_m

    def _decide(self, person: Person, kind: DecisionKind, reason: str, value: float = math.nan) -> None:
        self._decisions.append(Decision(person.track_id, kind, reason, value))

    def debug(self) -> TrackerDebug:
        """Search rectangles, templates' outlines and the templates themselves."""
        if self._grid is None:
            return TrackerDebug()
        searches, outlines, labels = [], [], []
        tiles: dict[str, F32] = {}
        for person in self._people:
            searches.append(_square(*person.searched_m, (person.reach_cells + 0.5) * self._grid.cell_m))
            outlines.append(_square(person.kalman.x_m, person.kalman.y_m, self.params.width_m))
            labels.append(f"{person.track_id}: {person.score:.2f}")
            tiles[f"template/{person.track_id}/height"] = person.template_height.copy()
            tiles[f"template/{person.track_id}/occupancy"] = person.template_occupancy.copy()
        drawings = (
            Drawing("search", "floor", tuple(searches)),
            Drawing("template", "floor", tuple(outlines), tuple(labels)),
        )
        return TrackerDebug(drawings, dict(tiles))


def _state(person: Person) -> TrackState:
    a = person.axis
    return TrackState(person.track_id, person.state, a.x_m, a.y_m, a.vx_mps, a.vy_mps, person.height_m)


def _square(x: float, y: float, half: float) -> F32:
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    return np.array([(x + half * i, y + half * j) for i, j in corners], dtype=np.float32)
