"""Where the scene hides people, and how far away nothing does: learned from people who walk there (our choice)."""

from __future__ import annotations

import numpy as np

from calib.types import F32, U8, Bool
from planview.tracking.human_model import _measure_kernels as measuring
from planview.tracking.human_model._kernels import Spans

DEPTH_M = 0.5
"""How much nearer than where a person sits others may pass and still show that nothing hides it [m] (our choice)."""
LIMITS = measuring.HidingLimits(expected_s=0.5, shown=0.15, memory_s=10.0)
"""Our choice: two people have walked there, or one slowly; noise is foreground too; things are moved."""


class Hiding:
    """What walkers have shown of the scene.

    Attributes:
        mask: (H, W) uint8, not 0 where the scene hides people: none of their foreground is expected there.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.mask: U8 = np.zeros(shape, np.uint8)
        self._expected_s: F32 = np.zeros(shape, np.float32)
        self._shown_s: F32 = np.zeros(shape, np.float32)
        self._open_m: F32 = np.zeros(shape, np.float32)

    def reset(self) -> None:
        """Nothing is learned."""
        for learned in (self.mask, self._expected_s, self._shown_s, self._open_m):
            learned[:] = 0

    def learn(self, evidence: U8, cover: U8, spans: Spans, rows: tuple[int, int], away_m: float, dt_s: float) -> None:
        """Note where the core of a walker's model shows foreground and where it does not.

        Args:
            evidence, cover: (H, W) uint8 foreground, and number of models.
            spans, rows: the core.
            away_m: distance of the walker from below the camera [m].
            dt_s: since the frame before [s].
        """
        measuring.learn_hiding(evidence, cover, spans, *rows, dt_s, LIMITS, self._expected_s, self._shown_s, self.mask)
        measuring.learn_open(evidence, cover, spans, *rows, away_m, self._open_m)

    def share_in_the_open(self, pixels: Bool, away_m: float) -> float:
        """Share of (H, W) pixels where people at least so far away have been observed."""
        return float((self._open_m[pixels] >= away_m - DEPTH_M).mean()) if pixels.any() else 0.0
