"""One page that compares runs by settings, errors and time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import JsonValue

from planview.drawing.style import page_of
from planview.evaluation.result import KINDS
from planview.evaluation.significant import SignificantError
from planview.output.folder import write_result
from planview.output.report import plots
from planview.output.report.page import errors_of, figure_text, flat_settings, scores_of, words_of
from planview.output.report.plots import picture
from planview.output.run_folder import RunFolder

ERRORS_MAX = 100
_HIGHER = ("mota", "idf1", "hota", "det_a", "ass_a", "mostly_tracked")
_LOWER = (
    "switches", "fragmentations", "mostly_lost", "misses", "false_positives", "position_error_mean_m",
    "position_error_std_m", "height_error_mean_m", "strict_identity_changes",
)  # fmt: skip


class ComparedFigure(NamedTuple):
    """A figure of every run, ready to print, and the numbers of the runs that have the best one."""

    name: str
    texts: list[str]
    best: list[int]


class SharedError(NamedTuple):
    """An error with its note in every run that makes it."""

    frame: int
    kind: str
    person: str
    notes: list[str]


class _ComparedRun(NamedTuple):
    name: str
    results: RunFolder
    scores: dict[str, Any]
    errors: list[SignificantError]


def write_comparison(folders: Sequence[Path], path: Path, truth: Path | None = None) -> None:
    """Write a page that compares runs.

    Args:
        folders: of runs, at least one.
        path: of the page.
        truth: file of the true people; ``truth.csv`` of each recording where not given.
    Raises:
        InputError: a folder without tracks, or a file that cannot be read.
        WorkError: the page cannot be written.
    """
    runs = []
    for name, folder in zip(_names(folders), folders, strict=True):
        results = RunFolder(folder, truth)
        scores = scores_of(results)
        runs.append(_ComparedRun(name, results, scores, errors_of(scores)))
    pictures = [picture(f"Floor: {run.name}", plots.floor_plot(run.results)) for run in runs]
    for run in runs:
        for bars in plots.identity_pictures(run.results, run.errors)[-1:]:
            pictures.append(bars._replace(title=f"{bars.title}: {run.name}"))
    page = page_of(
        "planview.output.report",
        "compare.html.j2",
        title=f"{len(runs)} runs",
        names=[run.name for run in runs],
        settings=_settings(runs),
        scores=_scores(runs) if any(run.scores for run in runs) else [],
        errors=shared_errors([run.errors for run in runs], runs[0].results.clock.frame_s),
        errors_max=ERRORS_MAX,
        stages=_stages(runs),
        pictures=pictures,
    )
    write_result(path, page)


def _names(folders: Sequence[Path]) -> list[str]:
    """The last parts of the folders' names, as many as make them different."""
    parts = [folder.resolve().parts for folder in folders]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(p[-depth:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [str(folder) for folder in folders]


def _settings(runs: Sequence[_ComparedRun]) -> list[ComparedFigure]:
    flat: list[dict[str, JsonValue]] = []
    for info in (run.results.info for run in runs):
        versions = {f"version of {name}": version for name, version in info.versions.items()}
        flat.append({"recording": info.input, "tracker": info.tracker, **versions, **flat_settings(info.config)})
    names = list(dict.fromkeys(name for settings in flat for name in settings))
    rows = [ComparedFigure(name, [figure_text(settings.get(name)) for settings in flat], []) for name in names]
    return [row for row in rows if len(set(row.texts)) > 1]


def _scores(runs: Sequence[_ComparedRun]) -> list[ComparedFigure]:
    rows = [_row(words_of(n), [run.scores.get(n) for run in runs], max) for n in _HIGHER]
    rows += [_row(words_of(n), [run.scores.get(n) for run in runs], min) for n in _LOWER]
    for kind in ("total", *KINDS):
        values = [(run.scores.get("significant_errors") or {}).get(kind) for run in runs]
        rows.append(_row(f"significant errors, {words_of(kind)}", values, min))
    return rows


def _row(name: str, values: Sequence[float | None], best: Callable[[Sequence[float]], float]) -> ComparedFigure:
    known = [value for value in values if value is not None and not math.isnan(value)]
    top = best(known) if len(set(known)) > 1 else math.nan
    return ComparedFigure(
        name, [figure_text(value) for value in values], [n for n, value in enumerate(values) if value == top]
    )


def _stages(runs: Sequence[_ComparedRun]) -> list[ComparedFigure]:
    infos = [run.results.info for run in runs]
    names = list(dict.fromkeys(stage for info in infos for stage in info.stages_ms))
    rows = [_row(f"{name} [ms]", [info.stages_ms.get(name) for info in infos], min) for name in names]
    rates = [info.frames_read / info.elapsed_s if info.elapsed_s > 0 else None for info in infos]
    return [*rows, _row("frames per second", rates, max)]


def shared_errors(errors: Sequence[Sequence[SignificantError]], frame_s: float) -> list[SharedError]:
    """Errors of every run by frame; those of one kind and person within a second are one row (our choice)."""
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
