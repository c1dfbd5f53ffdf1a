"""Scores of recordings, each alone and all together: what ``suite`` and ``accuracy`` print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.options import show
from planview.evaluation.result import KINDS, Evaluation, pooled
from planview.evaluation.significant import poisson_upper


@dataclass(frozen=True)
class SceneScore:
    """The scores of one way of tracking one recording of a length in frames and [s]; ``folder``: where tracks.csv and
    run.json are, when they were kept."""

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


def together(scores: Sequence[SceneScore]) -> Evaluation:
    """All recordings as one, as long as they are together."""
    return replace(pooled([score.evaluation for score in scores]), duration_s=sum(score.duration_s for score in scores))


def scores_json(scores: Sequence[SceneScore]) -> dict[str, Any]:
    """Every recording, and all together."""
    totals = together(scores).to_json() if scores else {}
    return {"scenes": [score.to_json() for score in scores], "totals": totals}


def print_scores(what: str, scores: Sequence[SceneScore]) -> None:
    """A row per recording and one of all together, then every error."""
    if not scores:
        return
    every = together(scores)
    rows = [_row({what: s.name, "seed": s.seed}, s.evaluation) for s in scores]
    show([*rows, _row({what: "all", "seed": ""}, every)])
    swapped = sum(error.kind == "swapped" for error in every.significant)
    counts = {
        "significant errors": len(every.significant),
        "events": every.events,
        "with every change of identity": len(every.significant) - swapped + every.clear.switches,
    }
    per = 600.0 / every.duration_s
    rates = (f"{per * n:.1f} (at most {per * poisson_upper(n):.1f}) {name}" for name, n in counts.items())
    print(f"in 10 minutes, of {every.duration_s / 60:.1f}, with the 95 % bound of so few: {', '.join(rates)}")
    for score in scores:
        for error in score.evaluation.significant:
            who = f"person {error.truth_id}, track {error.track_id}"
            print(f"{what}: {score.name} ({score.seed}) frame {error.frame}: {error.kind}, {who}: {error.note}")


def _row(names: dict[str, Any], evaluation: Evaluation) -> dict[str, Any]:
    figures = evaluation.to_json()
    kinds = [f"{kind} {n}" for kind in KINDS if (n := figures["significant_errors"][kind])]
    row = {**names, "rows": evaluation.truth_rows, "significant": ", ".join(kinds) or "none"}
    row |= {key: figures[key] for key in ("events", "mota", "idf1", "switches")}
    for name, key in (("pos cm", "position_error_mean_m"), ("height cm", "height_error_mean_m")):
        row[name] = None if figures[key] is None else round(100 * figures[key], 1)
    return row
