"""What each part of the engine contributes: variants of its configuration over the same recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.accuracy import tracked
from benchmarks.passes import PEER, Pass, in_processes, run_pass
from benchmarks.suite import refined_tracks, suite_recording
from benchmarks.variants import CONFIGURED, Variant
from calib.errors import InputError
from calib.types import F64, I64
from planview.engine.config import Config, load_config
from planview.engine.factory import floor_tracker
from planview.engine.maps_pipeline import MapsPipeline
from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.result import KINDS, Evaluation, pooled
from planview.maps.recording import MapsRecording
from planview.trajectories.table import read_tracks, read_truth

RESAMPLES = 2000
"""Bootstrap samples: the ends of a 95 % interval then rest on 50 samples each."""


@dataclass(frozen=True)
class AblationRecording:
    """A recording with truth: a folder, or a challenge of a seed that is rendered when it is needed.

    Attributes:
        path: the folder, or the challenge file.
        seed: of the challenge; None for a folder.
        cache: folder of rendered recordings.
    """

    path: Path
    seed: int | None
    cache: Path

    @property
    def name(self) -> str:
        return self.path.resolve().name if self.seed is None else f"{self.path.stem}-{self.seed}"

    def folder(self) -> Path:
        """The recording's folder, rendered unless it exists.

        Raises:
            InputError: no truth in it.
        """
        folder = self.path if self.seed is None else suite_recording(self.path, self.seed, self.cache)[0]
        if not (folder / "truth.csv").is_file():
            raise InputError(f"{folder}: expected a recording with truth.csv, found none in it")
        return folder


@dataclass(frozen=True)
class Trial:
    """One variant on one recording.

    Attributes:
        config: the configuration that the variant changes.
    """

    recording: AblationRecording
    variant: Variant
    config: Config


@dataclass(frozen=True)
class TrialScore:
    """The scores of a trial."""

    trial: Trial
    evaluation: Evaluation


class Interval(NamedTuple):
    """A figure of all recordings together, with its 95 % bootstrap interval; NaN where there is none."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class AblationRow:
    """One variant over all recordings.

    Attributes:
        significant: significant errors by kind and in total.
        per_10_min: significant errors in ten minutes.
        change_per_10_min: the same less that of the engine as configured, on the same recordings.
        strict_per_10_min: strict identity changes in ten minutes.
        misses, false_positives: share of truth rows.
        position_error_m: mean over matches [m].
    """

    variant: Variant
    significant: dict[str, int]
    per_10_min: Interval
    change_per_10_min: Interval
    strict_per_10_min: Interval
    misses: Interval
    false_positives: Interval
    position_error_m: Interval

    def to_json(self) -> dict[str, Any]:
        v = self.variant
        figures = {name: value for name, value in vars(self).items() if isinstance(value, Interval)}
        return {
            "variant": v.name, "settings": v.settings, "meaning": v.meaning,
            "paper_significant_errors": v.paper, "significant_errors": self.significant,
            **{name: [None if np.isnan(x) else x for x in value] for name, value in figures.items()},
        }  # fmt: skip


def run_trial(trial: Trial) -> TrialScore:
    """Track and score one variant on one recording.

    The engine as configured runs in full, once (``passes.run_pass``), and records its plan-view points; variants of the
    tracker track these, which takes seconds, and keep the feedback of the engine as configured; other variants run in
    full, once.
    """
    folder, variant = trial.recording.folder(), trial.variant
    job = Pass(folder, trial.recording.cache, trial.config, recorded=True)
    if variant.way == "refined":
        tracks = refined_tracks(run_pass(job))
    elif variant.way == "peer":
        tracks = read_tracks(run_pass(job) / PEER)
    elif not variant.settings:
        tracks = read_tracks(run_pass(job) / "tracks.csv")
    else:
        config = load_config(None, variant.settings, trial.config)
        if variant.tracker_only:
            maps = MapsRecording(run_pass(job) / "maps.h5")
            tracks = tracked(MapsPipeline(maps, floor_tracker("template", config), config), None, "template")
        else:
            tracks = read_tracks(run_pass(Pass(folder, trial.recording.cache, config)) / "tracks.csv")
    return TrialScore(trial, evaluate_tracks(tracks, read_truth(folder / "truth.csv")))


def run_trials(trials: Sequence[Trial], at_once: int) -> Iterator[TrialScore]:
    """Scores in the order in which they are done; the engine as configured first, since others need its points."""
    first = [trial for trial in trials if trial.variant == CONFIGURED]
    yield from in_processes(run_trial, first, at_once)
    yield from in_processes(run_trial, [trial for trial in trials if trial.variant != CONFIGURED], at_once)


def ablation_rows(
    scores: Mapping[Variant, Sequence[Evaluation]], seed: int = 0, resamples: int = RESAMPLES
) -> list[AblationRow]:
    """One row per variant.

    Args:
        scores: of every variant, of the same recordings in the same order; with ``CONFIGURED``.
        seed: of the bootstrap.
        resamples: bootstrap samples of recordings.
    """
    n = len(scores[CONFIGURED])
    samples = np.random.default_rng(seed).integers(0, n, (resamples, n))
    base = _counts(scores[CONFIGURED], _n_significant)
    # One length for all: the span that a variant's tracks cover differs from variant to variant.
    minutes = _counts(scores[CONFIGURED], lambda e: e.duration_s / 600)
    return [_row(variant, parts, base, minutes, samples) for variant, parts in scores.items()]


def _row(variant: Variant, parts: Sequence[Evaluation], base: F64, minutes: F64, samples: I64) -> AblationRow:
    rows = _counts(parts, lambda e: e.truth_rows)
    errors = _counts(parts, _n_significant)
    kinds = Counter(error.kind for error in pooled(parts).significant)

    def figure(numerator: F64, denominator: F64) -> Interval:
        return bootstrap(numerator, denominator, samples)

    return AblationRow(
        variant,
        {"total": int(errors.sum()), **{kind: kinds[kind] for kind in KINDS}},
        figure(errors, minutes),
        figure(errors - base, minutes),
        figure(_counts(parts, lambda e: e.strict_identity_changes), minutes),
        figure(_counts(parts, lambda e: e.clear.misses), rows),
        figure(_counts(parts, lambda e: e.clear.false_positives), rows),
        figure(
            _counts(parts, lambda e: float(e.position_error_m.sum())), _counts(parts, lambda e: len(e.position_error_m))
        ),
    )


def bootstrap(numerator: F64, denominator: F64, samples: I64) -> Interval:
    """The ratio of two sums over recordings, and its 95 % percentile interval.

    Args:
        numerator, denominator: (R,) of every recording.
        samples: (B, R) recordings drawn with replacement.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        value = float(numerator.sum() / denominator.sum())
        drawn = numerator[samples].sum(axis=1) / denominator[samples].sum(axis=1)
    drawn = drawn[np.isfinite(drawn)]
    if not len(drawn):
        return Interval(value, float("nan"), float("nan"))
    low, high = np.percentile(drawn, (2.5, 97.5))
    return Interval(value, float(low), float(high))


def _counts(parts: Sequence[Evaluation], of: Callable[[Evaluation], float]) -> F64:
    return np.array([of(part) for part in parts], dtype=np.float64)


def _n_significant(evaluation: Evaluation) -> int:
    return len(evaluation.significant)
