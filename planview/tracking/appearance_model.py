"""What is lasting about a person's look: colours by body height, and body height (our choice)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from calib.types import F32

HEIGHTS = 64
"""Measurements of a person's height that are remembered: four seconds at 15 Hz, several steps."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """What one clear measurement tells about a person; parts or values that are not known are zero or NaN.

    Attributes:
        colours: (parts, bins) float32, a histogram per part of the body; a part that is not visible is all zero.
        height_m: body height, standing [m].
    """

    colours: F32
    height_m: float = math.nan


@dataclass(slots=True, eq=False)
class AppearanceModel:
    """Running mean of the clear measurements of one person.

    Attributes:
        colours: (parts, bins) float32 sum of histograms; counts: (parts,) how many went into each.
        heights: recent standing heights [m].
        looks: number of measurements.
    """

    colours: F32
    counts: F32
    heights: list[float] = field(default_factory=list)
    looks: int = 0

    @staticmethod
    def empty(like: Appearance | AppearanceModel) -> AppearanceModel:
        """Nothing remembered yet, with the shape of an appearance."""
        return AppearanceModel(np.zeros_like(like.colours), np.zeros(len(like.colours), np.float32))

    def learn(self, appearance: Appearance, horizon: float = 100.0) -> None:
        """Add a measurement; older ones fade with a horizon of so many looks."""
        total = appearance.colours.sum(axis=1)
        visible = total > 0
        full = visible & (self.counts >= horizon)
        if full.any():
            fade = np.where(full, (horizon - 1) / horizon, 1.0).astype(np.float32)
            self.colours *= fade[:, None]
            self.counts *= fade
        # All zero where not visible, whatever it is divided by.
        self.colours += appearance.colours / np.where(visible, total, np.float32(1.0))[:, None]
        self.counts += visible
        self.looks += 1
        if not math.isnan(appearance.height_m):
            self.heights = [*self.heights, appearance.height_m][-HEIGHTS:]

    def merge(self, other: AppearanceModel) -> None:
        """Add another model's measurements of the same person."""
        self.colours += other.colours
        self.counts += other.counts
        self.heights = (self.heights + other.heights)[-HEIGHTS:]
        self.looks += other.looks

    @property
    def height_m(self) -> float:
        """Body height [m]: the upper quartile, since stooping and hidden heads only lower it; NaN while unknown."""
        return float(np.percentile(self.heights, 75)) if self.heights else math.nan
