"""What each part of the engine contributes: variants of its configuration over the same recordings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from benchmarks.one_statistic import OneStatistic, Statistic
from benchmarks.options import ChallengeOptions, json_text, show
from benchmarks.passes import PEER, Pass, provenance, run_pass, watched
from benchmarks.suite import Way, chosen_files, judged_truth, refined_tracks, scene_of_seed, suite_recording
from calib.errors import InputError
from calib.io import write_whole
from calib.types import F64, I64
from planview.engine.config import Config, load_config
from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.result import KINDS, Evaluation, pooled
from planview.output.script import run
from planview.tracking.template import TemplateTracker
from planview.trajectories.table import Trajectories, read_tracks, read_truth

RESAMPLES = 2000
"""Bootstrap samples: the ends of a 95 % interval then rest on 50 samples each."""
DECIDES_POINTS = ("foreground", "feedback")
"""Tables whose parameters decide which foreground points there are: recorded ones do not serve."""


@dataclass(frozen=True)
class Variant:
    """One row of the table; the settings are those that ``planview run --set`` takes.

    Attributes:
        name: of the row.
        settings: overrides of the configuration like "joint.colour_weight=0".
        meaning: what the part that is switched off does.
        way: which tracks of the run are scored.
        template: the paper's tracker with these statistics; None for the joint tracker.
        paper: significant errors of Harville 2002, section 5, in about ten minutes; None where it has no such figure.
    """

    name: str
    settings: tuple[str, ...] = ()
    meaning: str = ""
    way: Way = "online"
    paper: int | None = None
    template: Statistic | None = None

    @property
    def tracker_only(self) -> bool:
        """Whether recorded foreground points serve: nothing that decides which points there are differs."""
        return not any(setting.split(".")[0] in DECIDES_POINTS for setting in self.settings)


CONFIGURED = Variant("as configured")
"""What every other variant is compared with."""
LADDER = (
    Variant("template", (), "the paper's tracker on height and occupancy", paper=1, template="both"),
    Variant(
        "height only", ("maps.occupancy_min=0", "template.occupancy_weight=0", "template.score_max=0.6"),
        "the paper's tracker without occupancy, which prunes heights, finds newcomers and is matched",
        paper=17, template="height",
    ),
    Variant(
        "occupancy only", ("template.height_weight=0", "template.score_max=0.6"),
        "the paper's tracker with every height the same", paper=25, template="occupancy",
    ),
    Variant("without colours", ("joint.colour_weight=0",), "clothes distinguish people, in and after contact"),
    Variant("feedback off", ("feedback.enabled=false",), "people are not learned as background"),
    Variant("colour only foreground", ("foreground.depth=false",), "depth separates people from shadows"),
    Variant("refinement on", (), "online tracks; refined ones know the future", way="refined"),
    Variant("naive engine", (), "everything after disparity: MOG2, peaks, Hungarian method, Kalman filter", way="peer"),
)  # fmt: skip
"""The paper's tracker and its halves, parts of the engine switched off alone, refinement, and the naive engine."""


def chosen_variants(names: Sequence[str]) -> tuple[Variant, ...]:
    """``CONFIGURED``, then the variants named; all when none is.

    Raises:
        InputError: no such variant.
    """
    known = {variant.name: variant for variant in LADDER}
    for name in names:
        if name not in known:
            raise InputError(f"--variant: expected one of {', '.join(known)}, found {name!r}")
    return CONFIGURED, *(known[name] for name in names or known)


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

    def truth(self) -> Trajectories:
        """The truth of the recording, of a challenge as the suite judges it."""
        truth = read_truth(self.folder() / "truth.csv")
        return truth if self.seed is None else judged_truth(truth, scene_of_seed(self.path, self.seed))


@dataclass(frozen=True)
class Trial:
    """One variant on one recording, and the configuration that it changes."""

    recording: AblationRecording
    variant: Variant
    config: Config


def run_trial(trial: Trial) -> Evaluation:
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
    elif not variant.settings and variant.template is None:
        tracks = read_tracks(run_pass(job) / "tracks.csv")
    else:
        config = load_config(None, variant.settings, trial.config)
        if variant.template is not None:
            paper = OneStatistic(TemplateTracker(config.template, config.maps.height_max_m), variant.template)
            tracks = run(run_pass(job) / "maps.h5", tracker=paper, config=config)
        elif variant.tracker_only:
            tracks = run(run_pass(job) / "maps.h5", config=config)
        else:
            tracks = read_tracks(run_pass(Pass(folder, trial.recording.cache, config)) / "tracks.csv")
    return evaluate_tracks(tracks, trial.recording.truth())


def ablation_rows(scores: Mapping[Variant, Sequence[Evaluation]]) -> list[dict[str, Any]]:
    """One row per variant: counts of significant errors, and figures with intervals.

    Args:
        scores: of every variant, of the same recordings in the same order; with ``CONFIGURED``.
    """
    n = len(scores[CONFIGURED])
    samples = np.random.default_rng(0).integers(0, n, (RESAMPLES, n))
    base = _counts(scores[CONFIGURED], lambda e: len(e.significant))
    # One length for all: the span that a variant's tracks cover differs from variant to variant.
    tens = _counts(scores[CONFIGURED], lambda e: e.duration_s / 600)
    rows: list[dict[str, Any]] = []
    for variant, parts in scores.items():
        truth = _counts(parts, lambda e: e.truth_rows)
        errors = _counts(parts, lambda e: len(e.significant))
        kinds = Counter(error.kind for error in pooled(parts).significant)
        distances = _counts(parts, lambda e: float(e.position_error_m.sum()))
        figures = {
            "significant_per_10_min": (errors, tens),
            "change_per_10_min": (errors - base, tens),
            "identity_changes_per_10_min": (_counts(parts, lambda e: e.strict_identity_changes), tens),
            "misses": (_counts(parts, lambda e: e.clear.misses), truth),
            "false_positives": (_counts(parts, lambda e: e.clear.false_positives), truth),
            "position_error_m": (distances, _counts(parts, lambda e: len(e.position_error_m))),
        }
        intervals = {name: bootstrap(*sums, samples) for name, sums in figures.items()}
        rows.append({"variant": variant.name, **{str(kind): kinds[kind] for kind in KINDS}, "paper": variant.paper})
        rows[-1] |= intervals
    return rows


def _counts(parts: Sequence[Evaluation], of: Callable[[Evaluation], float]) -> F64:
    return np.array([of(part) for part in parts], dtype=np.float64)


def bootstrap(numerator: F64, denominator: F64, samples: I64) -> tuple[float, float, float]:
    """The ratio of two sums over recordings, and its 95 % percentile interval; NaN where there is none.

    Args:
        numerator, denominator: (R,) of every recording.
        samples: (B, R) recordings, sampled with replacement.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        value = float(numerator.sum() / denominator.sum())
        resampled = numerator[samples].sum(axis=1) / denominator[samples].sum(axis=1)
    resampled = resampled[np.isfinite(resampled)]
    if not len(resampled):
        return value, math.nan, math.nan
    low, high = np.percentile(resampled, (2.5, 97.5))
    return value, float(low), float(high)


@Parameter(name="*")
@dataclass(frozen=True)
class AblationOptions(ChallengeOptions):
    """Which variants are compared, and on what."""

    variant: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these variants, by name."""
    recording: Annotated[Sequence[Path], Parameter(negative="")] = ()
    """A recording folder with truth.csv; may be given several times."""
    out: Path | None = None
    """JSON file that gets the table; none by default."""


def ablation(*, options: AblationOptions | None = None) -> None:
    """Switch parts of the engine off, one at a time, and compare all variants on the same recordings.

    One table: significant errors, identity changes, misses, false positives and mean position error of every variant,
    with 95 % bootstrap intervals over recordings, next to the paper's figures (Harville 2002, section 5: 1 significant
    error, 17 without occupancy, 25 without height). Variants of the tracker track the recorded plan-view points of the
    engine as configured; those of foreground and feedback run in full.

    Example: python -m benchmarks ablation --scene trio --scene crossing --jobs 2
    """
    o = options or AblationOptions()
    files = o.files()
    base, variants = o.settings(), chosen_variants(o.variant)
    recordings = [AblationRecording(path, None, o.cache_folder) for path in o.recording]
    for recording in recordings:
        recording.folder()
    if o.seed or o.scene or not recordings:
        recordings += [
            AblationRecording(path, s, o.cache_folder)
            for s in dict.fromkeys(o.seed or [1])
            for path in chosen_files(files, s, o.minutes)
        ]
    done: dict[Trial, Evaluation] = {}
    # The engine as configured first, since others need its points.
    for some in (variants[:1], variants[1:]):
        done |= watched(run_trial, [Trial(r, v, base) for v in some for r in recordings], o.jobs)
    rows = ablation_rows({v: [done[Trial(r, v, base)] for r in recordings] for v in variants})
    text = json_text({"recordings": [r.name for r in recordings], **provenance(), "variants": rows})
    if o.out is not None:
        o.out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(o.out, text)
    if o.json_output:
        print(text, end="")
        return
    show(rows)
    for variant in variants:
        if variant.meaning:
            print(f"{variant.name}: {variant.meaning}")
