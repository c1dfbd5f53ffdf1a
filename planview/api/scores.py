"""Tracks against truth, and what they count."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.errors import InputError
from calib.io import refuse_missing
from planview.api.arguments import Frames, checked, frame_span, given_tracks, in_range, path_of, table_of
from planview.api.result import Result, aligned
from planview.counting import rules as rules_files
from planview.counting.events import Event, is_events, read_events, write_event_header, write_event_rows
from planview.counting.rules import AnalyticsParams, RulePlane, Rules
from planview.counting.totals import Counts, count_tracks, count_truth, score_counts, score_events
from planview.evaluation.evaluate import EvaluationParams, evaluate_named
from planview.evaluation.result import Evaluation, pool
from planview.output.folder import folder_lock, unfinished_note, write_result
from planview.output.run_folder import RunFolder
from planview.output.words import figures_of
from planview.trajectories.boxes import refuse_outside
from planview.trajectories.clock import Clock
from planview.trajectories.file import limit, warn_of
from planview.trajectories.formats import file_pairs, load_truth, sequence_rate, sequence_size, truth_file
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from pandas import DataFrame


def evaluate(
    tracks: Trajectories | DataFrame | Path | str,
    truth: Trajectories | DataFrame | Path | str | None = None,
    *,
    gate: float = 0.5,
    boxes: bool = False,
    min_visible: float = 0.25,
    align: bool = False,
    frames: Frames | None = None,
    fps: float | None = None,
) -> Evaluation:
    """Score tracks against truth.

    The scores are CLEAR, IDF1, HOTA, position errors and significant errors. With two folders, recordings are paired by
    name, scored one by one, then all together.

    ```python
    scores = planview.evaluate("out")
    print(scores.mota, scores.to_json()["idf1"])
    planview.evaluate(tracks, "gt.txt", gate=1, align=True, frames="0:399")
    ```

    Args:
        tracks: tracks.csv of a run, the folder of the run, trajectories in a format of planview export, or a folder of
            these.
        truth: truth.csv (frame,id,x_m,y_m,height_m[,visible][,facing_deg]), rows of PETS or MOTChallenge (gt.txt),
            another format of planview export, or a folder of these; by default truth.csv of the run's recording.
        gate: Largest distance on the floor of a match, in metres.
        boxes: Match image boxes at IoU 0.5 instead of floor positions.
        min_visible: Ignore truth rows less visible than this fraction, and tracks on them.
        align: First align the tracks with the truth by a rotation and a shift on the floor (if their world frames
            differ).
        frames: First and last frame to score, e.g. 0:399, or 400 for the first 400.
        fps: Frame rate where the tracks have no timestamps. [default: that of the run, else 30]

    Returns:
        The scores; ``to_json()`` gives every figure by name, ``recordings`` those of each of several recordings.

    Raises:
        InputError: a file that cannot be read, or rows without what the matching needs.
        WorkError: no alignment is possible.
    """
    params = checked(
        EvaluationParams,
        gate_m=gate,
        match_on="boxes" if boxes else "floor",
        min_visible=min_visible,
        align=align,
        fps=fps or 30.0,
    )
    span = None if frames is None else frame_span(frames)
    if isinstance(tracks, Path | str) and isinstance(truth, Path | str | None):
        path = Path(tracks)
        pairs = file_pairs(path, truth_of(path) if truth is None else Path(truth))
        results = {pair.name: _score(pair.tracks, pair.truth, params, span, fps is not None) for pair in pairs}
        first, *others = results.values()
        return replace(pool([first, *others]), recordings=results) if others else first
    if truth is None:
        raise InputError("expected a truth for tracks that are not those of a run's folder, found None")
    return _score(tracks, truth, params, span, fps is not None)


def truth_of(tracks: Path) -> Path:
    """The truth of the recording that a run tracked."""
    run = RunFolder.around(tracks)
    if run is None:
        refuse_missing(tracks)
        raise InputError(f"{tracks}: no truth given, and no run.json here names the recording; add the truth file")
    if run.truth_file is None:
        raise InputError(f"{run.recording} has no truth.csv; add the truth file")
    return run.truth_file


def _score(
    tracks: Trajectories | DataFrame | Path | str,
    truth: Trajectories | DataFrame | Path | str,
    params: EvaluationParams,
    span: tuple[int, int] | None,
    has_rate: bool,
) -> Evaluation:
    file, path, run = given_tracks(tracks)
    table = replace(run, other_tracks=file.table).tracks if run else file.table
    size = run.info.size_px if run else None
    rate = run.info.fps if run else None
    name = "the truth"
    if isinstance(truth, Path | str):
        of_truth = truth_file(Path(truth)) or Path(truth)
        name = str(of_truth)
        truth = load_truth(of_truth, table)
        size = size or sequence_size(of_truth)
        rate = sequence_rate(of_truth) or rate
    if rate and not has_rate:
        params = params.model_copy(update={"fps": rate})
    people = table_of(truth)
    names = str(path or "the tracks"), name
    if params.match_on == "boxes" and size is not None:
        refuse_outside(table.box_px, size, names[0])
        refuse_outside(people.box_px, size, name)
    warn_of(unfinished_note(path) if path else "")
    return evaluate_named(table, people, params, span, names)


_DEFAULTS = AnalyticsParams()


def count(
    tracks: Trajectories | DataFrame | Path | str,
    rules: Rules | Mapping[str, Any] | Path | str,
    *,
    camera: Path | str | None = None,
    rig: Path | str | None = None,
    truth: Path | str | None = None,
    window: float = 1.0,
    interval: float = _DEFAULTS.interval_s,
    hysteresis: float = _DEFAULTS.hysteresis_m,
    zone_hysteresis: float = _DEFAULTS.zone_hysteresis_m,
    min_age: float = _DEFAULTS.min_age_s,
    region: str | None = None,
    ignore: str | None = None,
    fps: float | None = None,
    out: Path | str | None = None,
) -> Result[Counts]:
    """Count line crossings and zone occupancy in tracks.

    Writes events.csv and counts.json.

    ```python
    print(planview.count("out", "rules.toml"))
    rules = planview.load_rules("rules.toml", run="out")
    totals = planview.count(tracks, rules).to_dataframe()  # a row per rule
    ```

    Args:
        tracks: tracks.csv of a run, the folder of the run, or trajectories in a format of planview export.
        rules: rules.toml with tripwires, zones (in metres or in pixels) and queues. In Python also a dict of the same.
        camera: camera.toml that relates the pixels of rules to the floor.
        rig: Calibration of a stereo rig, with world.toml next to it, for the same.
        truth: True positions (truth.csv, gt.txt) or true events (as events.csv) to score the counts against.
        window: Largest time between a true and a found crossing that match, in seconds.
        interval: Length of the intervals of the totals, in seconds.
        hysteresis: How far beyond a line people must be observed on both sides, in metres.
        zone_hysteresis: How deep inside or outside a zone people must be observed to enter or leave it, in metres.
        min_age: Ignore tracks until they are this old, in seconds.
        region: Polygon in well-known text [m], or a file with it: rows outside are left out.
        ignore: Polygon in well-known text [m], or a file with it: rows inside are left out.
        fps: Frame rate where the tracks have no timestamps; that of the run when not given.
        out: Folder for events.csv and counts.json; by default next to a file named tracks.csv, where counts of an
            earlier call or of the run are replaced, with a message; else nowhere.

    Returns:
        All events and stays; ``to_json()`` gives the object of counts.json, with intervals and scores.

    Raises:
        InputError: a file that cannot be read, or tracks without times or without a place in the plane of a rule.
    """
    params = checked(
        AnalyticsParams, hysteresis_m=hysteresis, zone_hysteresis_m=zone_hysteresis, min_age_s=min_age,
        interval_s=interval,
    )  # fmt: skip
    in_range("window", window, 0.001, 3600, " s")
    file, path, run = given_tracks(tracks)
    found = limit(file, region, ignore).table
    clock = Clock(file.table, fps or (run.info.fps if run else None))
    plane = rules_files.plane_of(path_of(camera), path_of(rig)) or (run.rule_plane if run else RulePlane())
    placed = rules if isinstance(rules, Rules) else rules_files.load_rules(rules, plane)
    for doubt in (unfinished_note(path) if path else "", placed.unknown_size_note, placed.far_rule_note(found)):
        warn_of(doubt)
    n_frames = run.n_frames if run else int(file.table.frame.max(initial=-1)) + 1
    counts = count_tracks(found, placed, params, clock=clock, n_frames=n_frames)
    counts = replace(counts, span=run.span) if run else counts
    result = counts.to_json()
    if truth is not None and is_events(Path(truth)):
        result["scores"] = score_events(read_events(Path(truth)), counts, window).to_json()
    elif truth is not None:
        true = count_truth(load_truth(Path(truth)), counts.rules, clock, params, n_frames)
        result["scores"] = score_counts(true, counts, window).to_json()
    files = _write_counts(path, path_of(out), counts.events, result) if out or path else []
    rows = []
    for name, values in result["rules"].items():
        totals = {key: value for key, value in values.items() if isinstance(value, str | int | float)}
        rows.append({"rule": name} | totals)
    return Result(counts, result, rows, files, text=counts_text(result))


def counts_text(result: dict[str, Any]) -> str:
    """A table of the totals, and of the scores where there are any."""
    rows = [("rule", "kind", f"counts in {result['duration_s']:.1f} s of recording")]
    rows += [(name, values["kind"], ", ".join(_figures(values))) for name, values in result["rules"].items()]
    scores = result.get("scores", {}).get("rules", {})
    lines = [f"{name} against truth: {', '.join(_figures(values))}" for name, values in scores.items()]
    return "\n".join([aligned(rows), *lines])


def _figures(values: dict[str, Any]) -> list[str]:
    figures = [" ".join(figure) for figure in figures_of(values)]
    groups = (group for group in values.get("groups", []) if group["frames"])
    people = "{people} people: {right_percent:.1f} % right, {mean_difference:+.2f}"
    return figures + [people.format(**group) for group in groups]


def load_rules(path: Path | str, run: Path | str | None = None) -> Rules:
    """Read rules.toml.

    Args:
        run: folder of the run whose tracks are counted: its camera relates pixels and metres, and its images have the
            border at which lines in pixels end. Without it rules in pixels stay in the image.
    Raises:
        InputError: a file that cannot be read, or a rule outside the view.
    """
    return rules_files.load_rules(path, RunFolder(Path(run)).rule_plane if run else None)


def _write_counts(
    tracks: Path | None, folder: Path | None, events: Sequence[Event], result: dict[str, Any]
) -> list[Path]:
    """Write events.csv and counts.json to a folder, else next to our own tracks; never into a folder of input data."""
    if folder is None:
        if tracks is None or tracks.name != "tracks.csv" or not os.access(tracks.parent, os.W_OK):
            warn_of("no events.csv and counts.json written: no folder was given for them")
            return []
        folder = tracks.parent
    files = [folder / "events.csv", folder / "counts.json"]
    replaced = [str(file) for file in files if file.exists()]
    rows = io.StringIO()
    write_event_header(rows)
    write_event_rows(rows, events)
    with folder_lock(folder):  # an unfinished run writes its own
        write_result(files[0], rows.getvalue())
        write_result(files[1], json.dumps(result, indent=2) + "\n")
    if replaced:
        warn_of(f"replaced {' and '.join(replaced)}")
    return files
