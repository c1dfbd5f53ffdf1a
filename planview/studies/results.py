"""Results of a study: ``summary.csv``, configurations ranked with confidence intervals, and their page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planview.drawing.style import page_of
from planview.output.report.plots import Picture, new_figure, picture, plain_text, png_bytes
from planview.studies.study import FIGURES, Configuration, FigureName, Study

if TYPE_CHECKING:
    from pandas import DataFrame, Series

BOOTSTRAP_DRAWS = 1000
RECORDINGS_MIN = 5
"""Fewer recordings are too few for an interval: a bootstrap of four has 35 samples."""
LEVEL = 0.95


@dataclass(frozen=True)
class JobResult:
    """One run: its figures, or why it failed, in one sentence; ``reused``: an earlier study did it; ``from_maps``:
    tracked from a plan-view recording that the study made."""

    recording: str
    configuration: Configuration
    seed: int
    folder: Path | None = None
    figures: dict[str, float] = field(default_factory=dict)
    error: str = ""
    reused: bool = False
    from_maps: bool = False

    def to_json(self) -> dict[str, Any]:
        """A run of ``sweep --json``."""
        own = {name: value for name, value in vars(self).items() if name not in ("configuration", "figures")}
        own |= {"settings": list(self.configuration.settings), "error": self.error or None}
        return own | {"folder": str(self.folder) if self.folder else None} | self.figures


def table_of(results: Sequence[JobResult]) -> DataFrame:
    """A row per run: recording, varied parameters, seed, state, figures (NaN where unknown), folder, error."""
    from pandas import DataFrame  # half a second

    names = list(dict.fromkeys(s.partition("=")[0] for r in results for s in r.configuration.settings))
    rows = [
        {"recording": r.recording}
        | {name: r.configuration.value(name) for name in names}
        | {"seed": r.seed, "state": "failed" if r.error else "done"}
        | {"tracked_from": "maps" if r.from_maps else "recording"}
        | {name: r.figures.get(name, math.nan) for name in FIGURES}
        | {"folder": str(r.folder or ""), "error": r.error}
        for r in results
    ]
    return DataFrame(rows)


def summary_csv(results: Sequence[JobResult]) -> str:
    """``table_of`` as text."""
    return str(table_of(results).map(_cell).to_csv(index=False, float_format="%.6g", lineterminator="\n"))


def _cell(value: object) -> object:
    """Spreadsheets take a text that begins like a formula for one: an apostrophe keeps it a text."""
    if not isinstance(value, str) or value[:1] not in ("=", "+", "-", "@", "\t", "\r"):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


@dataclass(frozen=True)
class Estimate:
    """A mean with its interval; NaN where there is none (fewer than RECORDINGS_MIN recordings)."""

    mean: float
    low: float = math.nan
    high: float = math.nan

    def text(self, digits: int, sign: str = "") -> str:
        """With its interval in brackets; "-" without a mean."""
        if math.isnan(self.mean):
            return "-"
        interval = "" if math.isnan(self.low) else f" [{self.low:{sign}.{digits}f}, {self.high:{sign}.{digits}f}]"
        return f"{self.mean:{sign}.{digits}f}{interval}"


@dataclass(frozen=True)
class Ranked:
    """A configuration with its figures, and numbers of runs that finished and failed; ``behind``: of the objective, its
    mean less the first configuration's, run by run."""

    configuration: Configuration
    figures: dict[FigureName, Estimate]
    behind: Estimate
    runs: int
    failed: int

    def to_json(self) -> dict[str, Any]:
        """A configuration of ``sweep --json``."""
        row: dict[str, Any] = {"settings": list(self.configuration.settings), "runs": self.runs, "failed": self.failed}
        for name, found in self.figures.items():
            row[name] = {key: None if math.isnan(number) else number for key, number in vars(found).items()}
        return row


def why_no_intervals(results: Sequence[JobResult]) -> str:
    """Why estimates have no interval, in one sentence; empty where they have some."""
    count = len({result.recording for result in results if result.figures})
    return f"no {LEVEL:.0%} intervals: they need {RECORDINGS_MIN} recordings, found {count}" * (count < RECORDINGS_MIN)


def ranked(results: Sequence[JobResult], objective: FigureName) -> list[Ranked]:
    """Best first; those without the objective, then those whose runs did not all finish, come last.

    Recordings count the same, and the seeds of a recording among themselves. Intervals hold LEVEL of BOOTSTRAP_DRAWS
    means over recordings, sampled with replacement; the scatter of seeds is in the mean of each recording.
    """
    table = table_of(results).set_index(["recording", "seed"])
    places: dict[Configuration, list[int]] = {}
    for i, result in enumerate(results):
        places.setdefault(result.configuration, []).append(i)
    runs_of = {configuration: table.iloc[rows] for configuration, rows in places.items()}
    means = {configuration: _of_recordings(runs[objective]).mean() for configuration, runs in runs_of.items()}

    def order(configuration: Configuration) -> tuple[bool, bool, float]:
        lacks_some = bool(runs_of[configuration][objective].isna().any())
        return math.isnan(means[configuration]), lacks_some, -FIGURES[objective].better * means[configuration]

    ranking: list[Ranked] = []
    for configuration in (ordered := sorted(runs_of, key=order)):
        runs = runs_of[configuration]
        known = {name: estimate(runs[name]) for name in FIGURES if runs[name].notna().any()}
        behind = estimate(runs[objective] - runs_of[ordered[0]][objective])
        failed = int((runs["state"] == "failed").sum())
        ranking.append(Ranked(configuration, known, behind, len(runs) - failed, failed))
    return ranking


def estimate(values: Series[float]) -> Estimate:
    """Of a figure by recording and seed, NaN where a run is missing."""
    means = _of_recordings(values)
    if len(means) < RECORDINGS_MIN:
        return Estimate(float(means.mean()))
    from scipy.stats import bootstrap  # half a second, and only many recordings need it

    found = bootstrap(
        (means.to_numpy(),), np.mean, n_resamples=BOOTSTRAP_DRAWS, confidence_level=LEVEL, method="percentile", rng=0
    )
    return Estimate(float(means.mean()), *map(float, found.confidence_interval))


def _of_recordings(values: Series[float]) -> Series[float]:
    """The mean over seeds of each recording that has one."""
    return values.groupby(level="recording", sort=False).mean().dropna()


LABEL_MAX = 60
"""Characters of a configuration's label at its bar; the table has it whole."""
ROWS_MAX = 200
"""Configurations in the table, and failed runs; summary.csv has them all."""
BARS_MAX = 40
"""Configurations in the picture."""
DOT_COLOUR, MEAN_COLOUR = "#9db2cf", "#1f4e9c"


def _ranking_plot(ranking: Sequence[Ranked], figure: FigureName) -> bytes:
    """Mean and interval of a figure per configuration, best on top."""
    picture, axes = new_figure(8.0, 1.2 + 0.28 * len(ranking))
    for row, shown in enumerate(ranking):
        estimate = shown.figures[figure]
        axes.plot([estimate.low, estimate.high], [row, row], color=DOT_COLOUR, linewidth=4, solid_capstyle="butt")
        axes.plot(estimate.mean, row, marker="o", markersize=5, color=MEAN_COLOUR)
    labels = [f"{place}. {_short(shown.configuration.label)}" for place, shown in enumerate(ranking, 1)]
    axes.set_yticks(range(len(ranking)), labels, fontsize=8)
    axes.set(ylim=(len(ranking) - 0.5, -0.5), xlabel=FIGURES[figure].label)
    return png_bytes(picture)


def _parameter_plot(ranking: Sequence[Ranked], name: str, figure: FigureName) -> bytes:
    """A figure over the values of a parameter: a dot per configuration, their mean per value as a line."""
    picture, axes = new_figure(5.0, 3.4)
    values = [row.configuration.value(name) for row in ranking]
    means = np.array([row.figures[figure].mean for row in ranking])
    try:
        at = {value: float(value) for value in sorted(set(values), key=float)}
    except ValueError:  # words
        at = {value: float(place) for place, value in enumerate(sorted(set(values)))}
        axes.set_xticks(list(at.values()), list(map(_short, at)), fontsize=8)
    axes.plot([at[value] for value in values], means, linestyle="", marker="o", markersize=4, color=DOT_COLOUR)
    middle = [means[[value == one for value in values]].mean() for one in at]
    axes.plot(list(at.values()), middle, color=MEAN_COLOUR, marker="s", markersize=4)
    axes.set(xlabel=plain_text(name), ylabel=FIGURES[figure].label)
    return png_bytes(picture)


def _short(text: str) -> str:
    text = plain_text(text)
    return text if len(text) <= LABEL_MAX else f"...{text[-LABEL_MAX:]}"


def _pictures(study: Study, runs: Sequence[JobResult], ranking: Sequence[Ranked]) -> list[Picture]:
    figure = study.objective
    known = [row for row in ranking if figure in row.figures]
    if not known:
        return []
    note = "Mean (dot)" if why_no_intervals(runs) else f"Mean (dot) and {LEVEL:.0%} interval (bar)"
    note += f" of the first {BARS_MAX}." if len(known) > BARS_MAX else "."
    pictures = [picture(f"Ranking by {FIGURES[figure].label}", _ranking_plot(known[:BARS_MAX], figure), note)]
    note = "A dot per configuration; the line joins the means of each value."
    pictures += [picture(name, _parameter_plot(known, name, figure), note) for name in study.parameters]
    return pictures


def study_page(study: Study, runs: Sequence[JobResult], ranking: Sequence[Ranked], title: str) -> str:
    """The page of a study as text."""
    stopped = f", {study.frames} frames of each recording" if study.frames else ""
    about = f"{study.tracker}, {study.method}{stopped}, ranked by {FIGURES[study.objective].label}"
    return page_of(
        "planview.studies", "study.html.j2", runs=runs, ranking=ranking, objective=study.objective, figures=FIGURES,
        title=title, about=about, pictures=_pictures(study, runs, ranking),
        failed=[run for run in runs if run.error], rows_max=ROWS_MAX, level=LEVEL, draws=BOOTSTRAP_DRAWS,
        columns=[name for name in FIGURES if any(name in row.figures for row in ranking)],
        why_no_intervals=why_no_intervals(runs),
    )  # fmt: skip
