"""Appearance of people in foreground points: colours by body height (our choice, see ``identity``)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.types import F64
from planview.maps.builder import FloorPoints
from planview.maps.colour import CODES, chromatic, smoothing
from planview.tracking._appearance_kernels import colour_histograms
from planview.tracking.appearance_model import Appearance, AppearanceModel

PART_TOPS = (0.5, 0.85)
"""Where legs end and the head begins, as shares of the body height (anthropometric tables: crotch 0.47 to 0.5,
shoulders 0.82)."""
FLOOR_SHARE = 0.1
"""Lower points are left out: shoes and the floor's own colour."""
CHROMATIC_MIN = 0.3
"""Share of trunk or legs in colours other than grey from which a stranger is unlikely to look the same."""
_SMOOTHING, _CHROMATIC = smoothing(), chromatic()


def appearances(
    points: FloorPoints,
    places_m: Sequence[tuple[float, float]],
    bodies_m: Sequence[float],
    heights_m: Sequence[float],
    radius_m: float,
) -> list[Appearance]:
    """Appearance of all people, each point counting for the nearest person.

    Args:
        points: foreground points; without colours only heights are told.
        places_m: (x, y) of K people [m].
        bodies_m: their body heights, which tell the parts apart [m].
        heights_m: tops of their heads as measured now [m], NaN where they are not.
        radius_m: how far from its axis a body reaches [m].
    """
    histograms = np.zeros((len(places_m), len(PART_TOPS) + 1, CODES), dtype=np.float32)
    if points.colours is not None and len(places_m):
        people: F64 = np.array([(*xy, h) for xy, h in zip(places_m, bodies_m, strict=True)], dtype=np.float64)
        bounds = np.array((FLOOR_SHARE, *PART_TOPS))
        colour_histograms(points.xyz, points.area, points.colours, people, radius_m, bounds, histograms)
        histograms = histograms @ _SMOOTHING
    return [
        Appearance(np.asarray(h, dtype=np.float32), math.nan if math.isnan(tall) else tall)
        for h, tall in zip(histograms, heights_m, strict=True)
    ]


def is_distinctive(model: AppearanceModel) -> bool:
    """Whether clothes tell a person from strangers: grey and black are worn by many, and by all in grey video."""
    clothes = slice(0, len(PART_TOPS))
    share = model.colours[clothes] @ _CHROMATIC / np.maximum(model.counts[clothes], 1e-9)
    return bool((share >= CHROMATIC_MIN).any())
