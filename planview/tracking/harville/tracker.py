"""The tracker: predict, match, locate, adapt, judge identities, detect, prune."""

from __future__ import annotations

import math

import numpy as np

from planview.maps.builder import PlanViewMaps, Viewpoint
from planview.maps.grid import Grid
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.body_axis import AxisMeasurement, BodyAxis
from planview.tracking.detection import PersonCandidate, PersonDetector, inseparable
from planview.tracking.harville.drawing import draw
from planview.tracking.harville.identities import HEAD_ROOM_M, Identities
from planview.tracking.harville.matching import JointMatcher
from planview.tracking.harville.params import TemplateTrackerParams
from planview.tracking.harville.separate import Separate, small_beside
from planview.tracking.harville.state import TemplateFrame, TemplatePerson
from planview.tracking.harville.templates import blend, nearest_peak, renew, slipped
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import LifeCycle
from planview.trajectories.state import TrackState

UNLIKELY_MAX = 4.6
"""Negative log-likelihood from which on a newcomer is not a lost person: one in a hundred."""


class TemplateTracker:
    """Tracks people in plan-view maps of height and occupancy.

    Each frame: predict all people; match (eq. 4), people in contact jointly, and clear the maps under those found;
    locate heads and body axes; adapt templates and re-center slipped ones; mend exchanged identities; look for
    newcomers in what is left, who may be lost people; prune who is gone.
    """

    def __init__(self, params: TemplateTrackerParams | None = None, height_max_m: float = 2.4) -> None:
        self.params = params or TemplateTrackerParams()
        self._height_max_m = height_max_m
        self._life = LifeCycle()
        self._identities = Identities(self.params, self._life)
        self.reset()

    def reset(self) -> None:
        """Forget all people; ids start again at 1."""
        self._people: list[TemplatePerson] = []
        self._grid: Grid | None = None
        self._life.reset()
        self._identities.reset()

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._life.decisions

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame.

        Args:
            observation: with maps.
        Raises:
            ValueError: no maps, or time does not advance.
        """
        maps, before_s = observation.maps, self._life.now_s
        if maps is None:
            raise ValueError("expected an observation with plan-view maps, got none (this tracker needs stereo)")
        dt = observation.timestamp_s - before_s if self._people else 0.0
        if dt < 0:
            raise ValueError(f"expected time to advance, got {observation.timestamp_s} s after {before_s} s")
        self._life.begin(observation.timestamp_s)
        self._grid = maps.grid
        frame = TemplateFrame(maps, self._template_size(maps.grid) // 2)
        axis = BodyAxis(maps.view, self._height_max_m, self.params.axis)
        self._predict(dt)
        self._match(frame)
        self._locate(maps, axis, dt)
        self._adapt(frame, dt)
        self._confirm(frame)
        self._detect(frame, axis)
        self._identities.update(maps, self._people)
        self._prune()
        return tuple(_state(person) for person in self._people)

    def _predict(self, dt: float) -> None:
        p = self.params
        for person in self._people:
            kalman, axis = person.kalman, person.axis
            if person.lost:
                kalman, axis = kalman.slowed(dt, p.slow_down_s), axis.slowed(dt, p.slow_down_s)
            person.kalman = kalman.predicted(dt, p.acceleration_std_mps2)
            person.axis = axis.predicted(dt, p.acceleration_std_mps2)

    def _match(self, frame: TemplateFrame) -> None:
        searched = [person for person in self._people if not self._has_left(person, frame.maps.view)]
        found = JointMatcher(frame, searched, self.params, self._height_max_m)()
        for person in self._people:
            score = f"score {person.score:.2f}"
            if person in found:
                why = f"matched where predicted, {score}" if person.lost else score
                self._life.observe(person.existence, why, person.score, person.terms)
            elif not person.lost:
                why = f"nothing like the templates within {person.reach_cells} cells, {score}"
                self._life.miss(person.existence, why, person.score, person.terms)

    def _locate(self, maps: PlanViewMaps, axis: BodyAxis, dt: float) -> None:
        """Measure heads and update the filters.

        The position measured is that of the head's visible surface where it is where the template says, else the
        template's: in a group, templates slip between bodies before heads do.
        """
        found = [person for person in self._people if person.observed]
        where = np.array([person.at_m for person in found]).reshape(-1, 2)
        for person, measured in zip(found, axis(maps.points, where, self.params.reach_m), strict=True):
            person.head = self._trusted(person, measured)
            if person.head:
                person.at_m = measured.visible_m
                person.offset_m = (measured.x_m - measured.visible_m[0], measured.y_m - measured.visible_m[1])
            self._update(person, measured, maps.view, dt)
            person.too_low = measured.height_m < self.params.detection.height_min_m - 0.1

    def _trusted(self, person: TemplatePerson, measured: AxisMeasurement) -> bool:
        if not measured.from_head:
            return False
        apart = math.hypot(measured.visible_m[0] - person.at_m[0], measured.visible_m[1] - person.at_m[1])
        grown = measured.height_m > person.tallest_m + self.params.grow_max_m
        return apart <= self.params.head_reach_m and not grown

    def _update(self, person: TemplatePerson, measured: AxisMeasurement, view: Viewpoint, dt: float) -> None:
        p, (x, y) = self.params, person.at_m
        std = p.position_std_m * max(1.0, 2 * person.score / p.match.score_max) ** 2
        person.kalman = person.kalman.updated(x, y, std)
        person.axis = person.axis.updated(x + person.offset_m[0], y + person.offset_m[1], std)
        if not math.isnan(measured.height_m) and view.sees(x, y, measured.height_m + HEAD_ROOM_M):
            person.head_in_view = True
            # What hides a head makes a person look lower, hardly ever taller.
            rising = measured.height_m > person.height_m
            keep = math.exp(-dt / (p.height_time_s / 3 if rising else p.height_time_s))
            person.height_m = keep * person.height_m + (1 - keep) * measured.height_m
            person.tallest_m = max(person.tallest_m, person.height_m)

    def _adapt(self, frame: TemplateFrame, dt: float) -> None:
        """Blend templates of all people found, then re-center the slipped ones; velocity and covariance stay."""
        found = [person for person in self._people if person.observed]
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
            self._life.log(person.existence, "recentred", f"by {moved:.2f} m: {why}", moved)

    def _confirm(self, frame: TemplateFrame) -> None:
        """Confirm who was tracked long enough and is a body of its own."""
        p, separate = self.params, Separate(frame.maps, self.params, self._life.now_s)
        known = [person for person in self._people if person.confirmed and person.observed]
        for person in list(self._people):
            age = self._life.age_s(person.existence)
            if person.confirmed or not person.observed or age < p.confirm_s - 1e-9:
                continue
            if not separate(person, known) or self._life.now_s - person.alone_s < p.confirm_s - 1e-9:
                continue
            if age < p.confirm_s + p.recognise_s and self._identities.undecided(person, self._people):
                continue
            known.append(person)
            replaced = self._identities.known_as(person, self._people)
            if replaced is not None:
                self._life.prune(replaced.existence, f"the person is tracked as {person.existence.track_id}")
                self._people.remove(replaced)
            self._life.confirm(person.existence, f"tracked for {age:.2f} s without a miss")

    def _detect(self, frame: TemplateFrame, axis: BodyAxis) -> None:
        """Newcomers in what is left of the maps: parts of a person, lost people, or new ones."""
        finder = PersonDetector(self.params.detection, axis, self.params.width_m)
        known = [person for person in self._people if person.observed]
        free = frame.free_height[frame.inner], frame.free_occupancy[frame.inner]
        lost = [person.at_m for person in self._people if person.lost]
        for candidate in finder(frame.maps, *free, [person.at_m for person in known], lost):
            if candidate.part_of is not None:
                continue
            person = self._lost_match(frame, candidate)
            if person is not None:
                self._reacquire(frame, person, candidate)
            elif not candidate.low and not small_beside(candidate, self._people, self.params):
                self._spawn(frame, candidate)

    def _lost_match(self, frame: TemplateFrame, candidate: PersonCandidate) -> TemplatePerson | None:
        """The lost person whom a newcomer continues best: within reach, no taller, and alike."""
        p, best, best_cost = self.params, None, math.inf
        others = [person for person in self._people if person.observed]
        for person in self._people:
            if not person.lost or self._at_border(person, frame.maps.view):
                continue
            distance = min(math.dist((candidate.x_m, candidate.y_m), at) for at in (person.predicted_m, person.at_m))
            reach_m = p.reach_m + p.speed_max_mps * self._life.unobserved_s(person.existence)
            if distance > min(p.reattach_m, reach_m):
                continue
            unlikely = self._identities.unlikelihood(frame.maps, person, candidate, others)
            cost = distance / p.reattach_m + abs(candidate.height_m - person.height_m) + unlikely
            # Where a person vanished there is no room for another: what does not fit there is a bad measurement.
            place = candidate.x_m, candidate.y_m
            there = inseparable(frame.maps.view, person.at_m, place, p.detection.separation_m)
            fits = candidate.height_m <= person.tallest_m + p.grow_max_m and unlikely <= UNLIKELY_MAX
            if (there or fits) and cost < best_cost:
                best, best_cost = person, cost
        return best

    def _spawn(self, frame: TemplateFrame, candidate: PersonCandidate) -> None:
        n = self._template_size(frame.maps.grid)
        reason = f"{candidate.height_m:.2f} m tall, {candidate.area_m2:.2f} m2 visible"
        existence = self._life.spawn(reason, candidate.area_m2)
        kalman, at_m = self._standing(candidate), (candidate.x_m, candidate.y_m)
        blank = np.zeros((n, n), dtype=np.float32)
        person = TemplatePerson(
            existence, kalman, kalman, blank, blank.copy(), at_m, at_m, candidate.height_m, candidate.height_m
        )
        self._people.append(person)
        self._settle(frame, person, candidate)

    def _reacquire(self, frame: TemplateFrame, person: TemplatePerson, candidate: PersonCandidate) -> None:
        away = math.dist((candidate.x_m, candidate.y_m), person.predicted_m)
        gone = self._life.unobserved_s(person.existence)
        person.jump(self._standing(candidate))
        person.height_m = min(candidate.height_m, person.tallest_m)
        self._life.observe(person.existence, f"found {away:.2f} m from the prediction after {gone:.1f} s", away)
        self._settle(frame, person, candidate)

    def _settle(self, frame: TemplateFrame, person: TemplatePerson, candidate: PersonCandidate) -> None:
        """Templates and body axis at a candidate's place."""
        renew(frame, person, [q for q in self._people if q.observed])
        axis_x, axis_y = candidate.axis_m
        person.offset_m = (axis_x - candidate.x_m, axis_y - candidate.y_m)
        person.axis = person.kalman.moved_to(axis_x, axis_y)

    def _standing(self, candidate: PersonCandidate) -> FloorKalman:
        p = self.params
        return FloorKalman.at(candidate.x_m, candidate.y_m, p.position_std_m, p.speed_std_mps)

    def _prune(self) -> None:
        keep = []
        for person in self._people:
            gone = self._life.unobserved_s(person.existence)
            if not person.confirmed and not person.observed:
                self._life.prune(person.existence, "missed before it was confirmed")
            elif not person.confirmed and person.too_low:
                self._life.prune(person.existence, "too low for a person before it was confirmed")
            elif person.lost and gone > self.params.lost_s:
                self._life.prune(person.existence, f"lost for {gone:.1f} s", gone)
                self._identities.remember(person)
            else:
                keep.append(person)
        self._people = keep

    def _has_left(self, person: TemplatePerson, view: Viewpoint) -> bool:
        """Lost at the border for longer than a newcomer there needs to be recognised.

        A person who left the view is recognised by appearance, not by the place of an entrance.
        """
        p, gone_s = self.params, self._life.unobserved_s(person.existence)
        return person.lost and gone_s > p.confirm_s + p.recognise_s and self._at_border(person, view)

    def _at_border(self, person: TemplatePerson, view: Viewpoint) -> bool:
        """Where the head vanished, give or take a torso, is outside of the image."""
        r, (x, y) = self.params.width_m, person.at_m
        return not all(
            view.sees(x + dx, y + dy, person.height_m) for dx, dy in ((-r, 0.0), (r, 0.0), (0.0, -r), (0.0, r))
        )

    def _template_size(self, grid: Grid) -> int:
        """2 W_avg in cells, odd, so that a template has a central cell."""
        return 2 * max(1, round(self.params.width_m / grid.cell_m)) + 1

    def debug(self) -> TrackerDebug:
        """Search rectangles, templates' outlines and the templates themselves."""
        return TrackerDebug() if self._grid is None else draw(self._people, self._grid, self.params.width_m)


def _state(person: TemplatePerson) -> TrackState:
    a = person.axis
    height_m = person.height_m if person.head_in_view else math.nan
    return TrackState(person.existence.track_id, person.existence.state, a.x_m, a.y_m, a.vx_mps, a.vy_mps, height_m)
