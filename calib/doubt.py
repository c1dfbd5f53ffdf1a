"""Hypotheses of what may be wrong with some data: each is undone, and the one under which the data fits is named.

Where a check finds one fault, a hypothesis undoes one, and a score of the result shows whether that was it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

Data = TypeVar("Data")
BETTER = 1.2
"""A hypothesis makes data fit better than it does as given by this factor: right ones do by 1.2 (a lens of another
size) to 100, wrong ones by 0.9 at most."""


@dataclass(frozen=True)
class Hypothesis(Generic[Data]):
    """One way in which data may not be what it seems.

    Attributes:
        name: what is so, a clause.
        remedy: what to do then, a clause.
        undo: makes of the data what it should be.
        odds: prior odds against it: the factor by which it must fit better than another one.
    """

    name: str
    remedy: str
    undo: Callable[[Data], Data]
    odds: float = 1.0

    def and_then(self, other: Hypothesis[Data]) -> Hypothesis[Data]:
        """Both at once; the other one is undone after this one."""
        return Hypothesis(
            f"{self.name} and {other.name}",
            f"{self.remedy}, and {other.remedy}",
            lambda data: other.undo(self.undo(data)),
            self.odds * other.odds,
        )


class Score(NamedTuple):
    """Fit of data: the logarithm of a likelihood or of a share, and what was measured, a clause."""

    value: float
    measured: str = ""


@dataclass(frozen=True)
class Finding:
    """The hypothesis under which data fits, what is measured then, and another one that explains it as well."""

    hypothesis: Hypothesis[Any]
    measured: str
    other: Finding | None = None

    def __str__(self) -> str:
        if self.other is None:
            return f"if {self.clause}: {self.hypothesis.remedy}"
        remedies = " or ".join(dict.fromkeys((self.hypothesis.remedy, self.other.hypothesis.remedy)))
        return f"either if {self.clause}, or if {self.other.clause}: {remedies}"

    @property
    def clause(self) -> str:
        """Clause that states the hypothesis with its consequence."""
        return f"{self.hypothesis.name}, {self.measured}"

    @property
    def names(self) -> str:
        """The hypothesis by name, or both."""
        if self.other is None:
            return self.hypothesis.name
        return f"{self.hypothesis.name} or {self.other.hypothesis.name}"


def best(
    data: Data,
    hypotheses: Iterable[Hypothesis[Data]],
    score: Callable[[Data], Score],
    *,
    margin: float = BETTER,
    alike: float = BETTER,
    least: float = -math.inf,
    ceiling: float = math.inf,
) -> Finding | None:
    """The hypothesis under which data fits best, and one that fits as well; None where none fits clearly better than
    the data as given.

    Args:
        margin: factor by which it must fit better than the data as given.
        alike: factor within which a second one fits as well.
        least: score below which nothing is explained.
        ceiling: score that no data exceeds; hypotheses that cannot win are not tried.
    """
    tried: list[tuple[float, Finding]] = []
    highest = -math.inf
    for hypothesis in hypotheses:
        against = math.log(hypothesis.odds)
        if ceiling - against < highest:
            continue
        result = score(hypothesis.undo(data))
        if result.value > -math.inf and result.value >= least:
            tried.append((result.value - against, Finding(hypothesis, result.measured)))
            highest = max(highest, result.value - against)
    tried.sort(key=lambda one: -one[0])
    if not tried or highest < score(data).value + math.log(margin):
        return None
    first = tried[0][1]
    for value, other in tried[1:]:
        if value > highest - math.log(alike) and other.names != first.names:
            return replace(first, other=other)
    return first


def shortlist(
    data: Data, hypotheses: Iterable[Hypothesis[Data]], score: Callable[[Data], Score], factor: float
) -> list[Hypothesis[Data]]:
    """The hypotheses under which data fits as well as under the best, or as given, within a factor."""
    scores = [(score(hypothesis.undo(data)).value, hypothesis) for hypothesis in hypotheses]
    highest = max([score(data).value, *(value for value, _ in scores)])
    return [hypothesis for value, hypothesis in scores if value > -math.inf and value >= highest - math.log(factor)]
