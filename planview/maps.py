"""Plan-view maps of height and occupancy (Harville 2002, section 3)."""

from __future__ import annotations

from dataclasses import dataclass

from calib.types import F32
from planview.grid import Grid


@dataclass(frozen=True, eq=False)
class PlanViewMaps:
    """Maps of one frame, all (n_rows, n_cols) float32 on the same grid.

    Attributes:
        grid: where the cells are.
        height_raw: highest point per cell [m], 0 where none fell.
        occupancy_raw: visible foreground surface per cell [m^2].
        height: smoothed and masked height H_masked [m].
        occupancy: smoothed occupancy O_sm [m^2].
        confidence: 0..1 per cell from the predicted depth deviation, None unless asked for.
    """

    grid: Grid
    height_raw: F32
    occupancy_raw: F32
    height: F32
    occupancy: F32
    confidence: F32 | None = None
