"""The figures of a run that studies compare."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from planview.evaluation.result import Evaluation
from planview.output.folder import RunInfo

FigureName = Literal[
    "mota", "idf1", "hota", "significant_errors", "switches", "position_error_mean_m", "height_error_mean_m",
    "people", "elapsed_s",
]  # fmt: skip


class Figure(NamedTuple):
    """How a figure is called, printed and judged; ``better`` is +1 where more is better, -1 where less is."""

    label: str
    digits: int
    better: int


FIGURES: dict[FigureName, Figure] = {
    "mota": Figure("MOTA", 3, 1),
    "idf1": Figure("IDF1", 3, 1),
    "hota": Figure("HOTA", 3, 1),
    "significant_errors": Figure("significant errors", 2, -1),
    "switches": Figure("switches", 2, -1),
    "position_error_mean_m": Figure("position error [m]", 3, -1),
    "height_error_mean_m": Figure("height error [m]", 3, -1),
    "people": Figure("people", 1, 1),
    "elapsed_s": Figure("tracking time [s]", 1, -1),
}


def run_figures(info: RunInfo, evaluation: Evaluation | None) -> dict[str, float]:
    """Figures of a run, with its scores where there is truth; those that the data cannot give are left out."""
    found: dict[str, Any] = {"people": info.people, "elapsed_s": info.elapsed_s}
    if evaluation is not None:
        scores = evaluation.to_json()
        found |= {name: scores.get(name) for name in FIGURES if name not in found}
        found["significant_errors"] = len(evaluation.significant)
    return {name: float(value) for name, value in found.items() if value is not None}
