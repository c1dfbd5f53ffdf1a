"""Tripwires and zones in pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.types import F64
from planview.drawing.style import TRIPWIRE, ZONE, Rgb

LARGEST_COORDINATE = 1e5
"""As far from the origin as rules.toml may have points [m or px]."""


@dataclass(frozen=True, eq=False)
class Rule:
    """A tripwire or zone: (N, 2) points on the floor [m], or in the image [px]."""

    name: str
    is_line: bool
    on_floor: bool
    points: F64

    @property
    def colour(self) -> Rgb:
        """Colour in all pictures."""
        return TRIPWIRE if self.is_line else ZONE


def rules_of(counts: dict[str, Any]) -> list[Rule]:
    """The rules in the ``rules`` object of counts.json. Raises InputError: points that no rule can have."""
    rules = []
    for name, rule in counts.items():
        if isinstance(rule, dict) and rule.get("points"):
            points = _read_points(name, rule["points"])
            rules.append(Rule(name, rule.get("kind") == "tripwire", rule.get("plane") == "floor", points))
    return rules


def _read_points(name: str, listed: Any) -> F64:
    try:
        points = np.array(listed, dtype=np.float64).reshape(len(listed), 2)
    except (OverflowError, TypeError, ValueError):
        points = np.full((1, 2), np.nan)
    if not (np.abs(points) <= LARGEST_COORDINATE).all():
        raise InputError(f"counts.json: expected points of rule {name!r:.40} up to 1e5, found {listed!s:.80}")
    return points
