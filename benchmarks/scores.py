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
        strict: lost, missed and false tracks as significant ones, and every change of identity (CLEAR).
        significant_per_10_min, strict_per_10_min: the same for ten minutes.
        position_error_m, position_std_m, height_error_m: means and deviation over matches; NaN without one.
    """

    minutes: float
    truth_rows: int
    significant: dict[str, int]
    strict: int
    significant_per_10_min: float
    strict_per_10_min: float
    mota: float
    idf1: float
    switches: int
    position_error_m: float
    position_std_m: float
    height_error_m: float

    def to_json(self) -> dict[str, Any]:
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(self).items()}


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
    strict = len(kinds) - kinds.count("swapped") + switches
    return Totals(
        minutes=minutes,
        truth_rows=rows,
        significant={"total": len(kinds), **{kind: kinds.count(kind) for kind in KINDS}},
        strict=strict,
        significant_per_10_min=10 * len(kinds) / minutes if minutes else math.nan,
        strict_per_10_min=10 * strict / minutes if minutes else math.nan,
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
    """A row per recording and one of all together (errors of position and height in cm), then every error."""
    table = Table(what, "seed", "rows", "significant", "MOTA", "IDF1", "switch", "position", "height")
    for column in (*table.columns[1:3], *table.columns[4:]):
        column.justify = "right"
    for name, group in [(score.name, [score]) for score in scores] + [("all", list(scores))]:
        t, seed = totals(group), str(group[0].seed) if name != "all" else ""
        if name == "all":
            table.add_section()
            name = f"all, {t.minutes:.1f} min"
        kinds = ", ".join(f"{kind} {n}" for kind, n in t.significant.items() if n and kind != "total") or "none"
        place = f"{number(t.position_error_m, 100, 1)} ± {number(t.position_std_m, 100, 1)}"
        table.add_row(
            name, seed, str(t.truth_rows), kinds, number(t.mota), number(t.idf1), str(t.switches), place,
            number(t.height_error_m, 100, 1),
        )  # fmt: skip
    console.print(table)
    t = totals(scores)
    console.print(
        f"per 10 minutes: {t.significant_per_10_min:.1f} significant errors, {t.strict_per_10_min:.1f} with every "
        "change of identity"
    )
    for score in scores:
        for error in score.evaluation.significant:
            where = f"{what}: {score.name} ({score.seed}) frame {error.frame}"
            who = f"person {error.truth_id}, track {error.track_id}"
            console.print(f"{where}: {error.kind}, {who}: {error.note}", highlight=False)
