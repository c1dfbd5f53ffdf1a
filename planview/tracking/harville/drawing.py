"""What the tracker shows when asked why."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.types import F32
from planview.maps.grid import Grid
from planview.tracking.base import Drawing, TrackerDebug
from planview.tracking.harville.state import TemplatePerson


def draw(people: Sequence[TemplatePerson], grid: Grid, width_m: float) -> TrackerDebug:
    """Search rectangles, templates' outlines (2 W_avg wide) with scores, and the templates themselves."""
    searches, outlines, labels = [], [], []
    tiles: dict[str, F32] = {}
    for person in people:
        name = person.existence.track_id
        searches.append(_square(*person.searched_m, (person.reach_cells + 0.5) * grid.cell_m))
        outlines.append(_square(*person.predicted_m, width_m))
        labels.append(f"{name}: {person.score:.2f}")
        tiles[f"template/{name}/height"] = person.template_height.copy()
        tiles[f"template/{name}/occupancy"] = person.template_occupancy.copy()
    drawings = (
        Drawing("search", "floor", tuple(searches)),
        Drawing("template", "floor", tuple(outlines), tuple(labels)),
    )
    return TrackerDebug(drawings, dict(tiles))


def _square(x: float, y: float, half: float) -> F32:
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    return np.array([(x + half * i, y + half * j) for i, j in corners], dtype=np.float32)
