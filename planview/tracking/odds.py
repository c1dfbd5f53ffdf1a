"""Probabilities of existence as log-odds, and survival in the Bernoulli filter of Vo, Vo and Pham 2010."""

from __future__ import annotations

import math


def probability(log_odds: float) -> float:
    """Probability of these log-odds."""
    return 1.0 / (1.0 + math.exp(-max(log_odds, -700.0)))


def log_odds(share: float) -> float:
    """Log-odds of a probability."""
    return math.log(share / (1 - share))


def survive(before: float, time_s: float, stays_s: float) -> float:
    """Log-odds after a time in which somebody stays for ``stays_s`` on average."""
    stays = probability(before) * math.exp(-time_s / stays_s)
    return math.log(max(stays, 1e-6) / max(1 - stays, 1e-6))
