"""A value measured in a recording, against its limit."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

Limit = float | tuple[float, float] | None


@dataclass(frozen=True)
class Check:
    """A measured value against its limit.

    Attributes:
        ok: whether the value keeps the limit; true when it could not be measured and need not be.
        value, unit: NaN when it could not be measured; no unit for plain numbers.
        limit: the bound, or (low, high); None when the value is only reported.
        rule: "at most", "at least", "between" or "reported".
        note: what it means, in one clause.
        warns: a value beyond the limit is a warning: results are worse for it, and still of use.
        std: standard deviation of the value; NaN where it is not known.
    """

    name: str
    ok: bool
    value: float
    unit: str = ""
    limit: Limit = None
    rule: str = "reported"
    note: str = ""
    warns: bool = False
    std: float = math.nan

    @property
    def failed(self) -> bool:
        """True if results cannot be trusted."""
        return not self.ok and not self.warns

    @property
    def is_unknown(self) -> bool:
        """True if a value that has a limit could not be measured."""
        return self.limit is not None and not math.isfinite(self.value)

    @property
    def number_text(self) -> str:
        """The value, to the first digit of its deviation where that is known; empty without a value."""
        if not math.isfinite(self.value):
            return ""
        if not self.std > 0:
            return f"{self.value:,.0f}" if self.value >= 1000 else f"{self.value:.3g}"
        digits = max(0, -math.floor(math.log10(self.std)))
        return f"{self.value:.{digits}f} ± {self.std:.{digits}f}"

    @property
    def limit_text(self) -> str:
        """The bound in words; empty where there is none."""
        if isinstance(self.limit, tuple):
            return f"{self.limit[0]:.3g} to {self.limit[1]:.3g}"
        return "" if self.limit is None else f"{self.rule} {self.limit:.3g}"

    @property
    def sentence(self) -> str:
        """A clause on a value beyond its limit."""
        if self.limit is None:
            return f"{self.name}: {self.note}"
        if self.is_unknown:
            return f"{self.name}: could not be measured ({self.note})"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name}: expected {self.limit_text}{unit}, found {self.number_text} ({self.note})"

    def to_json(self) -> dict[str, Any]:
        """Plain values; what could not be measured is null."""
        return asdict(self) | {"value": _or_none(self.value), "std": _or_none(self.std)}


def _or_none(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None


def limit_check(
    name: str, value: float, unit: str, note: str, *, least: float | None = None, most: float | None = None,
    needed: bool = False, warns: bool = False, std: float = math.nan,
) -> Check:  # fmt: skip
    """Passes inside the limits; a value that could not be measured fails only when it is needed."""
    limit: Limit = most
    rule = "reported" if most is None else "at most"
    if least is not None:
        limit = least if most is None else (least, most)
        rule = "at least" if most is None else "between"
    is_low = least is not None and value < least
    is_high = most is not None and value > most
    ok = not (is_low or is_high or (math.isnan(value) and needed))
    return Check(name, ok, value, unit, limit, rule, note, warns, std)
