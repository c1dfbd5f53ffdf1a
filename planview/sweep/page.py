"""``report.html`` of a study: its configurations ranked, with pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planview.output.report.compare import Cell, Table, comparison_page
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
    for place, (ranked, colour) in enumerate(zip(ranking, COLOURS, strict=False), 1):
        values: dict[int, list[float]] = {}
        for run in runs:
            if run.configuration == ranked.configuration and figure in run.figures:
                values.setdefault(names.index(run.recording), []).append(run.figures[figure])
        means = [np.mean(values[x]) for x in sorted(values)]
        axes.plot(sorted(values), means, marker="o", markersize=4, color=colour, label=f"{place}.", linewidth=1)
    axes.set_xticks(range(len(names)), list(map(_short, names)), fontsize=8, rotation=30, ha="right")
    axes.set_ylabel(FIGURES[figure].label)
    axes.legend(fontsize=8, ncols=5, frameon=False)
    return png_bytes(picture)


def _short(text: str) -> str:
    text = plain_text(text)
    return text if len(text) <= LABEL_MAX else f"...{text[-LABEL_MAX:]}"


def study_page(study: Study, runs: Sequence[JobResult], ranking: Sequence[Ranked], out: Path) -> str:
    """The page as text."""
    failed, objective = [run for run in runs if run.error], FIGURES[study.objective]
    columns = [name for name in FIGURES if any(name in row.figures for row in ranking)]
    of_each = f", {study.frames} frames of each recording" if study.frames else ""
    notes = [f"{study.tracker}, {study.method}{of_each}, ranked by {objective.label}"]
    if study.objective not in columns:
        notes.append(
            f"No run has {objective.label}: configurations are not ranked. Truth is read from truth.csv, gt.txt or "
            "gt/gt.txt of each recording."
        )
    why = why_no_intervals(runs) or (
        f"in brackets the {LEVEL:.0%} interval of {DRAWS} bootstrap draws of recordings and of seeds; where that of a "
        "difference holds no 0, the two differ by more than the choice of recordings explains"
    )
    notes.append(
        f'Means over recordings of the means over seeds; {why}. "Less first" is the difference to the first '
        "configuration, run by run."
    )
    if any(run.from_maps for run in runs):
        notes.append(
            "Tracked from plan-view recordings made with the default tracker: with other tracker parameters an "
            "approximation of a full run (maps = false runs everything from the images)."
        )
    head = [f"{objective.label} less first", *(FIGURES[name].label for name in columns), "runs"]
    rows = []
    for place, row in enumerate(ranking[:ROWS_MAX], 1):
        figures = [f.text(FIGURES[n].digits) if (f := row.figures.get(n)) else "-" for n in columns]
        n_runs = f"{row.runs}" + (f", {row.failed} failed" if row.failed else "")
        behind = row.behind.text(objective.digits, "+")
        rows.append([Cell(text) for text in (f"{place}. {row.configuration.label}", behind, *figures, n_runs)])
    more, more_in = max(0, len(ranking) - ROWS_MAX), " in summary.csv"
    tables = [Table("Ranking", ["configuration", *head], rows, more=more, more_in=more_in)]
    if failed:
        cells = [
            [Cell(text) for text in (run.recording, run.configuration.label, f"{run.seed}", run.error)]
            for run in failed[:ROWS_MAX]
        ]
        head, more = ["recording", "configuration", "seed", "why"], max(0, len(failed) - ROWS_MAX)
        tables.append(Table("Failed runs", head, cells, of_numbers=False, more=more, more_in=more_in))
    tiles = [
        ("configurations", f"{len(ranking)}"),
        ("recordings", f"{len({run.recording for run in runs})}"),
        ("seeds", f"{len({run.seed for run in runs})}"),
        ("runs", f"{len(runs)}"),
        ("failed", f"{len(failed)}"),
    ]
    return comparison_page(out.name, notes, tables, _pictures(study, runs, ranking), tiles=tiles)


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
