"""Scores of recordings, each alone and all together: what ``suite`` and ``accuracy`` print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.options import number
from planview.evaluation.result import KINDS, Evaluation
from planview.evaluation.significant import poisson_upper


@dataclass(frozen=True)
class SceneScore:
    """The scores of one way of tracking one recording.

    Attributes:
        name, seed: which recording.
        evaluation: from ``evaluate_tracks``.
        recording: its folder.
        frames, duration_s: its length, in frames and [s].
        folder: where tracks.csv and run.json are; None when they were not kept.
    """

    name: str
    seed: int
    evaluation: Evaluation
    recording: Path
    frames: int
    duration_s: float
    folder: Path | None = None

    def to_json(self) -> dict[str, Any]:
        return {
            "scene": self.name,
            "seed": self.seed,
            "out": str(self.folder) if self.folder else None,
            **self.evaluation.to_json(),
            "recording": str(self.recording),
            "frames": self.frames,
            "duration_s": self.duration_s,
        }


@dataclass(frozen=True)
class Totals:
    """All recordings together; errors are pooled over matches, MOTA and IDF1 over rows.

    Attributes:
        minutes: length of the recordings.
        truth_rows: that count.
        significant: significant errors by kind and in total.
        events: moments that these come from (``grouped_events``).
        strict: lost, missed and false tracks as significant ones, and every change of identity (CLEAR).
        significant_per_10_min, events_per_10_min, strict_per_10_min: the same in ten minutes, and the largest mean that
            is not refuted by so few at 95 % (Poisson); NaN for no recordings.
        position_error_m, position_std_m, height_error_m: means and deviation over matches; NaN without one.
    """

    minutes: float
    truth_rows: int
    significant: dict[str, int]
    events: int
    strict: int
    significant_per_10_min: tuple[float, float]
    events_per_10_min: tuple[float, float]
    strict_per_10_min: tuple[float, float]
    mota: float
    idf1: float
    switches: int
    position_error_m: float
    position_std_m: float
    height_error_m: float

    def to_json(self) -> dict[str, Any]:
        figures = asdict(self)
        for name in ("significant", "events", "strict"):
            rate = f"{name}_per_10_min"
            figures[rate], figures[f"{rate}_upper"] = figures[rate]
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in figures.items()}


def totals(scores: Sequence[SceneScore]) -> Totals:
    """All recordings together; what nothing is known of is NaN."""
    every = [score.evaluation for score in scores]
    minutes = sum(score.duration_s for score in scores) / 60
    rows = sum(e.truth_rows for e in every)
    both = rows + sum(e.track_rows for e in every)
    wrong = sum(e.clear.misses + e.clear.false_positives + e.clear.switches for e in every)
    position = np.concatenate([e.position_error_m for e in every] or [np.empty(0)])
    height = np.concatenate([e.height_error_m for e in every] or [np.empty(0)])
    kinds = [error.kind for e in every for error in e.significant]
    switches = sum(e.clear.switches for e in every)
    events, strict = sum(e.events for e in every), len(kinds) - kinds.count("swapped") + switches

    def per_10_min(count: int) -> tuple[float, float]:
        return (10 * count / minutes, 10 * poisson_upper(count) / minutes) if minutes else (math.nan, math.nan)

    return Totals(
        minutes=minutes,
        truth_rows=rows,
        significant={"total": len(kinds), **{kind: kinds.count(kind) for kind in KINDS}},
        events=events,
        strict=strict,
        significant_per_10_min=per_10_min(len(kinds)),
        events_per_10_min=per_10_min(events),
        strict_per_10_min=per_10_min(strict),
        mota=1 - wrong / rows if rows else math.nan,
        idf1=2 * sum(e.identity.idtp for e in every) / both if both else math.nan,
        switches=switches,
        position_error_m=float(position.mean()) if len(position) else math.nan,
        position_std_m=float(position.std()) if len(position) else math.nan,
        height_error_m=float(height.mean()) if len(height) else math.nan,
    )


def scores_json(scores: Sequence[SceneScore]) -> dict[str, Any]:
    """Every recording, and all together."""
    return {"scenes": [score.to_json() for score in scores], "totals": totals(scores).to_json()}


def print_scores(what: str, scores: Sequence[SceneScore], console: Console) -> None:
    """A row per recording and one of all together, then every error."""
    table = Table(what, "seed", "rows", "significant", "events", "MOTA", "IDF1", "switch", "pos cm", "height")
    for column in (*table.columns[1:3], *table.columns[4:]):
        column.justify = "right"
    for name, seed, group in [(s.name, str(s.seed), [s]) for s in scores] + [("all", "", list(scores))]:
        t = totals(group)
        if not seed:
            table.add_section()
        kinds = ", ".join(f"{kind} {n}" for kind, n in t.significant.items() if n and kind != "total") or "none"
        table.add_row(
            name if seed else f"all, {t.minutes:.1f} min", seed, str(t.truth_rows), kinds, str(t.events),
            number(t.mota), number(t.idf1), str(t.switches), number(t.position_error_m, 100, 1),
            number(t.height_error_m, 100, 1),
        )  # fmt: skip
    console.print(table)
    t = totals(scores)
    rates = (
        (t.significant_per_10_min, "significant errors"),
        (t.events_per_10_min, "events"),
        (t.strict_per_10_min, "with every change of identity"),
    )
    text = ", ".join(f"{rate:.1f} (at most {upper:.1f}) {what}" for (rate, upper), what in rates)
    console.print(f"in 10 minutes, with the 95 % bound of so few: {text}", highlight=False, soft_wrap=True)
    for score in scores:
        for error in score.evaluation.significant:
            where = f"{what}: {score.name} ({score.seed}) frame {error.frame}"
            who = f"person {error.truth_id}, track {error.track_id}"
            console.print(f"{where}: {error.kind}, {who}: {error.note}", highlight=False, soft_wrap=True)
