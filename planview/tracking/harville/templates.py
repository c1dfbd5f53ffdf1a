"""Templates adapt to the maps around their person, and are re-centered when they slip (Harville 2002, section 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.types import F32, F64
from planview.tracking.harville._kernels import adapt, occupancy_peak
from planview.tracking.harville.params import TemplateTrackerParams
from planview.tracking.harville.state import TemplateFrame, TemplatePerson


def blend(frame: TemplateFrame, person: TemplatePerson, people: F64, me: int, gain: float) -> tuple[float, float]:
    """Blend the maps around a person into the person's templates.

    Args:
        people: (K, 2) padded cells of all people observed; cells nearer to another are that person's.
        me: the person's row in ``people``.
        gain: 1 copies, 0 keeps.
    Returns:
        Share of template cells with height, and the distance of their centroid from the centre [m].
    """
    half = len(person.template_height) // 2
    row, col = round(people[me, 0]) - half, round(people[me, 1]) - half
    share, off_row, off_col = adapt(
        person.template_height, person.template_occupancy, frame.height, frame.occupancy,
        row, col, people, me, gain, frame.maps.occupancy_min,
    )  # fmt: skip
    return share, math.hypot(off_row, off_col) * frame.maps.grid.cell_m


def renew(frame: TemplateFrame, person: TemplatePerson, found: Sequence[TemplatePerson]) -> None:
    """Replace a person's templates by the maps at the person's place."""
    person.template_height[:] = 0.0
    person.template_occupancy[:] = 0.0
    cells = frame.padded_cells([q.at_m for q in found])
    blend(frame, person, cells, found.index(person), 1.0)


def slipped(share: float, offset_m: float, params: TemplateTrackerParams) -> str:
    """Why a template must be re-centered; empty when it sits well."""
    if share < params.recentre_filled:
        return f"template {share:.0%} filled"
    if offset_m > params.recentre_offset * params.width_m:
        return f"centroid {offset_m:.2f} m off"
    return ""


def nearest_peak(frame: TemplateFrame, person: TemplatePerson, people: F64, me: int) -> tuple[float, float] | None:
    """The occupancy maximum within 2 W_avg that is no other person's [m]; None when there is none."""
    n = len(person.template_height)
    grid = frame.maps.grid
    peak_row, peak_col = occupancy_peak(
        frame.occupancy, round(people[me, 0]) - n // 2, round(people[me, 1]) - n // 2, n, people, me
    )
    row, col = peak_row - frame.half, peak_col - frame.half
    if peak_row < 0 or not (0 <= row < grid.n_rows and 0 <= col < grid.n_cols):
        return None
    return grid.centre_of(row, col)


def gaussian_model(person: TemplatePerson, width_m: float, cell_m: float) -> tuple[F32, F32]:
    """Height and occupancy of a person that is nothing but a Gaussian: as tall and as much surface as the templates.

    Args:
        width_m: torso width, two deviations [m].
        cell_m: side of a cell [m].
    """
    cells = np.arange(len(person.template_height)) - len(person.template_height) // 2
    squared = (cells[:, None] ** 2 + cells[None, :] ** 2) * (cell_m / width_m * 2) ** 2
    weight = np.exp(-squared / 2)
    occupancy = person.template_occupancy.sum() * weight / weight.sum()
    return np.where(squared <= 1, person.height_m, 0.0).astype(np.float32), occupancy.astype(np.float32)
