"""``report.html`` of a study: one self-contained page that ranks its configurations, with pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planview.drawing.style import page_of
from planview.output.report.page import Picture, picture
from planview.output.report.plots import COLOURS, new_figure, plain_text, png_bytes
from planview.sweep.results import DRAWS, LEVEL, JobResult, Ranked, why_no_intervals
from planview.sweep.study import FIGURES, FigureName, Study

LABEL_MAX = 60
"""Characters of a configuration beside its bar; the table has it whole."""
ROWS_MAX = 200
"""Configurations in the table, and failed runs; summary.csv has them all."""
BARS_MAX = 40
"""Configurations in the picture."""


def ranking_plot(ranking: Sequence[Ranked], figure: FigureName) -> bytes:
    """Mean and interval of a figure per configuration, best on top."""
    picture, axes = new_figure(8.0, 1.2 + 0.28 * len(ranking))
    for row, ranked in enumerate(ranking):
        estimate = ranked.figures[figure]
        if not math.isnan(estimate.low):
            axes.plot([estimate.low, estimate.high], [row, row], color="#9db2cf", linewidth=4, solid_capstyle="butt")
        axes.plot(estimate.mean, row, marker="o", markersize=5, color="#1f4e9c")
    labels = [plain_text(ranked.configuration.label) for ranked in ranking]
    axes.set_yticks(range(len(ranking)), [f"{i}. {_short(text)}" for i, text in enumerate(labels, 1)], fontsize=8)
    axes.set_ylim(len(ranking) - 0.5, -0.5)
    axes.set_xlabel(FIGURES[figure].label)
    return png_bytes(picture)


def parameter_plot(ranking: Sequence[Ranked], name: str, figure: FigureName) -> bytes:
    """A figure over the values of a parameter: a dot per configuration, their mean per value as a line."""
    picture, axes = new_figure(5.0, 3.4)
    values = [ranked.configuration.value(name) for ranked in ranking]
    means = np.array([ranked.figures[figure].mean for ranked in ranking])
    numbers = [_number(value) for value in values]
    ordered = sorted(dict.fromkeys(values), key=lambda v: (_number(v), v))
    at = {value: _number(value) if not math.isnan(sum(numbers)) else float(i) for i, value in enumerate(ordered)}
    axes.plot([at[value] for value in values], means, linestyle="", marker="o", markersize=4, color="#9db2cf")
    by_value = [float(means[[v == value for v in values]].mean()) for value in ordered]
    axes.plot([at[value] for value in ordered], by_value, color="#1f4e9c", marker="s", markersize=4)
    if math.isnan(sum(numbers)):
        axes.set_xticks(list(at.values()), [plain_text(value) for value in at], fontsize=8)
    axes.set_xlabel(plain_text(name))
    axes.set_ylabel(FIGURES[figure].label)
    return png_bytes(picture)


def recordings_plot(ranking: Sequence[Ranked], runs: Sequence[JobResult], figure: FigureName) -> bytes:
    """A figure by recording, a line per configuration (of the first ones, best first)."""
    names = list(dict.fromkeys(run.recording for run in runs))
    picture, axes = new_figure(8.0, 3.6)
    for i, ranked in enumerate(ranking[: len(COLOURS)]):
        mine = [run for run in runs if run.configuration == ranked.configuration and figure in run.figures]
        known = [name for name in names if any(run.recording == name for run in mine)]
        means = [np.mean([run.figures[figure] for run in mine if run.recording == name]) for name in known]
        places = [names.index(name) for name in known]
        axes.plot(places, means, marker="o", markersize=4, color=COLOURS[i], label=f"{i + 1}.", linewidth=1)
    axes.set_xticks(
        range(len(names)), [_short(plain_text(name)) for name in names], fontsize=8, rotation=30, ha="right"
    )
    axes.set_ylabel(FIGURES[figure].label)
    axes.legend(fontsize=8, ncols=5, frameon=False)
    return png_bytes(picture)


def _short(text: str) -> str:
    return text if len(text) <= LABEL_MAX else f"...{text[-LABEL_MAX:]}"


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def study_page(study: Study, runs: Sequence[JobResult], ranking: Sequence[Ranked], out: Path) -> str:
    """The page as text; it makes no outside requests."""
    failed = [run for run in runs if run.error]
    columns = [name for name in FIGURES if any(name in row.figures for row in ranking)]
    return page_of(
        "planview.sweep",
        "study.html.j2",
        name=out.name,
        study=study,
        objective=FIGURES[study.objective],
        known=any(study.objective in row.figures for row in ranking),
        tiles=[
            ("configurations", str(len(ranking))),
            ("recordings", str(len({run.recording for run in runs}))),
            ("seeds", str(len({run.seed for run in runs}))),
            ("runs", str(len(runs))),
            ("failed", str(len(failed))),
        ],
        from_maps=any(run.from_maps for run in runs),
        columns=[FIGURES[name].label for name in columns],
        rows=[
            {
                "label": row.configuration.label,
                "runs": f"{row.runs}" + (f", {row.failed} failed" if row.failed else ""),
                "behind": row.behind.text(FIGURES[study.objective].digits, "+"),
                "cells": [f.text(FIGURES[n].digits) if (f := row.figures.get(n)) else "-" for n in columns],
            }
            for row in ranking[:ROWS_MAX]
        ],
        more_rows=max(0, len(ranking) - ROWS_MAX),
        pictures=_pictures(study, runs, ranking),
        failed=failed[:ROWS_MAX],
        more_failed=max(0, len(failed) - ROWS_MAX),
        no_intervals=why_no_intervals(runs),
        level=f"{LEVEL:.0%}",
        draws=DRAWS,
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
