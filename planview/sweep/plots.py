"""Pictures of a study as PNG bytes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planview.output.report.plots import COLOURS, new_figure, plain_text, png_bytes
from planview.sweep.figures import FIGURES, FigureName
from planview.sweep.ranking import Ranked
from planview.sweep.results import JobResult

LABEL_MAX = 60
"""Characters of a configuration beside its bar; the table has it whole."""


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
