"""When which pixels learn, and how much."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F32
from planview.foreground.params import ForegroundParams

TURNS = 4
"""Turns in which pixels learn, at most."""
TURN_S = 0.13
"""Each pixel learns about so often [s]: video at 30 frames per second teaches no more than at 7, and costs a fraction
where only every fourth frame is written back to memory."""


class UpdateSchedule:
    """Whose turn it is to learn, and how much: blocks take turns, so that every pixel learns every TURN_S seconds."""

    def __init__(self, params: ForegroundParams) -> None:
        self._params = params
        self._first_s = self._now_s = math.nan
        self._learned_s = [math.nan] * TURNS
        self._frame = 0

    @property
    def is_new(self) -> bool:
        """Whether there was no frame yet."""
        return math.isnan(self._first_s)

    @property
    def settled(self) -> bool:
        """Whether the start is over."""
        return self._now_s - self._first_s > self._params.settle_s

    def start(self, timestamp_s: float) -> None:
        """Begin with a first frame."""
        self._first_s = self._now_s = timestamp_s
        self._learned_s = [timestamp_s] * TURNS

    def rates(self, timestamp_s: float) -> F32:
        """(TURNS, 4) float32: Rates of every turn at this frame; zeros where it is not due."""
        dt = max(timestamp_s - self._now_s, 0.0)
        self._now_s = max(timestamp_s, self._now_s)
        self._frame += 1
        age_s = self._now_s - self._first_s
        n = 1 if age_s <= self._params.settle_s else min(max(round(TURN_S / max(dt, 1e-3)), 1), TURNS)
        rates = np.zeros((TURNS, 4), np.float32)
        for turn in range(self._frame % n, TURNS, n):
            # A gap in time counts as at most this much learning [s]: what happened in it was not
            # observed.
            rates[turn] = self._rates(min(self._now_s - self._learned_s[turn], 1.0), age_s)
            self._learned_s[turn] = self._now_s
        return rates

    def _rates(self, dt: float, age_s: float) -> tuple[float, float, float, float]:
        p = self._params
        start = dt / (age_s + dt) if 0 < age_s <= p.settle_s else 0.0
        weight, mean, fast = _rate(dt * p.learning_rate), _rate(dt * p.adaptation_rate), _rate(dt / p.settle_s)
        return max(weight, start), max(mean, start), max(fast, start), _rate(dt / p.activity_s)


def _rate(time_constants: float) -> float:
    """Share of the new observation after so many time constants."""
    return -math.expm1(-time_constants)
