"""``report.html`` of a study: its configurations ranked, with pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pandas import DataFrame

from planview.drawing.style import page_of
from planview.output.report.plots import COLOURS, Picture, new_figure, picture, plain_text, png_bytes
from planview.sweep.results import DRAWS, LEVEL, JobResult, Ranked, why_no_intervals
from planview.sweep.study import FIGURES, FigureName, Study

LABEL_MAX = 60
"""Characters of a configuration's label at its bar; the table has it whole."""
ROWS_MAX = 200
"""Configurations in the table, and failed runs; summary.csv has them all."""
BARS_MAX = 40
"""Configurations in the picture."""
PALE, DARK = "#9db2cf", "#1f4e9c"


def ranking_plot(ranking: Sequence[Ranked], figure: FigureName) -> bytes:
    """Mean and interval of a figure per configuration, best on top."""
    picture, axes = new_figure(8.0, 1.2 + 0.28 * len(ranking))
    for row, ranked in enumerate(ranking):
        estimate = ranked.figures[figure]
        axes.plot([estimate.low, estimate.high], [row, row], color=PALE, linewidth=4, solid_capstyle="butt")
        axes.plot(estimate.mean, row, marker="o", markersize=5, color=DARK)
    labels = [f"{place}. {_short(ranked.configuration.label)}" for place, ranked in enumerate(ranking, 1)]
    axes.set_yticks(range(len(ranking)), labels, fontsize=8)
    axes.set_ylim(len(ranking) - 0.5, -0.5)
    axes.set_xlabel(FIGURES[figure].label)
    return png_bytes(picture)


def parameter_plot(ranking: Sequence[Ranked], name: str, figure: FigureName) -> bytes:
    """A figure over the values of a parameter: a dot per configuration, their mean per value as a line."""
    picture, axes = new_figure(5.0, 3.4)
    means: dict[str, list[float]] = {}
    for ranked in ranking:
        means.setdefault(ranked.configuration.value(name), []).append(ranked.figures[figure].mean)
    try:
        at = {value: float(value) for value in sorted(means, key=float)}
    except ValueError:  # words
        at = {value: float(place) for place, value in enumerate(sorted(means))}
        axes.set_xticks(list(at.values()), list(map(_short, at)), fontsize=8)
    for value, x in at.items():
        axes.plot([x] * len(means[value]), means[value], linestyle="", marker="o", markersize=4, color=PALE)
    axes.plot(list(at.values()), [np.mean(means[value]) for value in at], color=DARK, marker="s", markersize=4)
    axes.set_xlabel(plain_text(name))
    axes.set_ylabel(FIGURES[figure].label)
    return png_bytes(picture)


def recordings_plot(ranking: Sequence[Ranked], runs: Sequence[JobResult], figure: FigureName) -> bytes:
    """A figure by recording, a line per configuration (of the first ones, best first)."""
    picture, axes = new_figure(8.0, 3.6)
    names = list(dict.fromkeys(run.recording for run in runs))
    table = DataFrame([[run.configuration.label, run.recording, run.figures.get(figure)] for run in runs])
    means = table.groupby([0, 1])[2].mean().unstack()[names]  # by configuration and recording
    for place, (ranked, colour) in enumerate(zip(ranking, COLOURS, strict=False), 1):
        row = means.loc[ranked.configuration.label].to_numpy(np.float64)
        known = np.flatnonzero(np.isfinite(row))
        axes.plot(known, row[known], marker="o", markersize=4, color=colour, label=f"{place}.", linewidth=1)
    axes.set_xticks(range(len(names)), list(map(_short, names)), fontsize=8, rotation=30, ha="right")
    axes.set_ylabel(FIGURES[figure].label)
    axes.legend(fontsize=8, ncols=5, frameon=False)
    return png_bytes(picture)


def _short(text: str) -> str:
    text = plain_text(text)
    return text if len(text) <= LABEL_MAX else f"...{text[-LABEL_MAX:]}"


def study_page(study: Study, runs: Sequence[JobResult], ranking: Sequence[Ranked], title: str) -> str:
    """The page as text."""
    return page_of(
        "planview.sweep",
        "study.html.j2",
        title=title,
        study=study,
        runs=runs,
        failed=[run for run in runs if run.error],
        ranking=ranking,
        rows_max=ROWS_MAX,
        figures=FIGURES,
        columns=[name for name in FIGURES if any(name in row.figures for row in ranking)],
        objective=FIGURES[study.objective],
        why_no_intervals=why_no_intervals(runs),
        level=LEVEL,
        draws=DRAWS,
        pictures=_pictures(study, runs, ranking),
    )


def _pictures(study: Study, runs: Sequence[JobResult], ranking: Sequence[Ranked]) -> list[Picture]:
    figure = study.objective
    known = [row for row in ranking if figure in row.figures]
    if not known:
        return []
    label = FIGURES[figure].label
    shown = known[:BARS_MAX]
    note = "Mean (dot)" if why_no_intervals(runs) else f"Mean (dot) and {LEVEL:.0%} interval (bar)"
    note += f" of the first {BARS_MAX}." if known != shown else "."
    pictures = [picture(f"Ranking by {label}", ranking_plot(shown, figure), note)]
    for name in study.parameters:
        note = "A dot per configuration; the line joins the means of each value."
        pictures.append(picture(name, parameter_plot(known, name, figure), note))
    if 1 < len({run.recording for run in runs}) <= 40:
        note = "Lines are configurations by their place in the ranking."
        pictures.append(picture("By recording", recordings_plot(known, runs, figure), note))
    return pictures
