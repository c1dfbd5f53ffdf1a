"""What placed models cover of the foreground, as fractions of their areas."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.types import F64
from planview.tracking.human_model import _kernels as kernels
from planview.tracking.human_model import _measure_kernels as measuring

MIN_VISIBLE = 0.25
"""Part of a model that must be visible for its foreground fraction to be taken at its word (our choice): a head and
shoulders."""


class Extent(NamedTuple):
    """How an observed body differs from the model along its axis (the paper's "refine target").

    Attributes:
        axis_px: (2,) from foot to head.
        low, high: how far the ends of what hangs together with the body's middle are beyond the model's feet and head
            along it, as a fraction of the height; NaN where the middle does not show.
        head: the same of the head, looked for by itself; NaN where none shows.
        height: observed height over the model's; NaN where the middle does not show.
    """

    axis_px: F64
    low: float
    high: float
    head: float
    height: float

    @property
    def error(self) -> float:
        """Larger error of an end, as a fraction of the height."""
        return max(abs(self.low), abs(self.high))


@dataclass(eq=False)
class Measurement:
    """What the placed models cover, one row per target.

    Attributes:
        position: (N, 2) foot pixels.
        counts: see ``_measure_kernels.Coverage``.
    """

    position: F64
    counts: measuring.Coverage

    @cached_property
    def area(self) -> F64:
        """Pixels of the model, at least 1."""
        return np.maximum(1, self.counts.area).astype(np.float64)

    @cached_property
    def shared(self) -> F64:
        """Fraction of the model that other models cover too."""
        return self.counts.shared / self.area

    @cached_property
    def alone(self) -> F64:
        """Fraction of the model that is foreground no other model covers."""
        return 0.5 * self.counts.alone / self.area

    @cached_property
    def precision(self) -> F64:
        """Foreground fraction of the part that is this model's alone and not hidden by the scene.

        A sliver beside what hides the rest tells as little as its share of the model.
        """
        visible = self.area - self.counts.shared - self.counts.hidden
        return 0.5 * self.counts.alone / np.maximum(MIN_VISIBLE * self.area, visible)

    @cached_property
    def hidden(self) -> F64:
        """Fraction of the model where other models or the scene hide what there is."""
        return (self.counts.shared + self.counts.hidden) / self.area

    @cached_property
    def moving(self) -> F64:
        """Moving fraction of the model."""
        return self.counts.moving / self.area

    def score(self, i: int, overlap_weight: float) -> float:
        """M of model i, in its own areas (``_kernels.matching_score``, without a ring)."""
        taken = int(self.counts.shared[i])
        hidden = int(self.counts.hidden[i])
        counts = kernels.MatchCounts(int(self.counts.area[i]), int(self.counts.alone[i]), taken, 0, hidden, 0)
        # In Python: a call of the compiled function costs more than what it computes.
        return float(kernels.matching_score.py_func(counts, float(self.area[i]), overlap_weight))

    def discard(self, i: int) -> None:
        """Take what model i covers for another person's."""
        # The fractions are computed from the counts once.
        for name in ("shared", "alone", "precision", "hidden", "moving"):
            self.__dict__.pop(name, None)
        for column in self.counts:
            if column is not self.counts.area:
                column[i] = 0
