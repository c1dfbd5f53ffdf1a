"""Matching templates to the maps: equation (4), jointly over people who touch (Harville 2002, section 4)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from calib.types import F32, Bool
from planview.tracking.base import ScoreTerms
from planview.tracking.harville._kernels import clear, mean_where, search
from planview.tracking.harville.params import TemplateTrackerParams
from planview.tracking.harville.state import TemplateFrame, TemplatePerson
from planview.tracking.harville.templates import gaussian_model

JOINT_MAX = 3
"""Up to so many people in contact all orders are tried (6 searches of 3 people)."""


class Placement(NamedTuple):
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
    """Finds tracked people in one frame, who are known by their index in the paper's order: the most certain first.

    Args:
        frame: maps; what found people cover is cleared from the free ones.
        people: all who are tracked.
        height_max_m: H_max [m].
    """

    def __init__(
        self, frame: TemplateFrame, people: Sequence[TemplatePerson], params: TemplateTrackerParams, height_max_m: float
    ) -> None:
        self._frame, self._params, self._height_max_m = frame, params, height_max_m
        self._people = sorted(people, key=lambda q: (q.lost, q.kalman.position_std_m, q.existence.track_id))
        self._cells = frame.padded_cells([q.predicted_m for q in self._people])
        self._placed, self._n_placed = np.empty((len(people), 2)), 0
        self._lost: Bool = np.array([q.lost for q in self._people], dtype=np.bool_)
        self._expected = ~self._lost  # who is still to be placed, near where predicted
        self._result = np.empty(7)

    def __call__(self) -> set[TemplatePerson]:
        """Search for all people; sets ``score`` and, where found, ``at_m``; returns the people found.

        Among those who touch, the paper's order decides who gets the maps that both could have; there every order is
        tried, and the one with the smallest total score is kept (joint search, ours).
        """
        found = set()
        for group in self._groups():
            for i, placement in zip(*self._best(group), strict=True):
                person = self._people[i]
                person.score, person.terms = placement.score, placement.terms
                if placement.found:
                    person.at_m = self._frame.maps.grid.centre_of(*placement.cell)
                    found.add(person)
        return found

    def _groups(self) -> Iterator[list[int]]:
        """People in contact with one another, or one alone."""
        touching = self._touching() if self._params.joint else [[] for _ in self._people]
        left = [True] * len(touching)
        for first in range(len(touching)):
            if not left[first]:
                continue
            group, left[first] = [first], False
            for member in group:
                near = [other for other in touching[member] if left[other]][: JOINT_MAX - len(group)]
                for other in near:
                    left[other] = False
                group += near
            yield group

    def _touching(self) -> list[list[int]]:
        """Of each person all whose templates overlap, in order."""
        apart = self._cells[:, None] - self._cells[None]
        reach = 2 * self._params.width_m / self._frame.maps.grid.cell_m
        touching: list[list[int]] = [[] for _ in self._people]
        for one, other in np.argwhere(np.hypot(apart[..., 0], apart[..., 1]) < reach).tolist():
            touching[one].append(other)
        return touching

    def _best(self, group: list[int]) -> tuple[list[int], list[Placement]]:
        """The order with the smallest total score, placed; its maps stay cleared.

        Where all match well in the paper's order, no person has taken another's place and no other order is tried.
        """
        score_max = self._params.match.score_max
        before = None
        if len(group) > 1:
            before = self._frame.free(), self._n_placed
        first = self._place(group)
        if before is None or max(placement.score for placement in first) <= score_max / 2:
            return group, first
        best, smallest = tuple(group), sum(min(placement.score, score_max) for placement in first)
        for order in list(permutations(group))[1:]:
            self._restore(before)
            total = sum(min(placement.score, score_max) for placement in self._place(order))
            if total < smallest - 1e-9:
                best, smallest = order, total
        self._restore(before)
        return list(best), self._place(best)

    def _restore(self, before: tuple[tuple[F32, F32], int]) -> None:
        self._frame.restore(before[0])
        self._n_placed = before[1]

    def _place(self, order: Sequence[int]) -> list[Placement]:
        """Search for people one after the other, clearing the maps under all people found."""
        placements = []
        for i in order:
            self._expected[i] = not self._lost[i]
        for i in order:
            self._expected[i] = False
            placement = self._search(i)
            if placement.found:
                self._placed[self._n_placed] = placement.cell
                self._n_placed += 1
                self._clear(placement)
            placements.append(placement)
        return placements

    def _search(self, index: int) -> Placement:
        p, m, maps, person = self._params, self._params.match, self._frame.maps, self._people[index]
        row, col = maps.grid.index_of(*person.predicted_m)
        reach_m = min(p.search_sigma * person.kalman.position_std_m, p.reach_m)
        person.reach_cells = max(1, math.ceil(reach_m / maps.grid.cell_m))
        person.searched_m = person.predicted_m
        one_sided = self._height_max_m / 3
        height, occupancy = person.template_height, person.template_occupancy
        typical = max(mean_where(occupancy, height), maps.occupancy_min, 1e-9)
        if p.person_model == "gaussian":
            height, occupancy = gaussian_model(person, p.width_m, maps.grid.cell_m)
        search(
            height, occupancy, self._frame.free_height, self._frame.free_occupancy,
            row, col, person.reach_cells, one_sided,
            m.height_weight / one_sided, m.occupancy_weight / typical, m.distance_weight * maps.grid.cell_m / p.width_m,
            m.separation_weight, p.width_m / 2 / maps.grid.cell_m, self._placed[: self._n_placed], self._result,
        )  # fmt: skip
        score, *cell_and_terms = self._result.tolist()
        cell = cell_and_terms[0], cell_and_terms[1]
        found = score <= m.score_max and self._plausible(person, cell)
        return Placement(score, cell, found, ScoreTerms(*cell_and_terms[2:]))

    def _plausible(self, person: TemplatePerson, cell: tuple[float, float]) -> bool:
        """A lost person is only found again where something about as tall is."""
        if not person.lost:
            return True
        row, col, n = int(cell[0]), int(cell[1]), len(person.template_height)
        tall = float(self._frame.free_height[row : row + n, col : col + n].max())
        lowest = min(self._params.detection.height_min_m, person.height_m)
        return lowest <= tall <= person.tallest_m + self._params.grow_max_m

    def _clear(self, placement: Placement) -> None:
        """Clear what a body's points cover, arms included, stretched along the ray by depth noise.

        Cells nearer to where another person is expected are left.
        """
        frame, cell = self._frame, self._frame.maps.grid.cell_m
        across, along, ray = frame.maps.view.footprint(
            *frame.maps.grid.centre_of(*placement.cell), self._params.reach_m
        )
        row, col = placement.cell
        clear(
            frame.free_height, frame.free_occupancy, row + frame.half, col + frame.half, ray[1], ray[0],
            across / cell, along / cell, self._cells, self._expected,
        )  # fmt: skip
