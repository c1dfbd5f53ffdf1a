"""A whole run in one call, and counts of its tracks, for scripts and notebooks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from planview.counting import rules as rules_files
from planview.counting import totals
from planview.counting.rules import AnalyticsParams, Rules
from planview.counting.totals import Counts
from planview.engine.config import Config
from planview.engine.engine import Engine, FrameResult
from planview.engine.open import AnyTracker, open_engine
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.offline.refine import refine
from planview.output.finished import refine_run
from planview.output.folder import HoldsResultsError, check_folder, prepare_folder
from planview.output.report.page import write_report
from planview.output.run import RunOptions
from planview.output.run import run as run_engine
from planview.output.run_folder import RunFolder
from planview.trajectories.formats import load_tracks, load_truth, tracks_file, truth_file
from planview.trajectories.table import Trajectories, TrajectoryCollector, read_tracks
from stereo.matcher import Matcher
from stereo.readers import OpenOptions

if TYPE_CHECKING:
    from pandas import DataFrame


class OpenArguments(TypedDict, total=False):
    """How ``run`` opens a recording: the arguments of ``open_engine``, which explains them."""

    tracker: AnyTracker
    config: Config | dict[str, Any] | None
    camera: Path | str | GroundCamera | None
    options: OpenOptions | None
    matcher: Matcher | None
    detections: Path | str | Sequence[ArrayLike] | None


def run(
    source: Engine | Path | str,
    out: Path | str | None = None,
    *,
    frames: int = 0,
    refined: bool = False,
    overwrite: bool = False,
    watch: Callable[[FrameResult], None] | None = None,
    **opening: Unpack[OpenArguments],
) -> Trajectories:
    """Track people in a recording: ``planview.run("my_recording", "out", tracker="template")``.

    Args:
        source: a recording, or an engine.
        out: folder for tracks.csv, run.json and report.html as ``planview run`` writes them; None to write nothing.
        frames: stop after this many; 0 for all.
        refined: refine the tracks afterwards, knowing the whole recording.
        overwrite: replace results that are in the folder.
        watch: called after every frame.
        opening: tracker, config, camera, options, matcher and detections as ``open_engine`` takes them; none of an
            engine, which has its own.
    Raises:
        InputError: a recording, calibration or camera that is missing or does not fit; results in the folder.
        WorkError: no floor is visible, or the folder cannot be written.
    """
    if not hasattr(frames, "__index__") or frames < 0:
        raise InputError(f"expected how many to track, 0 for all, found {frames!r}", argument="frames")
    if out is not None:
        try:
            check_folder(Path(out), overwrite)
        except HoldsResultsError as error:
            raise InputError(f"{error}; choose another folder or pass overwrite=True") from error
    if isinstance(source, Path | str):
        engine, tracker = open_engine(source, **opening), opening.get("tracker", "joint")
    elif opening:
        raise InputError(f"an engine has its own {' and '.join(opening)}: give them to open_engine")
    else:
        engine, tracker = source, source.tracker
    if out is None:
        collector, n_frames = TrajectoryCollector(), 0
        for result in islice(engine, frames or None):
            collector.add(result.frame, result.timestamp_s, result.tracks)
            n_frames = result.frame + 1
            if watch:
                watch(result)
        tracks = collector.trajectories()
        return replace(refine(tracks).tracks if refined else tracks, n_frames=n_frames)
    name = tracker if isinstance(tracker, str) else type(tracker).__name__
    name = name if opening.get("detections") is None else "detections"
    folder = Path(out)
    prepare_folder(folder, overwrite)
    run_engine(engine, folder, RunOptions(name, max_frames=frames), watch=watch)
    write_report(folder)
    if refined:
        refine_run(folder)
    return replace(read_tracks(folder / "tracks.csv"), n_frames=RunFolder(folder).n_frames)


def _table(tracks: Trajectories | DataFrame) -> Trajectories:
    if isinstance(tracks, Trajectories):
        return tracks
    if not hasattr(tracks, "columns"):
        found = type(tracks).__name__
        raise InputError(f"expected a table (Trajectories or DataFrame), a file or a folder, found {found}")
    return Trajectories.from_dataframe(tracks)


def _read(tracks: Trajectories | DataFrame | Path | str) -> tuple[Trajectories, RunFolder | None]:
    """A table, and the run whose tracks it holds."""
    if not isinstance(tracks, Path | str):
        return _table(tracks), None
    path = tracks_file(Path(tracks))
    return load_tracks(path), RunFolder.around(path)


def evaluate(
    tracks: Trajectories | DataFrame | Path | str,
    truth: Trajectories | DataFrame | Path | str | None = None,
    params: EvaluationParams | None = None,
    frames: tuple[int, int] | None = None,
) -> Evaluation:
    """Score tracks against truth; ``to_json()`` of the result gives every figure by name.

    Args:
        tracks: a table, a file in any layout that ``planview evaluate`` reads, or the folder of a run; of a folder and
            of what ``run`` returns, the frames that were read are scored.
        truth: a table, a file, or the folder of a recording with its ``truth.csv``; that of the run's recording when
            None.
        params: what counts as a match; the defaults when None.
        frames: first and last frame to score, both included; all when None.
    Raises:
        InputError: a file that cannot be read, or rows without what the matching needs.
        WorkError: alignment was asked for and is not possible.
    """
    if frames is not None and not 0 <= frames[0] <= frames[1]:
        raise InputError(f"expected the first and the last frame, found {frames}", argument="frames")
    found, run = _read(tracks)
    if isinstance(truth, Path | str):
        truth = load_truth(truth_file(Path(truth)) or Path(truth))
    if run is None and truth is None:
        raise InputError("expected a truth for tracks that are not those of a run's folder, found None")
    if run is not None:
        first = run.info.first_frame
        frames = frames or (first, max(first, RunFolder(run.path, other_tracks=found).n_frames - 1))
        truth = run.truth_of_recording if truth is None else truth
    elif frames is None and found.n_frames:
        frames = 0, found.n_frames - 1
    return evaluate_tracks(found, _table(truth), params, frames)


def load_rules(path: Path | str, run: Path | str | None = None) -> Rules:
    """Read rules.toml.

    Args:
        run: folder of the run whose tracks are counted: its camera relates pixels and metres, and its images have the
            border at which lines in pixels end. Without it rules in pixels stay in the image.
    Raises:
        InputError: a file that cannot be read, or a rule outside the view.
    """
    return rules_files.load_rules(Path(path), RunFolder(Path(run)).rule_plane if run is not None else None)


def count_tracks(
    tracks: Trajectories | DataFrame | Path | str,
    rules: Rules | Path | str,
    params: AnalyticsParams | None = None,
    fps: float | None = None,
) -> Counts:
    """Count line crossings, zones and queues in tracks, as ``planview count`` does.

    Args:
        tracks: folder of a run or its tracks.csv, which gives the counts of the run; another file that ``planview
            export`` writes; or a table.
        rules: rules.toml, or what ``load_rules`` read.
        params: when a person counts; the defaults when None.
        fps: frame rate of tracks that are not those of a run and have no times.
    Raises:
        InputError: a file that cannot be read, or tracks without times or without a place in the plane of a rule.
    """
    table, run = _read(tracks)
    if not isinstance(rules, Rules):
        rules = load_rules(rules, run.path if run is not None else None)
    for note in filter(None, (rules.of_unknown_size, rules.unreached(table))):
        warnings.warn(note, stacklevel=2)
    if run is None:
        return totals.count_tracks(table, rules, params, clock=totals.Clock(table, fps))
    return replace(totals.count_tracks(table, rules, params, clock=run.clock), span=run.span)
