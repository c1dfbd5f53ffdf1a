"""What came of the jobs of a study: rows of ``summary.csv``."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planview.sweep.figures import FIGURES
from planview.sweep.space import Configuration


@dataclass(frozen=True)
class JobResult:
    """One run.

    Attributes:
        recording: as the study calls it.
        folder: of the run, None where there is none.
        figures: what ``run_figures`` gives; empty where it failed.
        error: why it failed, in one sentence; empty where it did not.
        reused: an earlier study had done it.
        from_maps: tracked from a plan-view recording that the study made.
    """

    recording: str
    configuration: Configuration
    seed: int
    folder: Path | None = None
    figures: dict[str, float] = field(default_factory=dict)
    error: str = ""
    reused: bool = False
    from_maps: bool = False

    def to_json(self) -> dict[str, Any]:
        """A run of ``sweep --json``."""
        return {
            "recording": self.recording,
            "settings": list(self.configuration.settings),
            "seed": self.seed,
            "folder": str(self.folder) if self.folder else None,
            "error": self.error or None,
            "reused": self.reused,
            "from_maps": self.from_maps,
            **self.figures,
        }


def summary_csv(results: Sequence[JobResult]) -> str:
    """A row per run: recording, varied parameters, seed, state, figures, folder."""
    names = list(dict.fromkeys(s.partition("=")[0] for r in results for s in r.configuration.settings))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["recording", *names, "seed", "state", "tracked_from", *FIGURES, "folder", "error"])
    for result in results:
        figures = [f"{result.figures[name]:.6g}" if name in result.figures else "" for name in FIGURES]
        row = [
            result.recording, *(result.configuration.value(name) for name in names), str(result.seed),
            "failed" if result.error else "done", "maps" if result.from_maps else "recording", *figures,
            str(result.folder or ""), result.error,
        ]  # fmt: skip
        writer.writerow([_cell(value) for value in row])
    return text.getvalue()


def _cell(value: str) -> str:
    """Spreadsheets take a text that begins like a formula for one: an apostrophe keeps it a text."""
    try:
        float(value)
    except ValueError:
        return f"'{value}" if value[:1] in ("=", "+", "-", "@", "\t", "\r") else value
    return value
