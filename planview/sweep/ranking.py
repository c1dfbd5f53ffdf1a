"""Configurations ranked by a figure, with bootstrap confidence intervals over recordings and seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.types import F64
from planview.sweep.figures import FIGURES, FigureName
from planview.sweep.results import JobResult
from planview.sweep.space import Configuration

DRAWS = 1000
LEVEL = 0.95
_SEED = 0
_BLOCK = 5_000_000
"""Values drawn at a time."""


@dataclass(frozen=True)
class Estimate:
    """A mean with its interval; NaN where there is none (one recording with one seed)."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Ranked:
    """A configuration with its place.

    Attributes:
        figures: mean and interval of every figure that its runs have.
        behind: of the objective, this configuration's mean less the first one's, run by run.
        runs, failed: finished runs and those that failed.
    """

    configuration: Configuration
    figures: dict[FigureName, Estimate]
    behind: Estimate
    runs: int
    failed: int


def ranked(results: Sequence[JobResult], objective: FigureName) -> list[Ranked]:
    """Best first; those without the objective, then those whose runs did not all finish, come last.

    Recordings count the same, and the seeds of a recording among themselves. Intervals hold LEVEL of DRAWS means over
    recordings drawn with replacement and, of each, seeds drawn with replacement (Efron and Tibshirani 1993, chapter 8:
    the bootstrap of a two-stage sample).
    """
    table = _Table(results)
    better = FIGURES[objective].better

    def order(configuration: Configuration) -> tuple[bool, bool, float]:
        values = table.values(configuration, objective)
        mean = _mean(values)
        return math.isnan(mean), bool(np.isnan(values).any()), -better * mean if not math.isnan(mean) else 0.0

    configurations = sorted(table.configurations, key=order)
    if not configurations:
        return []
    first = table.values(configurations[0], objective)
    return [_ranked(table, configuration, objective, first) for configuration in configurations]


def estimate(values: F64) -> Estimate:
    """Of (recordings, seeds) values, NaN where a run is missing."""
    mean = _mean(values)
    values = values[np.isfinite(values).any(axis=1)]
    if np.isfinite(values).sum() < 2:
        return Estimate(mean, math.nan, math.nan)
    means = np.sort(_drawn_means(values))
    tail = (1.0 - LEVEL) / 2
    low, high = np.nanquantile(means, [tail, 1.0 - tail])
    return Estimate(mean, float(low), float(high))


def _drawn_means(values: F64) -> F64:
    """(DRAWS,) means of samples drawn with replacement."""
    n_recordings, n_seeds = values.shape
    generator = np.random.default_rng(_SEED)
    means: list[F64] = []
    block = max(1, _BLOCK // values.size)
    for start in range(0, DRAWS, block):
        count = min(block, DRAWS - start)
        recording = generator.integers(0, n_recordings, (count, n_recordings, 1))
        seed = generator.integers(0, n_seeds, (count, n_recordings, n_seeds))
        means.append(_mean_of_means(values[recording, seed]))
    return np.concatenate(means)


def _mean(values: F64) -> float:
    return float(_mean_of_means(values[None])[0])


def _mean_of_means(values: F64) -> F64:
    """(D,) means over recordings of the means over seeds of (D, recordings, seeds); NaN values are left out."""
    known = np.isfinite(values)
    seeds = known.sum(axis=2)
    per_recording = np.where(known, values, 0.0).sum(axis=2) / np.maximum(seeds, 1)
    recordings = (seeds > 0).sum(axis=1)
    total = np.where(seeds > 0, per_recording, 0.0).sum(axis=1)
    return np.where(recordings > 0, total / np.maximum(recordings, 1), np.nan)


def _ranked(table: _Table, configuration: Configuration, objective: FigureName, first: F64) -> Ranked:
    figures = {name: estimate(table.values(configuration, name)) for name in FIGURES}
    behind = estimate(table.values(configuration, objective) - first)
    failed = table.failed(configuration)
    known = {name: found for name, found in figures.items() if not math.isnan(found.mean)}
    return Ranked(configuration, known, behind, table.runs - failed, failed)


class _Table:
    """Figures by configuration, recording and seed."""

    def __init__(self, results: Sequence[JobResult]) -> None:
        self.configurations = list(dict.fromkeys(result.configuration for result in results))
        names = {name: i for i, name in enumerate(dict.fromkeys(r.recording for r in results))}
        seeds = {seed: i for i, seed in enumerate(dict.fromkeys(r.seed for r in results))}
        self.runs = len(names) * len(seeds)
        self._cells = {c: np.full((len(FIGURES), len(names), len(seeds)), np.nan) for c in self.configurations}
        self._failed = dict.fromkeys(self.configurations, 0)
        for result in results:
            cell = self._cells[result.configuration]
            for i, name in enumerate(FIGURES):
                cell[i, names[result.recording], seeds[result.seed]] = result.figures.get(name, np.nan)
            self._failed[result.configuration] += bool(result.error)

    def values(self, configuration: Configuration, figure: FigureName) -> F64:
        """(recordings, seeds), NaN where unknown."""
        return np.asarray(self._cells[configuration][list(FIGURES).index(figure)])

    def failed(self, configuration: Configuration) -> int:
        return self._failed[configuration]
