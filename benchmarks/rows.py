"""One measured figure of a bench, beside the limit it must keep."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """A figure measured against known truth.

    Attributes:
        name: what was measured, e.g. "boards: focal error".
        value: the figure, in ``unit``.
        unit: e.g. "px", "%", "deg"; empty for a plain number.
        limit: what it must not exceed; NaN when it is only reported.
        ok: whether it keeps the limit.
    """

    name: str
    value: float
    unit: str
    limit: float
    ok: bool
