"""Whether a newcomer is a body of its own, and not a part of a person or a thing (our choice; the paper has none)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planview.maps.builder import PlanViewMaps
from planview.tracking.detection import PersonCandidate, inseparable
from planview.tracking.harville.params import TemplateTrackerParams
from planview.tracking.harville.state import TemplatePerson
from planview.tracking.newcomers import is_part_of

SEATED_M = 1.4
"""Heads of seated adults are below this [m] (anthropometric tables: seat 0.45 m, sitting height up to 0.95 m)."""
CHAIR_M = 1.2
"""What is lower than this may be a chair, a case, or the lap of a seated person [m]."""


class Separate:
    """Judges one frame's newcomers.

    Args:
        maps: of the frame.
        now_s: its time [s].
    """

    def __init__(self, maps: PlanViewMaps, params: TemplateTrackerParams, now_s: float) -> None:
        self._maps, self._params, self._now_s = maps, params, now_s

    def __call__(self, person: TemplatePerson, known: Sequence[TemplatePerson]) -> bool:
        """Whether a newcomer is neither a part of one of the people known nor a thing that was put down."""
        if any(self._part_of(person, other) for other in known):
            # What a person carries or pushes moves and looks tall, but not by itself: its proof begins again.
            person.spawned_m, person.alone_s = person.at_m, self._now_s
            return False
        if self._hidden(person, known):
            # What is hidden in part seems to move as others pass before it.
            person.spawned_m = person.at_m
        return not self._put_down(person)

    def _put_down(self, person: TemplatePerson) -> bool:
        """As low as a seated person, and has not moved by itself since it appeared."""
        enough_m = self._params.moved_m
        return person.height_m < SEATED_M and math.dist(person.at_m, person.spawned_m) < enough_m

    def _hidden(self, person: TemplatePerson, known: Sequence[TemplatePerson]) -> bool:
        """Whether another stands in the line of sight to a newcomer's top, at the depression of heads there."""
        rays, depressions = self._maps.view.viewing(np.array([person.at_m]))
        (ray_x, ray_y), rise = rays[0].tolist(), math.tan(depressions[0])
        for other in known:
            dx, dy = person.at_m[0] - other.at_m[0], person.at_m[1] - other.at_m[1]
            behind, beside = dx * ray_x + dy * ray_y, abs(dy * ray_x - dx * ray_y)
            if behind > 0 and beside < self._params.width_m and person.height_m + behind * rise < other.height_m:
                return True
        return False

    def _part_of(self, person: TemplatePerson, other: TemplatePerson) -> bool:
        """Not to be told apart from another person, or within that person's reach and much smaller."""
        maps, p = self._maps, self._params
        if inseparable(maps.view, person.at_m, other.at_m, p.detection.separation_m):
            return True
        return is_part_of(maps, person.at_m, other.at_m, p.part_area, p.arm_m, p.width_m / 2)


def small_beside(candidate: PersonCandidate, people: Sequence[TemplatePerson], params: TemplateTrackerParams) -> bool:
    """Whether a newcomer as low as furniture stands within an arm of a person, whose it is then."""
    place = candidate.x_m, candidate.y_m
    return candidate.height_m < CHAIR_M and any(math.dist(place, q.at_m) < params.arm_m for q in people)
