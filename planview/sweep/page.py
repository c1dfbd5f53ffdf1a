"""``report.html`` of a study: one self-contained page that ranks its configurations."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planview.drawing.style import page_of
from planview.sweep import plots
from planview.sweep.figures import FIGURES, FigureName
from planview.sweep.ranking import DRAWS, LEVEL, Estimate, Ranked
from planview.sweep.results import JobResult
from planview.sweep.study import Study

ROWS_MAX = 200
"""Configurations in the table, and failed runs; summary.csv has them all."""
BARS_MAX = 40
"""Configurations in the picture."""
RECORDINGS_MAX = 40


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
        tiles=_tiles(runs, ranking),
        from_maps=any(run.from_maps for run in runs),
        columns=[FIGURES[name].label for name in columns],
        rows=[_row(row, columns, study.objective) for row in ranking[:ROWS_MAX]],
        more_rows=max(0, len(ranking) - ROWS_MAX),
        pictures=_pictures(study, runs, ranking),
        failed=failed[:ROWS_MAX],
        more_failed=max(0, len(failed) - ROWS_MAX),
        level=f"{LEVEL:.0%}",
        draws=DRAWS,
    )


def _tiles(runs: Sequence[JobResult], ranking: Sequence[Ranked]) -> list[tuple[str, str]]:
    return [
        ("configurations", str(len(ranking))),
        ("recordings", str(len({run.recording for run in runs}))),
        ("seeds", str(len({run.seed for run in runs}))),
        ("runs", str(len(runs))),
        ("failed", str(sum(bool(run.error) for run in runs))),
    ]


def _row(row: Ranked, columns: Sequence[FigureName], objective: FigureName) -> dict[str, Any]:
    cells = [_text(row.figures.get(name), FIGURES[name].digits) for name in columns]
    return {
        "label": row.configuration.label,
        "runs": f"{row.runs}" + (f", {row.failed} failed" if row.failed else ""),
        "behind": _text(row.behind, FIGURES[objective].digits, sign="+"),
        "cells": cells,
    }


def _text(value: Estimate | None, digits: int, sign: str = "") -> str:
    if value is None or math.isnan(value.mean):
        return "-"
    interval = "" if math.isnan(value.low) else f" [{value.low:{sign}.{digits}f}, {value.high:{sign}.{digits}f}]"
    return f"{value.mean:{sign}.{digits}f}{interval}"


def _pictures(study: Study, runs: Sequence[JobResult], ranking: Sequence[Ranked]) -> list[tuple[str, str, str]]:
    """Title, data URI and a note of each."""
    figure = study.objective
    known = [row for row in ranking if figure in row.figures]
    if not known:
        return []
    label = FIGURES[figure].label
    shown = known[:BARS_MAX]
    note = f"Mean (dot) and {LEVEL:.0%} interval (bar)" + (f" of the first {BARS_MAX}." if known != shown else ".")
    pictures = [_picture(f"Ranking by {label}", plots.ranking_plot(shown, figure), note)]
    for name in study.parameters:
        note = "A dot per configuration; the line joins the means of each value."
        pictures.append(_picture(name, plots.parameter_plot(known, name, figure), note))
    if 1 < len({run.recording for run in runs}) <= RECORDINGS_MAX:
        note = "Lines are configurations by their place in the ranking."
        pictures.append(_picture("By recording", plots.recordings_plot(known, runs, figure), note))
    return pictures


def _picture(title: str, png: bytes, note: str) -> tuple[str, str, str]:
    return title, "data:image/png;base64," + base64.b64encode(png).decode("ascii"), note
