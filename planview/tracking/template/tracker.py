"""Tracking and adapting templates of plan-view statistics (Harville 2002, section 4).

The paper's method and nothing else; where it leaves something open, the choice is at its line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from pydantic import Field

from calib.carried import Carried
from calib.floor_camera import FloorCamera
from calib.params import Params
from calib.types import F32, F64, I64
from planview.maps.plan_view import PlanViewMaps
from planview.tracking.base import (
    NO_TERMS,
    Decision,
    Drawing,
    Existence,
    LifeCycle,
    Needs,
    Observation,
    ScoreTerms,
    TrackerDebug,
    person_boxes,
)
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState

SEARCH_SIGMA = 3.0
"""Half side of the search zone in deviations of the predicted position (the paper: from the Kalman uncertainty)."""

Place = tuple[float, float]
"""Floor position (x, y) [m]."""


class TemplateParams(Params):
    """The paper's thresholds; every term of equation (4) is divided by its natural unit, so that weights compare
    influences. A weight of 0 leaves a term out: height alone and occupancy alone are two of the paper's variants, for
    which score_max is halved, since nothing at all then scores 1."""

    height_weight: float = Field(1.0, ge=0.0)
    """alpha, on the mean height difference in units of H_max / 3 (Harville 2002, section 4: all equal)."""
    occupancy_weight: float = Field(1.0, ge=0.0)
    """beta, on the mean occupancy difference in units of the template's own mean occupancy (as alpha)."""
    distance_weight: float = Field(0.4, ge=0.0)
    """gamma, on the distance to the prediction in units of W_avg (Harville 2002, section 4: less than the others)."""
    separation_weight: float = Field(1.0, ge=0.0)
    """epsilon, on the Gaussian around people already placed in this frame (as alpha)."""
    score_max: float = Field(1.2, gt=0.0)
    """theta_track (our choice; the paper gives no value). Nothing at all where a body is expected scores 2, half of the
    body hidden about 1: half a body is still a match, less is not."""
    width_m: float = Field(0.40, gt=0.1, le=1.0)
    """W_avg, average torso width [m]; templates are 2 W_avg wide (Harville 2002, section 4: about 0.4)."""
    acceleration_std_mps2: float = Field(2.0, gt=0.0, le=20.0)
    """Random acceleration [m/s^2]: walkers start and stop within about 0.7 s at 1.4 m/s."""
    template_s: float = Field(0.10, gt=0.0, le=60.0)
    """Time constant of the templates [s] (Harville 2002, section 4: a relatively high gain)."""
    recentre_filled: float = Field(0.12, ge=0.0, le=1.0)
    """theta_HTcount, share of the template with height below which it has slipped. Harville 2002, section 4: around
    0.3, of coarse, smeared depth; a fully visible body fills 0.4 of a template here, and 0.3 of that is the same."""
    recentre_offset: float = Field(0.5, gt=0.0)
    """theta_HTcentroid, offset of the centroid [W_avg] beyond which a template has slipped (Harville 2002, section 4:
    around 0.5)."""
    area_min_m2: float = Field(0.10, gt=0.0)
    """Visible surface of a newcomer within a square of side W_avg [m^2] (the paper: high occupancy): a
    head and shoulders."""
    height_min_m: float = Field(1.2, ge=0.1, le=2.5)
    """Smallest height of a newcomer [m] (the paper: some plausible minimum): chairs reach 1.1 m."""
    confirm_s: float = Field(0.4, ge=0.0, le=60.0)
    """Time for which a newcomer must be tracked without a miss before it is a person [s] (the paper: some minimum
    number of consecutive frames)."""
    lost_s: float = Field(4.0, ge=0.0, le=600.0)
    """Time for which a lost person is searched [s] (Harville 2002, section 4: e.g. 4)."""
    reattach_m: float = Field(2.0, ge=0.0)
    """Distance within which a newcomer continues a lost person [m] (Harville 2002, section 4: e.g. 2)."""


@dataclass(eq=False)
class MapPerson:
    """The paper's state <x, v, T_H, T_O> of a tracked person.

    Attributes:
        existence: id, state and times of life.
        kalman: position and velocity on the floor.
        template_height, template_occupancy: T_H [m] and T_O [m^2], (n, n) float32.
        measured_m: where it was last found [m].
        predicted_m: where it was expected in this frame [m].
        reach_m: half side of the zone searched in this frame [m].
        score: of the best match in this frame.
    """

    existence: Existence
    kalman: FloorKalman
    template_height: F32
    template_occupancy: F32
    measured_m: Place
    predicted_m: Place
    reach_m: float = 0.0
    score: float = math.nan

    @property
    def at_m(self) -> Place:
        """Filtered position, or the predicted one while nothing matches [m]."""
        return self.kalman.at_m

    def distance_m(self, at_m: Place) -> float:
        """Distance of a place from the last predicted or measured location, whichever is nearer."""
        return min(math.dist(at_m, self.predicted_m), math.dist(at_m, self.measured_m))


class FreeMaps:
    """H_masked and O_sm without the people tracked so far in this frame.

    Attributes:
        maps: as observed.
        n: side of a template, 2 W_avg, odd so that it has a central cell [cells].
        height, occupancy: padded by half a template, so that one centred on grid cell (row, col) covers the padded
            maps from (row, col) on.
    """

    def __init__(self, maps: PlanViewMaps, width_m: float) -> None:
        self.maps = maps
        half = max(1, round(width_m / maps.grid.cell_m))
        self.n = 2 * half + 1
        self.height: F32 = np.pad(maps.height, half)
        self.occupancy: F32 = np.pad(maps.occupancy, half)

    def window(self, at_m: Place) -> tuple[slice, slice]:
        """Cells of the padded maps under a template at a place, of which the grid's nearest cell is the centre."""
        row, col = self.maps.grid.nearest(*at_m)
        return slice(row, row + self.n), slice(col, col + self.n)

    def clear(self, at_m: Place) -> None:
        """Remove what lies under a template at a place."""
        window = self.window(at_m)
        self.height[window] = self.occupancy[window] = 0.0

    def occupancy_peak(self, at_m: Place) -> Place | None:
        """The largest occupancy within the square of side 2 W_avg around a place; None where there is none [m]."""
        rows, cols = self.window(at_m)
        part = self.occupancy[rows, cols]
        row, col = divmod(int(np.argmax(part)), self.n)
        half = self.n // 2
        return self.maps.grid.centre_of(rows.start + row - half, cols.start + col - half) if part.max() > 0 else None


class TemplateTracker(Carried):
    """Tracks people by adaptive templates of height and occupancy.

    Each frame, for one person after the other, the most certain first: predict; find where the maps match the
    templates best (eq. 4); update filter and templates; re-center; clear the maps there. Then look for newcomers in
    what is left, who may be lost people, and forget who was lost for too long.

    Args:
        params: see TemplateParams.
        height_max_m: H_max [m].
    """

    needs: Needs = "maps"
    CARRIED = "_people", "_life"
    RECORDS = MapPerson, Existence, FloorKalman

    def __init__(self, params: TemplateParams | None = None, height_max_m: float = 2.4) -> None:
        self.params = params or TemplateParams()
        self._height_max_m = height_max_m
        self._life = LifeCycle()
        self.reset()

    def reset(self) -> None:
        """Forget all people; ids start again at 1."""
        self._people: list[MapPerson] = []
        self._life.reset()

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._life.decisions

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame. Raises ValueError: no maps, or time does not advance.

        Args:
            observation: with maps.
        """
        maps = observation.maps
        if maps is None:
            raise ValueError("expected an observation with plan-view maps, got none (this tracker needs stereo)")
        dt_s = self._life.begin(observation.timestamp_s)
        for person in self._people:
            person.kalman = person.kalman.predict(dt_s, self.params.acceleration_std_mps2)
            person.predicted_m = person.at_m
            if observation.unknown:
                self._life.pause(person.existence, dt_s)
        if not observation.unknown:
            self._follow(FreeMaps(maps, self.params.width_m), dt_s)
        near_cells = round(self.params.width_m / 2 / maps.grid.cell_m)
        return tuple(_state(person, near_cells, observation.camera) for person in self._people)

    def _follow(self, free: FreeMaps, dt_s: float) -> None:
        """Find everybody in the maps of a frame, the most certain first, then newcomers in what is left."""
        placed: list[Place] = []
        # Of people whose places are equally certain, whoever came first.
        certain = sorted(self._people, key=lambda one: (one.kalman.position_std_m, abs(one.existence.track_id)))
        for person in certain:
            place, terms = self._search(person, free, placed)
            if place is None:
                reason = f"nothing like the templates within {person.reach_m:.2f} m, score {person.score:.2f}"
                self._life.miss(person.existence, reason, person.score, terms)
                continue
            self._life.observe(person.existence, f"score {person.score:.2f}", person.score, terms)
            # The velocity is not measured apart: in the filter the change in position carries it.
            person.kalman = person.kalman.update(*place, free.maps.grid.cell_m)  # the search measures whole cells
            person.measured_m = place
            self._adapt(person, free, 1.0 - math.exp(-dt_s / self.params.template_s))
            self._recentre(person, free)
            free.clear(person.measured_m)
            placed.append(person.measured_m)
        self._confirm_and_forget()
        self._find_newcomers(free)

    def _search(self, person: MapPerson, free: FreeMaps, placed: list[Place]) -> tuple[Place | None, ScoreTerms]:
        """Place where the match score M (eq. 4) around the prediction is smallest; None if it exceeds theta_track."""
        p = self.params
        grid = free.maps.grid
        reach = max(1, math.ceil(SEARCH_SIGMA * person.kalman.position_std_m / grid.cell_m))
        # The distance term alone is above theta_track farther away.
        if p.distance_weight > 0:
            reach = min(reach, math.ceil(p.score_max / p.distance_weight * p.width_m / grid.cell_m))
        person.reach_m = reach * grid.cell_m
        if not (person.template_height > 0).any():  # an empty template is like any empty floor
            person.score = math.inf
            return None, NO_TERMS
        row, col = (part.start for part in free.window(person.predicted_m))
        # Every second cell first where the reach is wide: the maps are smooth over a cell.
        passes = ((reach, 2), (1, 1)) if reach > 2 else ((reach, 1),)
        for radius, step in passes:
            rows = np.arange(max(0, row - radius), min(grid.n_rows, row + radius + 1), step)
            cols = np.arange(max(0, col - radius), min(grid.n_cols, col + radius + 1), step)
            terms = self._terms(person, free, placed, rows, cols)
            i, j = divmod(int(np.argmin(terms.sum(axis=0))), len(cols))
            row = int(rows[i])
            col = int(cols[j])
        best = terms[:, i, j]
        person.score = float(best.sum())
        place = grid.centre_of(row, col) if person.score <= p.score_max else None
        return place, ScoreTerms(*best.tolist())

    def _terms(self, person: MapPerson, free: FreeMaps, placed: list[Place], rows: I64, cols: I64) -> F64:
        """(4, R, C) terms of the match score (eq. 4) at evenly spaced rows and columns of the grid."""
        p = self.params
        grid = free.maps.grid
        part = slice(rows[0], rows[-1] + free.n), slice(cols[0], cols[-1] + free.n)
        step = int(rows[1] - rows[0]) if len(rows) > 1 else 1
        one_sided_m = self._height_max_m / 3
        height, occupancy = mean_differences(
            person.template_height,
            person.template_occupancy,
            free.height[part],
            free.occupancy[part],
            one_sided_m,
            step,
        )
        typical = float(person.template_occupancy[person.template_height > 0].mean())
        row, col = grid.index_of(*person.predicted_m)
        away = np.hypot(rows[:, None] - row, cols - col)
        separation = np.zeros(height.shape)
        # The paper's variance of W_avg has no unit of area; a deviation of W_avg / 2 was chosen.
        deviation = p.width_m / 2 / grid.cell_m
        for place in placed:
            other_row, other_col = grid.index_of(*place)
            squared = (rows[:, None] - other_row) ** 2 + (cols - other_col) ** 2
            separation += np.exp(-0.5 * squared / deviation**2)
        return np.stack(
            [
                p.height_weight / one_sided_m * height,
                p.occupancy_weight / max(typical, free.maps.occupancy_min, 1e-9) * occupancy,
                p.distance_weight * grid.cell_m / p.width_m * away,
                p.separation_weight * separation,
            ]
        )

    def _adapt(self, person: MapPerson, free: FreeMaps, gain: float) -> None:
        """Blend the maps into the templates; a gain of 1 extracts new ones."""
        window = free.window(person.measured_m)
        height = free.height[window]
        occupancy = free.occupancy[window]
        t_height = person.template_height
        t_occupancy = person.template_occupancy
        t_occupancy += np.float32(gain) * (occupancy - t_occupancy)
        # A height is blended with a height: none is not a height of zero. It goes with its occupancy, as in the maps.
        both = (t_height > 0) & (height > 0)
        blended = np.where(both, t_height + np.float32(gain) * (height - t_height), np.maximum(t_height, height))
        t_height[:] = np.where(t_occupancy >= np.float32(free.maps.occupancy_min), blended, 0.0)

    def _recentre(self, person: MapPerson, free: FreeMaps) -> None:
        """Move a template that has slipped off its person to the occupancy maximum; velocity and covariance stay.

        The paper does so after all people are tracked. Here it is done before the person is cleared, so that people
        tracked earlier are not maxima to move to.
        """
        why = self._slip(person.template_height, free.maps.grid.cell_m)
        if not why:
            return
        peak = free.occupancy_peak(person.at_m)
        if peak is None:
            return
        moved_m = math.dist(peak, person.at_m)
        self._put(person, peak, person.kalman.move_to(*peak), free)
        self._life.note(person.existence, "recentred", f"by {moved_m:.2f} m: {why}", moved_m)

    def _slip(self, template_height: F32, cell_m: float) -> str:
        """Sign that a template has slipped off its person; empty if it has not."""
        n = len(template_height)
        rows, cols = np.nonzero(template_height)
        filled = len(rows) / n**2
        if filled < self.params.recentre_filled:
            return f"template {filled:.0%} filled"
        if len(rows):
            off_m = math.hypot(rows.mean() - n // 2, cols.mean() - n // 2) * cell_m
            if off_m > self.params.recentre_offset * self.params.width_m:
                return f"centroid {off_m:.2f} m off"
        return ""

    def _put(self, person: MapPerson, at_m: Place, kalman: FloorKalman, free: FreeMaps) -> None:
        """Place a person, with new templates extracted there."""
        person.measured_m = at_m
        person.kalman = kalman
        person.template_height[:] = 0.0
        person.template_occupancy[:] = 0.0
        self._adapt(person, free, 1.0)

    def _confirm_and_forget(self) -> None:
        """Confirm newcomers after confirm_s without a miss, else end them; keep lost people for lost_s."""
        kept = []
        for person in self._people:
            track = person.existence
            age_s = self._life.now_s - track.spawned_s
            gone_s = self._life.unobserved_s(track)
            if track.observed and not track.confirmed and age_s >= self.params.confirm_s - 1e-9:
                self._life.confirm(track, f"tracked for {age_s:.2f} s without a miss", age_s)
            if not track.confirmed and not track.observed:
                self._life.prune(track, "missed before it was confirmed")
            elif track.lost and gone_s > self.params.lost_s:
                self._life.prune(track, f"lost for {gone_s:.1f} s", gone_s)
            else:
                kept.append(person)
        self._people = kept

    def _find_newcomers(self, free: FreeMaps) -> None:
        """Follow what is left of the maps with high occupancy and plausible height: lost people, or new ones."""
        p = self.params
        grid = free.maps.grid
        half = free.n // 2
        inner = slice(half, half + grid.n_rows), slice(half, half + grid.n_cols)
        side = 2 * (half // 2) + 1  # W_avg
        while True:
            area = cv2.boxFilter(
                free.occupancy[inner], -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT
            )
            tallest = cv2.dilate(free.height[inner], np.ones((side, side), np.uint8))
            area[tallest < p.height_min_m] = 0.0
            row, col = divmod(int(np.argmax(area)), grid.n_cols)
            if area[row, col] < p.area_min_m2:
                return
            at_m = grid.centre_of(row, col)
            kalman = FloorKalman.at(*at_m, grid.cell_m)
            person = self._reattach(at_m)
            if person is None:
                what = f"{tallest[row, col]:.2f} m tall, {area[row, col]:.2f} m2 visible"
                existence = self._life.spawn(what, float(area[row, col]))
                height, occupancy = np.zeros((2, free.n, free.n), np.float32)
                person = MapPerson(existence, kalman, height, occupancy, at_m, at_m)
                self._people.append(person)
            self._put(person, at_m, kalman, free)
            free.clear(at_m)

    def _reattach(self, at_m: Place) -> MapPerson | None:
        """Observe the lost person nearest to a place again; None where nobody lost is near enough."""
        lost = [person for person in self._people if person.existence.lost]
        nearest = min(lost, key=lambda person: (person.distance_m(at_m), person.existence.track_id), default=None)
        if nearest is None:
            return None
        away_m = nearest.distance_m(at_m)
        if away_m > self.params.reattach_m:
            return None
        gone_s = self._life.unobserved_s(nearest.existence)
        self._life.observe(nearest.existence, f"found {away_m:.2f} m away after {gone_s:.1f} s", away_m)
        return nearest

    def debug(self) -> TrackerDebug:
        """Search zones, outlines of the templates with scores, and the templates themselves."""
        searches = []
        outlines = []
        labels = []
        tiles: dict[str, F32] = {}
        for person in self._people:
            name = person.existence.track_id
            searches.append(_square(person.predicted_m, person.reach_m))
            outlines.append(_square(person.at_m, self.params.width_m))
            labels.append(f"{name}: {person.score:.2f}")
            tiles[f"template/{name}/height"] = person.template_height.copy()
            tiles[f"template/{name}/occupancy"] = person.template_occupancy.copy()
        zones = Drawing("search", "floor", tuple(searches))
        return TrackerDebug((zones, Drawing("template", "floor", tuple(outlines), tuple(labels))), dict(tiles))


def mean_differences(
    template_height: F32, template_occupancy: F32, height: F32, occupancy: F32, one_sided: float, step: int = 1
) -> tuple[F64, F64]:
    """Mean height and occupancy differences (eq. 4) of templates (n, n) from every ``step``-th window of maps, float64.

    Only cells where template or map has height count; one with height in exactly one of the two as ``one_sided``.
    """
    shape = template_height.shape
    heights = sliding_window_view(height, shape)[::step, ::step]
    occupancies = sliding_window_view(occupancy, shape)[::step, ::step]
    in_template = template_height > 0
    in_map = heights > 0
    either = in_template | in_map
    used = np.count_nonzero(either, axis=(2, 3))
    apart = np.where(in_template & in_map, np.abs(heights - template_height), np.float32(one_sided))
    height_sum = np.einsum("rcij,rcij->rc", either, apart)
    occupancy_sum = np.einsum("rcij,rcij->rc", either, np.abs(occupancies - template_occupancy))
    cells = np.maximum(used, 1)
    return np.where(used > 0, height_sum / cells, one_sided), occupancy_sum / cells


def _state(person: MapPerson, near_cells: int, camera: FloorCamera | None) -> TrackState:
    """Report the template's centre; the head is the highest of T_H within ``near_cells``, half a torso, of it."""
    half = len(person.template_height) // 2
    near = slice(half - near_cells, half + near_cells + 1)
    height_m = float(person.template_height[near, near].max()) or math.nan
    track = person.existence
    (box_px,) = person_boxes(camera, [(*person.at_m, height_m)])
    return TrackState(track.track_id, track.state, *person.at_m, *person.kalman.velocity_mps, height_m, box_px)


def _square(at_m: Place, half_m: float) -> F32:
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    return np.array([(at_m[0] + half_m * i, at_m[1] + half_m * j) for i, j in corners], dtype=np.float32)
