"""Adaptive plan-view templates with Kalman prediction and re-centering (Harville 2002, section 4)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F32, F64
from planview.grid import Grid
from planview.maps import PlanViewMaps, View
from planview.tracking._template_kernels import adapt, clear, occupancy_peak, search
from planview.tracking.base import Decision, DecisionKind, Drawing, Observation, State, TrackerDebug, TrackState
from planview.tracking.body_axis import UNSEEN, AxisMeasurement, BodyAxis, BodyAxisParams
from planview.tracking.detection import Candidate, DetectionParams, NewPeople
from planview.tracking.kalman import FloorKalman


class MatchParams(Params):
    """Match score, equation (4): every term is divided by its natural unit, so that weights compare influences."""

    height_weight: float = Field(1.0, ge=0.0)
    """alpha, on the mean height difference in units of H_max / 3 (Harville 2002: roughly equal influence)."""
    occupancy_weight: float = Field(1.0, ge=0.0)
    """beta, on the mean occupancy difference in units of the template's own mean occupancy."""
    distance_weight: float = Field(0.4, ge=0.0)
    """gamma, on the distance to the prediction in units of W_avg (Harville 2002: less than the others)."""
    separation_weight: float = Field(1.0, ge=0.0)
    """epsilon, on the Gaussian (deviation W_avg / 2) around people already placed in this frame."""
    score_max: float = Field(1.5, gt=0.0)
    """theta_track. Nothing at all where a body is expected scores 2; half of the body hidden scores about 1."""


class TemplateTrackerParams(Params):
    """Template tracker; values without a reference are our choice."""

    match: MatchParams = MatchParams()
    detection: DetectionParams = DetectionParams()
    axis: BodyAxisParams = BodyAxisParams()
    width_m: float = Field(0.40, gt=0.1, le=1.0)
    """W_avg, average torso width [m]; templates are 2 W_avg wide (Harville 2002, section 4)."""
    reach_m: float = Field(0.45, gt=0.1, le=1.0)
    """How far from its axis a body's points are cleared [m]: half of a shoulder breadth and a bent arm. Wider than the
    paper's template, which leaves arms behind that would be taken for somebody new."""
    acceleration_std_mps2: float = Field(2.0, gt=0.0)
    """Random acceleration [m/s^2]: walkers start and stop within about 0.7 s at 1.4 m/s."""
    position_std_m: float = Field(0.05, gt=0.0)
    """Deviation of a matched position [m]: about a cell, and the sway of a body around its path."""
    speed_std_mps: float = Field(1.0, gt=0.0)
    """Deviation of the unknown velocity of somebody new [m/s]."""
    search_sigma: float = Field(3.0, gt=0.0)
    """Half side of the search rectangle in deviations of the predicted position."""
    search_max_m: float = Field(0.5, gt=0.0)
    """Largest half side of the search rectangle [m]; farther away a person is found again by detection."""
    template_time_s: float = Field(0.10, gt=0.0)
    """Time constant of the templates [s]: a relatively high gain (Harville 2002, section 4)."""
    confirm_s: float = Field(0.4, ge=0.0)
    """How long somebody new must be tracked without a miss before he is believed [s]."""
    lost_s: float = Field(4.0, ge=0.0)
    """How long a lost person may come back [s] (Harville 2002, section 4: e.g. 4)."""
    reattach_m: float = Field(2.0, ge=0.0)
    """How near to a lost person a new one is taken for him [m] (Harville 2002, section 4: e.g. 2)."""
    grow_max_m: float = Field(0.15, ge=0.0)
    """A new person taller than a lost one ever was by more than this [m] is somebody else."""
    slow_down_s: float = Field(1.0, gt=0.0)
    """Time constant with which the predicted velocity of a lost person decays [s]."""
    recentre_filled: float = Field(0.3, ge=0.0, le=1.0)
    """Template share with height below which it has slipped, relative to the share of a standing body, see
    ``recentre_body``. Harville 2002, section 4: around 0.3."""
    recentre_offset: float = Field(0.5, gt=0.0)
    """Centroid offset [W_avg] beyond which a template has slipped. Harville 2002, section 4: around 0.5."""
    recentre_body: float = Field(0.4, gt=0.0, le=1.0)
    """Share of a template that a fully seen body fills; the paper's 0.3 is meant for its coarse, smeared depth."""
    left_s: float = Field(1.0, ge=0.0)
    """How long somebody may come back who was lost at the border of the view [s]: he has most likely left, and who
    enters there later is somebody else. Our choice; the paper keeps him for 4 s too."""
    height_time_s: float = Field(0.3, gt=0.0)
    """Time constant of the reported height [s]: fast enough for somebody who sits down."""


@dataclass(eq=False)
class _Person:
    """A tracked person; everything that changes over time."""

    track_id: int
    kalman: FloorKalman
    axis: FloorKalman
    template_height: F32
    template_occupancy: F32
    born_s: float
    seen_s: float
    height_m: float
    tallest_m: float
    state: State = "tentative"
    offset_m: tuple[float, float] = (0.0, 0.0)
    score: float = math.nan
    reach_cells: int = 0
    matched: bool = True
    last_seen_m: tuple[float, float] = (math.nan, math.nan)
    searched_m: tuple[float, float] = (math.nan, math.nan)
    terms: tuple[float, ...] = field(default=())


@dataclass(eq=False)
class _Frame:
    """One frame's maps, padded by half a template, and a copy from which placed people are cleared."""

    maps: PlanViewMaps
    height: F32
    occupancy: F32
    free_height: F32
    free_occupancy: F32


class TemplateTracker:
    """Tracks people in plan-view maps of height and occupancy.

    Each frame: predict everybody; match the most certain first (eq. 4) and clear the maps under him; adapt templates;
    re-center slipped ones; look for new people in what is left, who may be lost ones; measure body axes; retire.
    """

    def __init__(self, params: TemplateTrackerParams | None = None, height_max_m: float = 2.4) -> None:
        self.params = params or TemplateTrackerParams()
        self._height_max_m = height_max_m
        self.reset()

    def reset(self) -> None:
        """Forget everybody; ids start again at 1."""
        self._people: list[_Person] = []
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
        frame = self._pad(maps)
        self._predict(dt)
        self._match(frame)
        self._adapt(frame, dt)
        self._detect(frame)
        self._measure(maps, dt)
        self._retire(maps.view)
        return tuple(self._state(person) for person in self._people)

    # -- predict ------------------------------------------------------------------------------------------------

    def _predict(self, dt: float) -> None:
        p = self.params
        for person in self._people:
            kalman, axis = person.kalman, person.axis
            if person.state == "lost":
                kalman, axis = kalman.slowed(dt, p.slow_down_s), axis.slowed(dt, p.slow_down_s)
            person.kalman = kalman.predicted(dt, p.acceleration_std_mps2)
            person.axis = axis.predicted(dt, p.acceleration_std_mps2)

    # -- match --------------------------------------------------------------------------------------------------

    def _match(self, frame: _Frame) -> None:
        """Most certain first; who is found is cleared away before the next is looked for."""
        placed: list[tuple[float, float]] = []
        result = np.empty(7)
        order = sorted(self._people, key=lambda q: (q.state == "lost", q.kalman.position_std_m, q.track_id))
        for i, person in enumerate(order):
            self._search(frame, person, placed, result)
            person.matched = bool(result[0] <= self.params.match.score_max) and self._plausible(frame, person, result)
            if not person.matched:
                self._miss(person)
                continue
            self._found(person, frame.maps.grid, result)
            placed.append((result[1], result[2]))
            waiting = [q for q in order[i + 1 :] if q.state != "lost"]
            self._clear(frame, result[1], result[2], waiting)

    def _search(self, frame: _Frame, person: _Person, placed: list[tuple[float, float]], result: F64) -> None:
        p, m, cell = self.params, self.params.match, frame.maps.grid.cell_m
        row, col = frame.maps.grid.index_of(person.kalman.x_m, person.kalman.y_m)
        reach_m = min(p.search_sigma * person.kalman.position_std_m, p.search_max_m)
        person.reach_cells = max(1, math.ceil(reach_m / cell))
        person.searched_m = (person.kalman.x_m, person.kalman.y_m)
        one_sided = self._height_max_m / 3
        filled = person.template_occupancy[person.template_height > 0]
        typical = max(float(filled.mean()) if filled.size else 0.0, 1e-9)
        others = np.array(placed).reshape(-1, 2)
        search(
            person.template_height, person.template_occupancy, frame.free_height, frame.free_occupancy,
            row, col, person.reach_cells, one_sided,
            m.height_weight / one_sided, m.occupancy_weight / typical, m.distance_weight * cell / p.width_m,
            m.separation_weight, p.width_m / 2 / cell, others, result,
        )  # fmt: skip

    def _plausible(self, frame: _Frame, person: _Person, result: F64) -> bool:
        """A lost person is only found again where somebody about as tall is."""
        if person.state != "lost":
            return True
        row, col, n = int(result[1]), int(result[2]), len(person.template_height)
        window = frame.free_height[row : row + n, col : col + n]
        tall = float(window.max())
        lowest = min(self.params.detection.height_min_m, person.height_m)
        return lowest <= tall <= person.tallest_m + self.params.grow_max_m

    def _found(self, person: _Person, grid: Grid, result: F64) -> None:
        x, y = grid.centre_of(result[1], result[2])
        person.score, person.terms = float(result[0]), tuple(float(v) for v in result[3:7])
        person.kalman = person.kalman.updated(x, y, self.params.position_std_m)
        person.last_seen_m = (x, y)
        person.seen_s = self._time_s
        if person.state == "lost":
            person.state = "confirmed"
            self._decide(person, "reattached", f"seen again where predicted, score {person.score:.2f}", person.score)
        else:
            self._decide(person, "matched", f"score {person.score:.2f}", person.score)
        if person.state == "tentative" and self._time_s - person.born_s >= self.params.confirm_s - 1e-9:
            person.state = "confirmed"
            self._decide(person, "confirmed", f"tracked for {self._time_s - person.born_s:.2f} s without a miss")

    def _miss(self, person: _Person) -> None:
        if person.state != "lost":
            self._decide(person, "lost", f"best score {person.score:.2f} over {self.params.match.score_max:.2f}")
        person.state = "tentative" if person.state == "tentative" else "lost"

    def _clear(self, frame: _Frame, row: float, col: float, waiting: list[_Person]) -> None:
        """Clear what a body's points cover, arms included, stretched along the ray by depth noise.

        Cells nearer to where somebody else is expected are left to him.
        """
        grid, half = frame.maps.grid, self._half(frame)
        x, y = grid.centre_of(row, col)
        across, along, ray = frame.maps.view.footprint(x, y, self.params.reach_m)
        others = [grid.index_of(q.kalman.x_m, q.kalman.y_m) for q in waiting]
        clear(
            frame.free_height, frame.free_occupancy, row + half, col + half, ray[1], ray[0],
            across / grid.cell_m, along / grid.cell_m, np.array(others, dtype=np.float64).reshape(-1, 2) + half,
        )  # fmt: skip

    # -- templates ----------------------------------------------------------------------------------------------

    def _adapt(self, frame: _Frame, dt: float) -> None:
        """Blend templates of everybody found, then re-center the slipped ones."""
        grid, p = frame.maps.grid, self.params
        found = [person for person in self._people if person.matched]
        people = self._padded_cells(frame, found)
        gain = 1.0 - math.exp(-dt / p.template_time_s)
        for i, person in enumerate(found):
            filled, off_row, off_col = self._blend(frame, person, people, i, gain)
            offset = math.hypot(off_row, off_col) * grid.cell_m
            slipped = filled < p.recentre_filled * p.recentre_body
            if slipped or offset > p.recentre_offset * p.width_m:
                why = f"template {filled:.0%} filled" if slipped else f"centroid {offset:.2f} m off"
                self._recentre(frame, person, people, i, why)

    def _blend(self, frame: _Frame, person: _Person, people: F64, me: int, gain: float) -> tuple[float, float, float]:
        half = len(person.template_height) // 2
        row, col = round(people[me, 0]) - half, round(people[me, 1]) - half
        threshold = frame.maps.occupancy_min
        share, off_row, off_col = adapt(
            person.template_height, person.template_occupancy, frame.height, frame.occupancy,
            row, col, people, me, gain, threshold,
        )  # fmt: skip
        return share, off_row, off_col

    def _recentre(self, frame: _Frame, person: _Person, people: F64, me: int, why: str) -> None:
        """Move to the occupancy maximum within 2 W_avg; velocity and covariance stay."""
        n = len(person.template_height)
        row, col = round(people[me, 0]) - n // 2, round(people[me, 1]) - n // 2
        peak_row, peak_col = occupancy_peak(frame.occupancy, row, col, n, people, me)
        if peak_row < 0:
            return
        half = n // 2
        inside = half <= peak_row < half + frame.maps.grid.n_rows and half <= peak_col < half + frame.maps.grid.n_cols
        if not inside:
            return
        before = person.last_seen_m
        x, y = frame.maps.grid.centre_of(peak_row - half, peak_col - half)
        moved = math.hypot(x - before[0], y - before[1])
        if moved < frame.maps.grid.cell_m:
            return
        people[me] = peak_row, peak_col
        person.kalman = person.kalman.moved_to(x, y)
        person.last_seen_m = (x, y)
        self._blend(frame, person, people, me, 1.0)
        self._decide(person, "recentred", f"by {moved:.2f} m: {why}", moved)

    # -- new people ---------------------------------------------------------------------------------------------

    def _detect(self, frame: _Frame) -> None:
        axis = BodyAxis(frame.maps.view.camera_m, self._height_max_m, self.params.axis)
        finder = NewPeople(self.params.detection, axis, self.params.width_m)
        half = self._half(frame)
        inner = (slice(half, half + frame.maps.grid.n_rows), slice(half, half + frame.maps.grid.n_cols))
        taken = [person.last_seen_m for person in self._people if person.matched]
        found = finder(frame.maps, frame.free_height[inner], frame.free_occupancy[inner], taken)
        for candidate in found:
            lost = self._lost_match(candidate)
            if lost is None:
                self._born(frame, candidate)
            else:
                self._reattach(frame, lost, candidate)

    def _lost_match(self, candidate: Candidate) -> _Person | None:
        """The lost person whom a newcomer continues best: near where he was seen or predicted, and no taller."""
        p, best, best_cost = self.params, None, math.inf
        for person in self._people:
            if person.state != "lost" or candidate.height_m > person.tallest_m + p.grow_max_m:
                continue
            distance = min(
                math.hypot(candidate.x_m - person.kalman.x_m, candidate.y_m - person.kalman.y_m),
                math.hypot(candidate.x_m - person.last_seen_m[0], candidate.y_m - person.last_seen_m[1]),
            )
            cost = distance / p.reattach_m + abs(candidate.height_m - person.height_m)
            if distance <= p.reattach_m and cost < best_cost:
                best, best_cost = person, cost
        return best

    def _born(self, frame: _Frame, candidate: Candidate) -> None:
        p, n = self.params, self._template_size(frame.maps.grid)
        kalman = FloorKalman.at(candidate.x_m, candidate.y_m, p.position_std_m, p.speed_std_mps)
        blank = np.zeros((n, n), dtype=np.float32)
        person = _Person(
            self._next_id, kalman, kalman, blank, blank.copy(), self._time_s, self._time_s,
            candidate.height_m, candidate.height_m, last_seen_m=(candidate.x_m, candidate.y_m),
        )  # fmt: skip
        self._next_id += 1
        self._people.append(person)
        self._copy_template(frame, person)
        self._decide(
            person, "born", f"{candidate.height_m:.2f} m tall, {candidate.area_m2:.2f} m2 seen", candidate.area_m2
        )

    def _reattach(self, frame: _Frame, person: _Person, candidate: Candidate) -> None:
        p = self.params
        away = math.hypot(candidate.x_m - person.kalman.x_m, candidate.y_m - person.kalman.y_m)
        gone = self._time_s - person.seen_s
        person.kalman = FloorKalman.at(candidate.x_m, candidate.y_m, p.position_std_m, p.speed_std_mps)
        person.axis, person.offset_m = person.kalman, (0.0, 0.0)
        person.last_seen_m, person.seen_s, person.matched = (candidate.x_m, candidate.y_m), self._time_s, True
        person.state, person.height_m = "confirmed", candidate.height_m
        self._copy_template(frame, person)
        self._decide(person, "reattached", f"found {away:.2f} m from the prediction after {gone:.1f} s", away)

    def _copy_template(self, frame: _Frame, person: _Person) -> None:
        found = [q for q in self._people if q.matched]
        people = self._padded_cells(frame, found)
        person.template_height[:] = 0.0
        person.template_occupancy[:] = 0.0
        self._blend(frame, person, people, found.index(person), 1.0)

    # -- where the body is --------------------------------------------------------------------------------------

    def _measure(self, maps: PlanViewMaps, dt: float) -> None:
        """Body axes and heights of everybody found (see ``body_axis``)."""
        found = [person for person in self._people if person.matched]
        if not found:
            return
        where = np.array([person.last_seen_m for person in found])
        axes = BodyAxis(maps.view.camera_m, self._height_max_m, self.params.axis)(
            maps.points, where, self.params.width_m * 1.25
        )
        for person, measured in zip(found, axes, strict=True):
            self._report(person, measured, dt, maps.view)

    def _report(self, person: _Person, measured: AxisMeasurement, dt: float, view: View) -> None:
        x, y = person.last_seen_m
        new = person.born_s == self._time_s or person.axis is person.kalman
        if measured is not UNSEEN and not math.isnan(measured.x_m):
            if measured.from_head or new:
                person.offset_m = (measured.x_m - x, measured.y_m - y)
            keep = 0.0 if new else math.exp(-dt / self.params.height_time_s)
            person.height_m = keep * person.height_m + (1 - keep) * measured.height_m
            person.tallest_m = max(person.tallest_m, person.height_m)
        at_x, at_y = x + person.offset_m[0], y + person.offset_m[1]
        if new:
            person.axis = FloorKalman.at(at_x, at_y, self.params.position_std_m, self.params.speed_std_mps)
        else:
            person.axis = person.axis.updated(at_x, at_y, self.params.position_std_m)

    # -- the end ------------------------------------------------------------------------------------------------

    def _retire(self, view: View) -> None:
        keep = []
        for person in self._people:
            gone = self._time_s - person.seen_s
            left = gone > self.params.left_s and self._at_border(person, view)
            if person.state == "tentative" and not person.matched:
                self._decide(person, "removed", "missed before it was confirmed")
            elif person.state == "lost" and (left or gone > self.params.lost_s):
                why = "left the view" if left else "lost"
                self._decide(person, "removed", f"{why} for {gone:.1f} s", gone)
            else:
                keep.append(person)
        self._people = keep

    def _at_border(self, person: _Person, view: View) -> bool:
        """Predicted head, give or take a torso, outside of the image."""
        r = self.params.width_m
        x, y, z = person.kalman.x_m, person.kalman.y_m, person.height_m
        return not all(view.sees(x + dx, y + dy, z) for dx, dy in ((-r, 0.0), (r, 0.0), (0.0, -r), (0.0, r)))

    # -- helpers ------------------------------------------------------------------------------------------------

    def _template_size(self, grid: Grid) -> int:
        """2 W_avg in cells, odd, so that a template has a central cell."""
        return 2 * max(1, round(self.params.width_m / grid.cell_m)) + 1

    def _pad(self, maps: PlanViewMaps) -> _Frame:
        half = self._template_size(maps.grid) // 2
        height, occupancy = (np.pad(image, half) for image in (maps.height, maps.occupancy))
        return _Frame(maps, height, occupancy, height.copy(), occupancy.copy())

    @staticmethod
    def _half(frame: _Frame) -> int:
        return (len(frame.height) - frame.maps.grid.n_rows) // 2

    def _padded_cells(self, frame: _Frame, people: list[_Person]) -> F64:
        half = self._half(frame)
        cells = [frame.maps.grid.index_of(*person.last_seen_m) for person in people]
        return np.array(cells, dtype=np.float64).reshape(-1, 2) + half

    def _decide(self, person: _Person, kind: DecisionKind, reason: str, value: float = math.nan) -> None:
        self._decisions.append(Decision(person.track_id, kind, reason, value))

    def _state(self, person: _Person) -> TrackState:
        a = person.axis
        return TrackState(person.track_id, person.state, a.x_m, a.y_m, a.vx_mps, a.vy_mps, person.height_m)

    def debug(self) -> TrackerDebug:
        """Search rectangles, templates' outlines and the templates themselves."""
        if self._grid is None:
            return TrackerDebug()
        searches, outlines, labels = [], [], []
        for person in self._people:
            half = (person.reach_cells + 0.5) * self._grid.cell_m
            searches.append(_square(*person.searched_m, half))
            outlines.append(_square(person.kalman.x_m, person.kalman.y_m, self.params.width_m))
            labels.append(f"{person.track_id}: {person.score:.2f}")
        tiles: dict[str, F32] = {}
        for person in self._people:
            tiles[f"template/{person.track_id}/height"] = person.template_height
            tiles[f"template/{person.track_id}/occupancy"] = person.template_occupancy
        drawings = (
            Drawing("search", "floor", tuple(searches)),
            Drawing("template", "floor", tuple(outlines), tuple(labels)),
        )
        return TrackerDebug(drawings, dict(tiles))


def _square(x: float, y: float, half: float) -> F32:
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    return np.array([(x + half * i, y + half * j) for i, j in corners], dtype=np.float32)
