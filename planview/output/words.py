"""Names and values of results as people read them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

_UNITS = {"s": "s", "ms": "ms", "m": "m", "px": "px", "deg": "°", "mps": "m/s"}


def words_of(name: str) -> str:
    """A key as people read it, its unit in brackets: mean_dwell_s -> mean dwell [s]."""
    words = re.split("[_.]", name)
    if len(words) > 1 and words[-1] in _UNITS:
        words[-1] = f"[{_UNITS[words[-1]]}]"
    return " ".join(words)


def figure_text(value: object) -> str:
    """A value as text, a number with four digits."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    if isinstance(value, list | tuple):
        return ", ".join(map(figure_text, value))
    return f"{value:,}" if type(value) is int else json.dumps(value)


def figures_of(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The numbers of values by what they are called, ready to print."""
    return [(words_of(name), figure_text(value)) for name, value in values.items() if isinstance(value, int | float)]


def flat_settings(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values by their dotted names."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            flat |= flat_settings(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat
