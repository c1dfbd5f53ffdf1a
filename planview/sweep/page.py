"""The page that compares runs: those of a study, ranked, or those of folders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from planview.drawing.style import page_of
from planview.evaluation.significant import SignificantError
from planview.output.folder import RunInfo, write_result
from planview.output.report.page import errors_of, figure_text, flat_settings, scores_of
from planview.output.report.plots import COLOURS, Picture, floor_plot, new_figure, picture, plain_text, png_bytes
from planview.output.run_folder import RunFolder
from planview.sweep.results import BOOTSTRAP_DRAWS, LEVEL, JobResult, Ranked, ranked, why_no_intervals
from planview.sweep.study import FIGURES, Configuration, FigureName, Study, run_figures

LABEL_MAX = 60
"""Characters of a configuration's label at its bar; the table has it whole."""
ROWS_MAX = 200
"""Configurations in the table, and failed runs; summary.csv has them all."""
BARS_MAX = 40
"""Configurations in the picture."""
DOT_COLOUR, MEAN_COLOUR = "#9db2cf", "#1f4e9c"


def ranking_plot(ranking: Sequence[Ranked], figure: FigureName) -> bytes:
    """Mean and interval of a figure per configuration, best on top."""
    picture, axes = new_figure(8.0, 1.2 + 0.28 * len(ranking))
    for row, shown in enumerate(ranking):
        estimate = shown.figures[figure]
        axes.plot([estimate.low, estimate.high], [row, row], color=DOT_COLOUR, linewidth=4, solid_capstyle="butt")
        axes.plot(estimate.mean, row, marker="o", markersize=5, color=MEAN_COLOUR)
    labels = [f"{place}. {_short(shown.configuration.label)}" for place, shown in enumerate(ranking, 1)]
    axes.set_yticks(range(len(ranking)), labels, fontsize=8)
    axes.set_ylim(len(ranking) - 0.5, -0.5)
    axes.set_xlabel(FIGURES[figure].label)
    return png_bytes(picture)


def parameter_plot(ranking: Sequence[Ranked], name: str, figure: FigureName) -> bytes:
    """A figure over the values of a parameter: a dot per configuration, their mean per value as a line."""
    picture, axes = new_figure(5.0, 3.4)
    means: dict[str, list[float]] = {}
    for row in ranking:
        means.setdefault(row.configuration.value(name), []).append(row.figures[figure].mean)
    try:
        at = {value: float(value) for value in sorted(means, key=float)}
    except ValueError:  # words
        at = {value: float(place) for place, value in enumerate(sorted(means))}
        axes.set_xticks(list(at.values()), list(map(_short, at)), fontsize=8)
    for value, x in at.items():
        axes.plot([x] * len(means[value]), means[value], linestyle="", marker="o", markersize=4, color=DOT_COLOUR)
    axes.plot(list(at.values()), [np.mean(means[value]) for value in at], color=MEAN_COLOUR, marker="s", markersize=4)
    axes.set_xlabel(plain_text(name))
    axes.set_ylabel(FIGURES[figure].label)
    return png_bytes(picture)


def recordings_plot(ranking: Sequence[Ranked], runs: Sequence[JobResult], figure: FigureName) -> bytes:
    """A figure by recording, a line per configuration (of the first ones, best first)."""
    from pandas import DataFrame  # half a second

    picture, axes = new_figure(8.0, 3.6)
    names = list(dict.fromkeys(run.recording for run in runs))
    table = DataFrame([[run.configuration.label, run.recording, run.figures.get(figure)] for run in runs])
    means = table.groupby([0, 1])[2].mean().unstack()[names]  # by configuration and recording
    for place, (shown, colour) in enumerate(zip(ranking, COLOURS, strict=False), 1):
        row = means.loc[shown.configuration.label].to_numpy(np.float64)
        known = np.flatnonzero(np.isfinite(row))
        axes.plot(known, row[known], marker="o", markersize=4, color=colour, label=f"{place}.", linewidth=1)
    axes.set_xticks(range(len(names)), list(map(_short, names)), fontsize=8, rotation=30, ha="right")
    axes.set_ylabel(FIGURES[figure].label)
    axes.legend(fontsize=8, ncols=5, frameon=False)
    return png_bytes(picture)


def _short(text: str) -> str:
    text = plain_text(text)
    return text if len(text) <= LABEL_MAX else f"...{text[-LABEL_MAX:]}"


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


class SharedError(NamedTuple):
    """An error with its note in every run that makes it."""

    frame: int
    kind: str
    person: str
    notes: list[str]


def study_page(study: Study, runs: Sequence[JobResult], ranking: Sequence[Ranked], title: str) -> str:
    """The page of a study as text."""
    stopped = f", {study.frames} frames of each recording" if study.frames else ""
    about = f"{study.tracker}, {study.method}{stopped}, ranked by {FIGURES[study.objective].label}"
    return _page(runs, ranking, study.objective, title, about, _pictures(study, runs, ranking))


def write_comparison(folders: Sequence[Path], path: Path, truth: Path | None = None) -> None:
    """Write a page that compares runs of a recording: a configuration each, named by the settings that differ.

    Args:
        folders: of runs, at least one.
        path: of the page.
        truth: file of the true people; ``truth.csv`` of each recording where not given.
    Raises:
        InputError: a folder without tracks, or a file that cannot be read.
        WorkError: the page cannot be written.
    """
    names, folders_of = _names(folders), [RunFolder(folder, truth) for folder in folders]
    scores = [scores_of(run) for run in folders_of]
    errors = [errors_of(known) for known in scores]
    runs = [
        JobResult(run.info.input, Configuration((f"run={name}", *differing)), 0, run.path, run_figures(run.info, known))
        for name, run, known, differing in zip(names, folders_of, scores, _settings(folders_of), strict=True)
    ]
    pictures = [picture(f"Floor: {name}", floor_plot(run)) for name, run in zip(names, folders_of, strict=True)]
    shared = shared_errors(errors, folders_of[0].clock.frame_s)
    about = "Runs with their settings that differ"
    write_result(path, _page(runs, ranked(runs, "mota"), "mota", f"{len(runs)} runs", about, pictures, names, shared))


def _page(
    runs: Sequence[JobResult], ranking: Sequence[Ranked], objective: FigureName, title: str, about: str,
    pictures: Sequence[Picture], names: Sequence[str] = (), errors: Sequence[SharedError] = (),
) -> str:  # fmt: skip
    return page_of(
        "planview.sweep",
        "study.html.j2",
        title=title,
        about=about,
        runs=runs,
        failed=[run for run in runs if run.error],
        ranking=ranking,
        rows_max=ROWS_MAX,
        figures=FIGURES,
        columns=[name for name in FIGURES if any(name in row.figures for row in ranking)],
        objective=objective,
        why_no_intervals=why_no_intervals(runs),
        level=LEVEL,
        draws=BOOTSTRAP_DRAWS,
        pictures=pictures,
        names=names,
        errors=errors,
    )


def _names(folders: Sequence[Path]) -> list[str]:
    """The last parts of the folders' names, as many as make them different."""
    parts = [folder.resolve().parts for folder in folders]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(p[-depth:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [str(folder) for folder in folders]


def _settings(runs: Sequence[RunFolder]) -> list[list[str]]:
    """The settings in which runs differ."""

    def all_of(info: RunInfo) -> dict[str, str]:
        versions = {f"version of {name}": version for name, version in info.versions.items()}
        known = {"recording": info.input, "tracker": info.tracker, **versions, **flat_settings(info.config)}
        return {name: figure_text(value) for name, value in known.items()}

    tables = [all_of(run.info) for run in runs]
    varied = [n for n in dict.fromkeys(n for table in tables for n in table) if len({t.get(n) for t in tables}) > 1]
    return [[f"{name}={table.get(name, '-')}" for name in varied] for table in tables]


def shared_errors(errors: Sequence[Sequence[SignificantError]], frame_s: float) -> list[SharedError]:
    """Errors of every run by frame; those of one kind and person within a second are one row."""
    rows: list[SharedError] = []
    for n, mine in enumerate(errors):
        for error in mine:
            person = f"P{error.truth_id}" if error.truth_id is not None else ""
            same = [row for row in rows if (row.kind, row.person, row.notes[n]) == (error.kind, person, "")]
            row = next((row for row in same if abs(row.frame - error.frame) * frame_s <= 1.0), None)
            if row is None:
                row = SharedError(error.frame, error.kind, person, [""] * len(errors))
                rows.append(row)
            row.notes[n] = f"frame {error.frame}: {error.note}"
    return sorted(rows, key=lambda row: row.frame)
