"""What came of the jobs of a study: ``summary.csv``, and configurations ranked with confidence intervals."""

from __future__ import annotations

import csv
import io
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calib.types import F64
from planview.sweep.study import FIGURES, Configuration, FigureName

BOOTSTRAP_DRAWS = 1000
RECORDINGS_MIN = 5
"""Fewer recordings are too few for an interval: a bootstrap of four has 35 samples."""
LEVEL = 0.95


@dataclass(frozen=True)
class JobResult:
    """One run: its figures, or why it failed, in one sentence; ``reused``: an earlier study did it; ``from_maps``:
    tracked from a plan-view recording that the study made."""

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


@dataclass(frozen=True)
class Estimate:
    """A mean with its interval; NaN where there is none (fewer than RECORDINGS_MIN recordings)."""

    mean: float
    low: float
    high: float

    def text(self, digits: int, sign: str = "") -> str:
        """With its interval in brackets; "-" without a mean."""
        if math.isnan(self.mean):
            return "-"
        interval = "" if math.isnan(self.low) else f" [{self.low:{sign}.{digits}f}, {self.high:{sign}.{digits}f}]"
        return f"{self.mean:{sign}.{digits}f}{interval}"


@dataclass(frozen=True)
class Ranked:
    """A configuration with its figures, and numbers of runs that finished and failed; ``behind``: of the objective, its
    mean less the first configuration's, run by run."""

    configuration: Configuration
    figures: dict[FigureName, Estimate]
    behind: Estimate
    runs: int
    failed: int

    def to_json(self) -> dict[str, Any]:
        """A configuration of ``sweep --json``."""
        row: dict[str, Any] = {"settings": list(self.configuration.settings), "runs": self.runs, "failed": self.failed}
        for name, found in self.figures.items():
            row[name] = {key: None if math.isnan(number) else number for key, number in vars(found).items()}
        return row


def why_no_intervals(results: Sequence[JobResult]) -> str:
    """Why estimates have no interval, in one sentence; empty where they have some."""
    count = len({result.recording for result in results if result.figures})
    return f"no {LEVEL:.0%} intervals: they need {RECORDINGS_MIN} recordings, found {count}" * (count < RECORDINGS_MIN)


def ranked(results: Sequence[JobResult], objective: FigureName) -> list[Ranked]:
    """Best first; those without the objective, then those whose runs did not all finish, come last.

    Recordings count the same, and the seeds of a recording among themselves. Intervals hold LEVEL of BOOTSTRAP_DRAWS
    means over recordings, sampled with replacement; the scatter of seeds is in the mean of each recording.
    """
    places = {c: i for i, c in enumerate(dict.fromkeys(r.configuration for r in results))}
    names = {name: i for i, name in enumerate(dict.fromkeys(r.recording for r in results))}
    seeds = {seed: i for i, seed in enumerate(dict.fromkeys(r.seed for r in results))}
    table = np.full((len(places), len(FIGURES), len(names), len(seeds)), np.nan)
    failed = np.zeros(len(places), dtype=np.int64)
    for r in results:
        figures = [r.figures.get(name, np.nan) for name in FIGURES]
        table[places[r.configuration], :, names[r.recording], seeds[r.seed]] = figures
        failed[places[r.configuration]] += bool(r.error)
    judged = table[:, list(FIGURES).index(objective)]

    means = _mean_of_means(judged)

    def order(configuration: Configuration) -> tuple[bool, bool, float]:
        i = places[configuration]
        return math.isnan(means[i]), bool(np.isnan(judged[i]).any()), -FIGURES[objective].better * float(means[i])

    ranking, ordered = [], sorted(places, key=order)
    for configuration in ordered:
        i, first = places[configuration], judged[places[ordered[0]]]
        estimates = {name: estimate(values) for name, values in zip(FIGURES, table[i], strict=True)}
        known = {name: found for name, found in estimates.items() if not math.isnan(found.mean)}
        n_runs = len(names) * len(seeds) - int(failed[i])
        ranking.append(Ranked(configuration, known, estimate(judged[i] - first), n_runs, int(failed[i])))
    return ranking


def estimate(values: F64) -> Estimate:
    """Of (recordings, seeds) values, NaN where a run is missing."""
    mean, values = float(_mean_of_means(values)), values[np.isfinite(values).any(axis=1)]
    if len(values) < RECORDINGS_MIN:
        return Estimate(mean, math.nan, math.nan)
    from scipy.stats import bootstrap  # half a second, and only many recordings need it

    found = bootstrap(
        (np.nanmean(values, axis=1),), np.mean, n_resamples=BOOTSTRAP_DRAWS, confidence_level=LEVEL,
        method="percentile", rng=0,
    )  # fmt: skip
    return Estimate(mean, *map(float, found.confidence_interval))


def _mean_of_means(values: F64) -> F64:
    """Means over recordings of the means over seeds of (..., recordings, seeds); NaN values are left out."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Mean of empty slice")
        return np.asarray(np.nanmean(np.nanmean(values, axis=-1), axis=-1))
