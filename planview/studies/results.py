"""Results of a study: a row per run in ``summary.csv``, and means of every configuration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planview.output.folder import RunInfo
from planview.studies.study import Configuration

if TYPE_CHECKING:
    from pandas import DataFrame

FIGURES = (
    "mota", "idf1", "hota", "significant_errors", "switches", "position_error_mean_m", "height_error_mean_m",
    "people", "elapsed_s",
)  # fmt: skip
"""Figures of a run, in the order of the table."""


def run_figures(info: RunInfo, scores: dict[str, Any]) -> dict[str, float]:
    """Select the figures of a run from its scores (``Evaluation.to_json``; empty without truth); those that the data
    cannot give are left out."""
    values = scores | {"people": info.people, "elapsed_s": info.elapsed_s}
    if "significant_errors" in scores:
        values["significant_errors"] = scores["significant_errors"]["total"]
    return {name: float(values[name]) for name in FIGURES if values.get(name) is not None}


@dataclass(frozen=True)
class JobResult:
    """One run: its figures, or why it failed, in one sentence.

    Attributes:
        reused: an earlier study did it.
    """

    recording: str
    configuration: Configuration
    seed: int
    folder: Path | None = None
    figures: dict[str, float] = field(default_factory=dict)
    error: str = ""
    reused: bool = False

    def to_json(self) -> dict[str, Any]:
        """A run of ``sweep --json``."""
        return {
            "recording": self.recording,
            "settings": list(self.configuration.settings),
            "seed": self.seed,
            "folder": self.folder and str(self.folder),
            "error": self.error or None,
            "reused": self.reused,
            **self.figures,
        }


def table_of(results: Sequence[JobResult]) -> DataFrame:
    """A row per run: recording, varied parameters, seed, state, figures (NaN where unknown), folder, error."""
    from pandas import DataFrame  # half a second

    rows = []
    for result in results:
        rows.append(
            {
                "recording": result.recording,
                **result.configuration.values,
                "seed": result.seed,
                "state": "failed" if result.error else "done",
                **dict.fromkeys(FIGURES, math.nan),
                **result.figures,
                "folder": str(result.folder or ""),
                "error": result.error,
            }
        )
    return DataFrame(rows)


def means_of(results: Sequence[JobResult]) -> DataFrame:
    """A row per configuration: number of runs that finished, and means of their figures; those that no run has are left
    out."""
    table = table_of(results)
    table["configuration"] = [result.configuration.label for result in results]
    by_configuration = table[table["state"] == "done"].groupby("configuration", sort=False)
    means = by_configuration[list(FIGURES)].mean().dropna(axis="columns", how="all")
    means.insert(0, "runs", by_configuration.size())
    return means


def summary_csv(results: Sequence[JobResult]) -> str:
    """``table_of`` as text."""
    return str(table_of(results).to_csv(index=False, float_format="%.6g", lineterminator="\n"))
