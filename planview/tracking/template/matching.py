"""Matching templates to the maps: equation (4), jointly over people who touch (Harville 2002, section 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from calib.types import F32
from planview.tracking.base import ScoreTerms
from planview.tracking.template._kernels import clear, search
from planview.tracking.template.params import TemplateTrackerParams
from planview.tracking.template.state import TemplateFrame, TemplatePerson
from planview.tracking.template.templates import gaussian_model

JOINT_MAX = 3
"""Up to so many people in contact all orders are tried (6 searches of 3 people)."""


@dataclass(frozen=True)
class Placement:
    """Where one person's templates match best.

    Attributes:
        score: of equation (4).
        cell: (row, col) of the grid.
        found: the score is good enough, and the height there is the person's.
        terms: that the score is the sum of.
    """

    score: float
    cell: tuple[float, float]
    found: bool
    terms: ScoreTerms


class JointMatcher:
    """Finds tracked people in one frame.

    Args:
        frame: maps; what found people cover is cleared from the free ones.
        height_max_m: H_max [m].
    """

    def __init__(self, frame: TemplateFrame, params: TemplateTrackerParams, height_max_m: float) -> None:
        self._frame, self._params, self._height_max_m = frame, params, height_max_m
        self._placed: list[tuple[float, float]] = []
        self._result = np.empty(7)

    def __call__(self, people: Sequence[TemplatePerson]) -> list[TemplatePerson]:
        """Search for all people; sets ``score`` and, where found, ``at_m``; returns the people found.

        People are taken in the paper's order, the most certain first. Among those who touch, that order decides who
        gets the maps that both could have; there every order is tried, and the one with the smallest total score is
        kept (joint search, ours).
        """
        left = sorted(people, key=lambda q: (q.state == "lost", q.kalman.position_std_m, q.existence.track_id))
        found = []
        while left:
            group = self._take_group(left)
            waiting = [q for q in left if q.state != "lost"]
            for person, placement in zip(*self._best(group, waiting), strict=True):
                person.score, person.terms = placement.score, placement.terms
                if placement.found:
                    person.at_m = self._frame.maps.grid.centre_of(*placement.cell)
                    found.append(person)
        return found

    def _take_group(self, left: list[TemplatePerson]) -> list[TemplatePerson]:
        """The most certain person and those in contact, taken out of the people left."""
        group = [left.pop(0)]
        if self._params.joint:
            for member in group:
                for near in [q for q in left if self._touch(member, q)][: JOINT_MAX - len(group)]:
                    left.remove(near)
                    group.append(near)
        return group

    def _touch(self, one: TemplatePerson, other: TemplatePerson) -> bool:
        (ax, ay), (bx, by) = one.predicted_m, other.predicted_m
        return math.hypot(ax - bx, ay - by) < 2 * self._params.width_m

    def _best(
        self, group: list[TemplatePerson], waiting: Sequence[TemplatePerson]
    ) -> tuple[list[TemplatePerson], list[Placement]]:
        """The order with the smallest total score, placed; its maps stay cleared.

        Where all match well in the paper's order, no person has taken another's place and no other order is tried.
        """
        score_max = self._params.match.score_max
        before = None
        if len(group) > 1:
            before = self._frame.free_height.copy(), self._frame.free_occupancy.copy(), len(self._placed)
        first = self._place(group, waiting)
        if before is None or max(placement.score for placement in first) <= score_max / 2:
            return group, first
        best, smallest = tuple(group), sum(min(placement.score, score_max) for placement in first)
        for order in list(permutations(group))[1:]:
            self._restore(before)
            total = sum(min(placement.score, score_max) for placement in self._place(order, waiting))
            if total < smallest - 1e-9:
                best, smallest = order, total
        self._restore(before)
        return list(best), self._place(best, waiting)

    def _restore(self, before: tuple[F32, F32, int]) -> None:
        self._frame.free_height[:], self._frame.free_occupancy[:] = before[0], before[1]
        del self._placed[before[2] :]

    def _place(self, order: Sequence[TemplatePerson], waiting: Sequence[TemplatePerson]) -> list[Placement]:
        """Search for people one after the other, clearing the maps under all people found."""
        placements = []
        for i, person in enumerate(order):
            placement = self._search(person)
            if placement.found:
                self._placed.append(placement.cell)
                others = [q for q in [*order[i + 1 :], *waiting] if q.state != "lost"]
                self._clear(placement, others)
            placements.append(placement)
        return placements

    def _search(self, person: TemplatePerson) -> Placement:
        p, m, maps = self._params, self._params.match, self._frame.maps
        row, col = maps.grid.index_of(*person.predicted_m)
        reach_m = min(p.search_sigma * person.kalman.position_std_m, p.reach_m)
        person.reach_cells = max(1, math.ceil(reach_m / maps.grid.cell_m))
        person.searched_m = person.predicted_m
        one_sided = self._height_max_m / 3
        filled = person.template_occupancy[person.template_height > 0]
        # The mean, without the overhead of numpy's own.
        mean = float(np.add.reduce(filled) / np.float32(filled.size)) if filled.size else 0.0
        typical = max(mean, maps.occupancy_min, 1e-9)
        height, occupancy = person.template_height, person.template_occupancy
        if p.person_model == "gaussian":
            height, occupancy = gaussian_model(person, p.width_m, maps.grid.cell_m)
        search(
            height, occupancy, self._frame.free_height, self._frame.free_occupancy,
            row, col, person.reach_cells, one_sided,
            m.height_weight / one_sided, m.occupancy_weight / typical, m.distance_weight * maps.grid.cell_m / p.width_m,
            m.separation_weight, p.width_m / 2 / maps.grid.cell_m, np.array(self._placed).reshape(-1, 2), self._result,
        )  # fmt: skip
        score, cell = float(self._result[0]), (float(self._result[1]), float(self._result[2]))
        found = score <= m.score_max and self._plausible(person, cell)
        return Placement(score, cell, found, ScoreTerms(*self._result[3:].tolist()))

    def _plausible(self, person: TemplatePerson, cell: tuple[float, float]) -> bool:
        """A lost person is only found again where something about as tall is."""
        if person.state != "lost":
            return True
        row, col, n = int(cell[0]), int(cell[1]), len(person.template_height)
        tall = float(self._frame.free_height[row : row + n, col : col + n].max())
        lowest = min(self._params.detection.height_min_m, person.height_m)
        return lowest <= tall <= person.tallest_m + self._params.grow_max_m

    def _clear(self, placement: Placement, waiting: Sequence[TemplatePerson]) -> None:
        """Clear what a body's points cover, arms included, stretched along the ray by depth noise.

        Cells nearer to where another person is expected are left.
        """
        frame, cell = self._frame, self._frame.maps.grid.cell_m
        at_m = frame.maps.grid.centre_of(*placement.cell)
        across, along, ray = frame.maps.view.footprint(*at_m, self._params.reach_m)
        row, col = frame.padded_cells([at_m])[0]
        others = frame.padded_cells([q.predicted_m for q in waiting])
        clear(frame.free_height, frame.free_occupancy, row, col, ray[1], ray[0], across / cell, along / cell, others)
