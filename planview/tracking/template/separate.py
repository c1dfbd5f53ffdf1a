"""Whether a newcomer is a body of its own, and not a part of a person or a thing (our choice; the paper has none)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planview.maps.builder import PlanViewMaps
from planview.tracking.detection import inseparable
from planview.tracking.newcomers import is_part_of
from planview.tracking.template.params import TemplateTrackerParams
from planview.tracking.template.state import TemplatePerson

SEATED_M = 1.4
"""Heads of seated adults are below this [m] (anthropometric tables: seat 0.45 m, sitting height up to 0.95 m)."""


class Separate:
    """Judges one frame's newcomers.

    Args:
        maps: of the frame.
    """

    def __init__(self, maps: PlanViewMaps, params: TemplateTrackerParams) -> None:
        self._maps, self._params = maps, params

    def __call__(self, person: TemplatePerson, known: Sequence[TemplatePerson]) -> bool:
        """Whether a newcomer is neither a part of one of the people known nor a thing that was put down."""
        return not any(self._part_of(person, other) for other in known) and not self._put_down(person)

    def _put_down(self, person: TemplatePerson) -> bool:
        """As low as a seated person, and never moved since it appeared."""
        moved = math.dist(person.at_m, person.spawned_m)
        return person.height_m < SEATED_M and moved < self._params.moved_m

    def _part_of(self, person: TemplatePerson, other: TemplatePerson) -> bool:
        """Not to be told apart from another person, or within that person's reach and much smaller."""
        maps, p = self._maps, self._params
        if inseparable(maps.view, person.at_m, other.at_m, p.detection.separation_m):
            return True
        return is_part_of(maps, person.at_m, other.at_m, p.part_area, p.arm_m, p.width_m / 2)
