"""What each part of the engine contributes: variants of its configuration over the same recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from cyclopts import Parameter

from benchmarks.options import ChallengeOptions, report
from benchmarks.passes import Pass, bootstrap, provenance, run_pass, watched
from benchmarks.suite import Way, chosen_files, judged_truth, refined_tracks, suite_recording
from calib.errors import InputError
from planview.engine.config import Config, load_config
from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.result import KINDS, Evaluation, pooled
from planview.maps.grid import Grid
from planview.maps.plan_view import FloorPoints, PlanViewMaps
from planview.output.script import run
from planview.tracking.base import Observation
from planview.tracking.template import TemplateTracker
from planview.trajectories.state import TrackState
from planview.trajectories.table import Trajectories, read_tracks, read_truth

Statistic = Literal["both", "height", "occupancy"]
NOMINAL_HEIGHT_M = 1.7
"""Height of everything where height is not measured [m]: an adult, so that no test of height refuses it."""
DECIDES_POINTS = ("foreground", "feedback")
"""Tables whose parameters decide which foreground points there are: recorded ones do not serve."""


class Variant(NamedTuple):
    """One row of the table."""

    name: str
    settings: tuple[str, ...] = ()
    """As of ``planview run --set``."""
    meaning: str = ""
    """What the part that is switched off does."""
    way: Way = "online"
    paper: int | None = None
    """Significant errors of Harville 2002, section 5, in about ten minutes, where it has such a figure."""
    template: Statistic | None = None
    """The paper's tracker with these statistics; None for the joint tracker."""

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
)  # fmt: skip
"""The paper's tracker and its halves, parts of the engine switched off alone, and refinement."""


def chosen_variants(names: Sequence[str]) -> tuple[Variant, ...]:
    """``CONFIGURED``, then the variants named; all when none is. Raises InputError: no such variant."""
    known = {variant.name: variant for variant in LADDER}
    for name in names:
        if name not in known:
            raise InputError(f"--variant: expected one of {', '.join(known)}, found {name!r}")
    return CONFIGURED, *(known[name] for name in names or known)


@dataclass(frozen=True)
class Trial:
    """A variant on a recording with truth: a folder, or where there is a seed a challenge, rendered when needed."""

    path: Path
    seed: int | None
    cache: Path
    config: Config
    variant: Variant = CONFIGURED

    @property
    def name(self) -> str:
        """Of the recording."""
        return self.path.resolve().name if self.seed is None else f"{self.path.stem}-{self.seed}"

    def recording(self) -> tuple[Path, Trajectories]:
        """The folder, and its truth (of a challenge as the suite judges it). Raises InputError: no truth in it."""
        if self.seed is not None:
            folder, scene = suite_recording(self.path, self.seed, self.cache)
            return folder, judged_truth(read_truth(folder / "truth.csv"), scene)
        if not (self.path / "truth.csv").is_file():
            raise InputError(f"{self.path}: expected a recording with truth.csv, found none in it")
        return self.path, read_truth(self.path / "truth.csv")


def run_trial(trial: Trial) -> Evaluation:
    """Track and score one variant on one recording.

    The engine as configured runs in full, once (``passes.run_pass``), and records its plan-view points; variants of the
    tracker track these, which takes seconds, and keep the feedback of the engine as configured; other variants run in
    full, once.
    """
    variant, (folder, truth) = trial.variant, trial.recording()
    config = load_config(None, variant.settings, trial.config)
    if not variant.tracker_only:
        return evaluate_tracks(read_tracks(run_pass(Pass(folder, trial.cache, config)) / "tracks.csv"), truth)
    kept = run_pass(Pass(folder, trial.cache, trial.config, recorded=True))
    if variant.way == "refined":
        tracks = refined_tracks(kept)
    elif variant.template is not None:
        tracks = run(kept / "maps.h5", tracker=OneStatistic(config, variant.template), config=config)
    elif variant.settings:
        tracks = run(kept / "maps.h5", config=config)
    else:
        tracks = read_tracks(kept / "tracks.csv")
    return evaluate_tracks(tracks, truth)


def ablation_rows(scores: Mapping[Variant, Sequence[Evaluation]]) -> list[dict[str, Any]]:
    """One row per variant: counts of significant errors, and figures with intervals.

    Args:
        scores: of every variant, of the same recordings in the same order; with ``CONFIGURED``.
    """
    base = np.array([len(e.significant) for e in scores[CONFIGURED]])
    # One length for all: the span that a variant's tracks cover differs from variant to variant.
    tens = np.array([e.duration_s / 600 for e in scores[CONFIGURED]])
    rows: list[dict[str, Any]] = []
    for variant, parts in scores.items():
        counts = [
            (len(e.significant), e.strict_identity_changes, e.clear.misses, e.clear.false_positives,
             e.sequence.truth_rows, e.position_error_m.sum(), len(e.position_error_m))
            for e in parts
        ]  # fmt: skip
        errors, changes, misses, false, truth, distance_m, matches = np.array(counts, np.float64).T
        figures = {
            "significant_per_10_min": (errors, tens),
            "change_per_10_min": (errors - base, tens),
            "identity_changes_per_10_min": (changes, tens),
            "misses": (misses, truth),
            "false_positives": (false, truth),
            "position_error_m": (distance_m, matches),
        }
        kinds = Counter(error.kind for error in pooled(parts).significant)
        rows.append({"variant": variant.name, **{str(kind): kinds[kind] for kind in KINDS}, "paper": variant.paper})
        rows[-1] |= {name: bootstrap(*sums) for name, sums in figures.items()}
    return rows


class OneStatistic(TemplateTracker):
    """The paper's tracker on maps of which one statistic is left; the other is constant and carries no information."""

    def __init__(self, config: Config, statistic: Statistic) -> None:
        super().__init__(config.template, config.maps.height_max_m)
        self._statistic = statistic

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame."""
        assert observation.maps is not None
        maps = reduced(observation.maps, self._statistic)
        return super().update(replace(observation, build_maps=lambda: maps))


def reduced(maps: PlanViewMaps, statistic: Statistic) -> PlanViewMaps:
    """The maps with one statistic: without height everything is ``NOMINAL_HEIGHT_M`` high; without occupancy a cell
    with height counts as full, and of its points the highest is left. Height comes from the maps as they are: built
    with ``maps.occupancy_min=0`` it is not pruned by occupancy."""
    known, zero = maps.height_raw > 0, np.float32(0.0)
    if statistic == "occupancy":
        nominal = np.float32(NOMINAL_HEIGHT_M)
        xyz = maps.points.xyz.copy()
        xyz[:, 2] = nominal
        raw, height = np.where(known, nominal, zero), np.where(maps.height > 0, nominal, zero)
        return replace(maps, height_raw=raw, height=height, points=replace(maps.points, xyz=xyz))
    if statistic == "height":
        cell_m2 = np.float32(maps.grid.cell_m**2)
        full, height = np.where(known, cell_m2, zero), np.where(known, maps.height, zero)
        points, least = highest_points(maps.points, maps.grid), float(cell_m2) / 2
        return replace(maps, occupancy_raw=full, occupancy=full, height=height, occupancy_min=least, points=points)
    return maps


def highest_points(points: FloorPoints, grid: Grid) -> FloorPoints:
    """The highest point of every cell, each with a cell's area."""
    order = np.argsort(-points.xyz[:, 2], kind="stable")
    cols = np.floor((points.xyz[order, 0] - grid.x_min_m) / grid.cell_m).astype(np.int64)
    rows = np.floor((points.xyz[order, 1] - grid.y_min_m) / grid.cell_m).astype(np.int64)
    _, first = np.unique(rows * grid.n_cols + cols, return_index=True)
    kept = order[first]
    area = np.full(len(kept), grid.cell_m**2, dtype=np.float32)
    colours = None if points.colours is None else points.colours[kept]
    return FloorPoints(points.xyz[kept], area, points.pixels[kept], colours)


@Parameter(name="*")
@dataclass(frozen=True)
class AblationOptions(ChallengeOptions):
    """Which variants are compared, and on what."""

    variant: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these variants, by name."""
    recording: Annotated[Sequence[Path], Parameter(negative="")] = ()
    """A recording folder with truth.csv; may be given several times."""


def ablation(*, options: AblationOptions | None = None) -> None:
    """Switch parts of the engine off, one at a time, and compare all variants on the same recordings.

    One table: significant errors, identity changes, misses, false positives and mean position error of every variant,
    with 95 % bootstrap intervals over recordings, next to the paper's figures (Harville 2002, section 5: 1 significant
    error, 17 without occupancy, 25 without height). Variants of the tracker track the recorded plan-view points of the
    engine as configured; those of foreground and feedback run in full.

    Example: python -m benchmarks ablation --scene trio --scene crossing --jobs 2
    """
    o = options or AblationOptions()
    files, base, variants = o.files(), o.settings(), chosen_variants(o.variant)
    trials = [Trial(path, None, o.cache_folder, base) for path in o.recording]
    for trial in trials:
        trial.recording()
    if o.seed or o.scene or not trials:
        seeds = dict.fromkeys(o.seed or [1])
        trials += [Trial(p, s, o.cache_folder, base) for s in seeds for p in chosen_files(files, s, o.minutes)]
    done: dict[Trial, Evaluation] = {}
    # The engine as configured first, since others need its points.
    for some in (variants[:1], variants[1:]):
        done |= watched(run_trial, [replace(trial, variant=v) for v in some for trial in trials], o.jobs)
    rows = ablation_rows({v: [done[replace(trial, variant=v)] for trial in trials] for v in variants})
    report(o.json_output, recordings=[trial.name for trial in trials], **provenance(), variants=rows)
    for variant in () if o.json_output else variants:
        if variant.meaning:
            print(f"{variant.name}: {variant.meaning}")
