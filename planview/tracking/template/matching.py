"""Finding known people again: equation (4), the most certain first (Harville 2002, section 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.types import F64
from planview.tracking.template._kernels import clear, search
from planview.tracking.template.params import TemplateTrackerParams
from planview.tracking.template.state import Frame, Person


def match_people(frame: Frame, people: Sequence[Person], params: TemplateTrackerParams, height_max_m: float) -> None:
    """Look for everybody; sets ``matched``, ``score`` and, where found, ``at_m``.

    Who is found is cleared from the free maps before the next is looked for.
    """
    placed: list[tuple[float, float]] = []
    result = np.empty(7)
    order = sorted(people, key=lambda q: (q.state == "lost", q.kalman.position_std_m, q.track_id))
    for i, person in enumerate(order):
        _search(frame, person, placed, params, height_max_m, result)
        person.score = float(result[0])
        person.matched = person.score <= params.match.score_max and _plausible(frame, person, params, result)
        if person.matched:
            person.at_m = frame.maps.grid.centre_of(result[1], result[2])
            placed.append((float(result[1]), float(result[2])))
            _clear(frame, person, [q for q in order[i + 1 :] if q.state != "lost"], params.reach_m)


def _search(
    frame: Frame,
    person: Person,
    placed: Sequence[tuple[float, float]],
    params: TemplateTrackerParams,
    height_max_m: float,
    result: F64,
) -> None:
    m, cell = params.match, frame.maps.grid.cell_m
    row, col = frame.maps.grid.index_of(person.kalman.x_m, person.kalman.y_m)
    reach_m = min(params.search_sigma * person.kalman.position_std_m, params.search_max_m)
    person.reach_cells = max(1, math.ceil(reach_m / cell))
    person.searched_m = (person.kalman.x_m, person.kalman.y_m)
    one_sided = height_max_m / 3
    filled = person.template_occupancy[person.template_height > 0]
    typical = max(float(filled.mean()) if filled.size else 0.0, frame.maps.occupancy_min, 1e-9)
    search(
        person.template_height, person.template_occupancy, frame.free_height, frame.free_occupancy,
        row, col, person.reach_cells, one_sided,
        m.height_weight / one_sided, m.occupancy_weight / typical, m.distance_weight * cell / params.width_m,
        m.separation_weight, params.width_m / 2 / cell, np.array(placed).reshape(-1, 2), result,
    )  # fmt: skip


def _plausible(frame: Frame, person: Person, params: TemplateTrackerParams, result: F64) -> bool:
    """A lost person is only found again where somebody about as tall is."""
    if person.state != "lost":
        return True
    row, col, n = int(result[1]), int(result[2]), len(person.template_height)
    tall = float(frame.free_height[row : row + n, col : col + n].max())
    lowest = min(params.detection.height_min_m, person.height_m)
    return lowest <= tall <= person.tallest_m + params.grow_max_m


def _clear(frame: Frame, person: Person, waiting: Sequence[Person], reach_m: float) -> None:
    """Clear what a body's points cover, arms included, stretched along the ray by depth noise.

    Cells nearer to where somebody else is expected are left to him.
    """
    cell = frame.maps.grid.cell_m
    across, along, ray = frame.maps.view.footprint(*person.at_m, reach_m)
    row, col = frame.padded_cells([person.at_m])[0]
    others = frame.padded_cells([(q.kalman.x_m, q.kalman.y_m) for q in waiting])
    clear(frame.free_height, frame.free_occupancy, row, col, ray[1], ray[0], across / cell, along / cell, others)
