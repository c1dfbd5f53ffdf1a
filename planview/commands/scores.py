"""``planview evaluate`` and ``count``: tracks against truth, and what they count."""

from __future__ import annotations

import io
import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cyclopts import Parameter
from rich.console import Console
from rich.table import Column, Table

from calib.errors import InputError
from calib.formats.one_camera import load_one_camera
from calib.io import missing, reason, require_file
from planview.commands.options import Flag, Ignored, JsonFlag, Region, checked, frame_span, say
from planview.counting.events import read_events, write_event_header, write_event_rows
from planview.counting.rules import AnalyticsParams, RulePlane, load_rules, stereo_plane
from planview.counting.totals import Clock, Counts, count_tracks, count_truth, score_counts, score_events
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import Evaluation, pooled
from planview.output.folder import unfinished_note, write_result, writing
from planview.output.progress import PlainConsole
from planview.output.report.page import evaluation_rows, figure_text, words_of
from planview.output.run_folder import RunFolder
from planview.trajectories.boxes import refuse_outside
from planview.trajectories.file import limited
from planview.trajectories.formats import (
    FilePair,
    file_pairs,
    load_file,
    load_truth,
    sequence_rate,
    sequence_size,
    tracks_file,
)

FINISHES = " (planview run --resume finishes it)"


@Parameter(name="*")
@dataclass(frozen=True)
class EvaluateOptions:
    """What counts, and how it is printed."""

    gate: float = 0.5
    """Largest distance on the floor of a match, in metres."""
    boxes: Flag = False
    """Match image boxes at IoU 0.5 instead of floor positions."""
    min_visible: float = 0.25
    """Ignore truth rows less visible than this fraction, and tracks on them."""
    align: Flag = False
    """First align the tracks with the truth by a rotation and a shift on the floor (if their world frames differ)."""
    frames: str | None = None
    """First and last frame to score, e.g. 0:399, or 400 for the first 400."""
    fps: float | None = None
    """Frame rate where the tracks have no timestamps. [default: that of the run, else 30]"""
    json_output: JsonFlag = False


def evaluate(tracks: Path, truth: Path | None = None, /, *, options: EvaluateOptions = EvaluateOptions()) -> None:
    """Score tracks against truth: CLEAR, IDF1, HOTA, position errors and significant errors.

    With two folders, recordings are paired by name, scored one by one, then all together.

    Example: planview evaluate out

    Example of another truth: planview evaluate out/tracks.csv recording/truth.csv --json

    Example on PETS: planview evaluate out/tracks.csv gt.txt --gate 1 --align --frames 0:399

    Example on MOTChallenge: planview evaluate trackers/mine gt --boxes --fps 25

    Parameters
    ----------
    tracks
        tracks.csv of a run, the folder of the run, trajectories in a format of planview export, or a folder of these.
    truth
        truth.csv (frame,id,x_m,y_m,height_m[,visible][,facing_deg]), rows of PETS or MOTChallenge (gt.txt), another
        format of planview export, or a folder of these; by default truth.csv of the run's recording.
    """
    truth = truth or _truth_of(tracks)
    run = RunFolder.around(tracks)
    params = checked(
        EvaluationParams,
        gate_m=options.gate,
        match_on="boxes" if options.boxes else "floor",
        min_visible=options.min_visible,
        align=options.align,
        fps=options.fps or (run and run.info.fps) or 30.0,
    )
    rated = options.fps is not None
    span = None if options.frames is None else frame_span(options.frames)
    pairs = file_pairs(tracks, truth)
    results = {pair.name: _evaluate_pair(pair, params, span, rated) for pair in pairs}
    together = pooled(list(results.values())) if len(results) > 1 else next(iter(results.values()))
    if options.json_output:
        each = {
            pair.name: {"tracks": str(pair.tracks), "refined": _refined(pair.tracks), **results[pair.name].to_json()}
            for pair in pairs
        }
        found = next(iter(each.values())) if len(each) == 1 else {**together.to_json(), "recordings": each}
        print(json.dumps(found, indent=2))
        return
    console = PlainConsole()
    for pair in pairs:
        kind = {True: " (refined)", False: " (online)", None: ""}[_refined(pair.tracks)]
        print_evaluation(results[pair.name], console, f"{pair.tracks}{kind}")
    if len(pairs) > 1:
        print_evaluation(together, console, f"{len(pairs)} recordings together", listed=False)


def _truth_of(tracks: Path) -> Path:
    """The truth of the recording that a run tracked."""
    run = RunFolder.around(tracks)
    if run is None:
        if not tracks.exists():
            raise missing(tracks)
        raise InputError(f"{tracks}: no truth given, and no run.json here names the recording; add the truth file")
    if run.truth_file is None:
        raise InputError(f"{run.recording} has no truth.csv; add the truth file")
    return run.truth_file


def _evaluate_pair(pair: FilePair, params: EvaluationParams, span: tuple[int, int] | None, rated: bool) -> Evaluation:
    if not rated and (rate := sequence_rate(pair.truth)) is not None:
        params = params.model_copy(update={"fps": rate})
    files = load_file(pair.tracks), load_file(pair.truth, truth=True)
    found, true = (file.table for file in files)
    if len(found) and len(true):
        (first, last), (begin, end) = ((int(t.frame.min()), int(t.frame.max())) for t in (found, true))
        if begin > last or end < first:
            raise InputError(
                f"{pair.truth}: expected truth of the frames {first} to {last} of {pair.tracks}, found {begin} to {end}"
            )
    if note := unfinished_note(pair.tracks):
        say(f"{note}{FINISHES}")
    run = RunFolder.around(pair.tracks)
    size = sequence_size(pair.truth) if run is None else run.info.size_px
    if params.match_on == "boxes" and size is not None:
        for path, table in ((pair.tracks, found), (pair.truth, true)):
            refuse_outside(table.box_px, size, str(path))
    if run is not None:  # the frames that it read are scored, as its report does
        run = RunFolder(run.path, pair.truth, found)
        end, what = run.n_frames - 1, "are left out: the run ended there"
    else:
        end = int(found.frame.max(initial=-1))
        what = f"count as misses; --frames 0:{max(end, 0)} leaves them out"
    beyond = int((true.frame > end).sum())
    if span is None and beyond:
        say(f"{beyond} truth rows lie after the last {'frame' if run else 'track'} (frame {end}) and {what}")
    try:
        result = evaluate_tracks(found, true, params, span) if run is None else run.evaluated(params, span)
    except InputError as error:
        raise error.about(f"{pair.tracks} and {pair.truth}") from error
    if result.uncovered:
        say(f"{pair.truth}: {result.uncovered}")
    return result


def _refined(tracks: Path) -> bool | None:
    """Whether the tracks of a run are refined; None without a run.json."""
    run = RunFolder.around(tracks) if tracks.name in ("tracks.csv", "tracks_online.csv") else None
    return None if run is None else tracks.name == "tracks.csv" and run.info.refined


def print_evaluation(result: Evaluation, console: Console, title: str, *, listed: bool = True) -> None:
    """The main figures in a line, all as a table, position errors by group, then every significant error."""
    values = result.to_json()
    console.print(f"{title}: {result.headline}", highlight=False, soft_wrap=True)
    title = f"{values['truth_rows']:,} positions in the truth ({values['ignored_rows']:,} too hidden, ignored)"
    table = Table("figure", Column("value", justify="right"), title=title)
    for row in evaluation_rows(values):
        table.add_row(*row)
    console.print(table)
    console.print(
        "id switches: every id change, including brief ones between people in contact; lasting identity changes: two "
        "when two people swap ids, and ids that pass to another person; at most: with 95 % confidence",
        highlight=False, soft_wrap=True,
    )  # fmt: skip
    table = Table("group", "positions", "matched [%]", "position error [m]", "standard deviation [m]")
    for key, text in (("by_distance", "{} m away"), ("by_visibility", "{} visible"), ("by_people", "{} people")):
        for row in values[key]:
            if row["truth_rows"]:
                errors = (figure_text(row[f"position_error_{name}_m"]) for name in ("mean", "std"))
                matched = f"{100 * row['matches'] / row['truth_rows']:.1f}"
                table.add_row(text.format(row["group"]), f"{row['truth_rows']:,}", matched, *errors)
    console.print(table)
    if result.alignment is not None:
        console.print("tracks laid over the truth:", values["alignment"])
    for error in result.significant if listed else []:
        console.print(f"frame {error.frame}: {error.kind}: {error.who}: {error.note}", highlight=False)


_DEFAULTS = AnalyticsParams()


@Parameter(name="*")
@dataclass(frozen=True)
class CountOptions:
    """What rules refer to, when a person counts, and where results go."""

    camera: Path | None = None
    """camera.toml that relates the pixels of rules to the floor."""
    rig: Path | None = None
    """Calibration of a stereo rig, with world.toml next to it, for the same."""
    truth: Path | None = None
    """True positions (truth.csv, gt.txt) or true events (as events.csv) to score the counts against."""
    window: float = 1.0
    """Largest time between a true and a found crossing that match, in seconds."""
    interval: float = _DEFAULTS.interval_s
    """Length of the intervals of the totals, in seconds."""
    hysteresis: float = _DEFAULTS.hysteresis_m
    """How far beyond a line people must be observed on both sides, in metres."""
    zone_hysteresis: float = _DEFAULTS.zone_hysteresis_m
    """How deep inside or outside a zone people must be observed to enter or leave it, in metres."""
    min_age: float = _DEFAULTS.min_age_s
    """Ignore tracks until they are this old, in seconds."""
    region: Region = None
    ignore: Ignored = None
    fps: float | None = None
    """Frame rate where the tracks have no timestamps; that of the run when not given."""
    out: Path | None = None
    """Folder for events.csv and counts.json; by default next to a file named tracks.csv, where counts of an earlier
    call or of the run are replaced, with a message; else nowhere."""
    json_output: JsonFlag = False


def count(tracks: Path, /, *, rules: Path, options: CountOptions = CountOptions()) -> None:
    """Count line crossings, zone occupancy and queues in tracks; write events.csv and counts.json.

    Example: planview count out/tracks.csv --rules rules.toml --json

    Example of rules.toml:
        [[tripwire]]
        name = "door"
        from_m = [0, 2]
        to_m = [1, 2]

    Parameters
    ----------
    tracks
        tracks.csv of a run, the folder of the run, or trajectories in a format of planview export.
    rules
        rules.toml with tripwires, zones (in metres or in pixels) and queues.
    """
    params = checked(
        AnalyticsParams, hysteresis_m=options.hysteresis, zone_hysteresis_m=options.zone_hysteresis,
        min_age_s=options.min_age, interval_s=options.interval,
    )  # fmt: skip
    if not options.window > 0:
        raise InputError(f"--window: expected a time greater than 0 s, found {options.window}")
    path = tracks_file(tracks)
    found = limited(load_file(path), options.region, options.ignore).table
    run = RunFolder.around(path)
    clock = Clock(found, options.fps or (run.info.fps if run is not None else None))
    placed = load_rules(rules, _plane(options.camera, options.rig, run))
    unfinished = unfinished_note(path)
    notes = unfinished and f"{unfinished}{FINISHES}", clock.jump(), placed.of_unknown_size, placed.unreached(found)
    for note in filter(None, notes):
        say(note)
    n_frames = run.info.frames_read + run.info.frames_skipped if run else 0
    counts = count_tracks(found, placed, params, clock=clock, n_frames=n_frames)
    if run is not None:
        counts = replace(counts, span=run.span)
    result = counts.to_json()
    if options.truth is not None:
        if _is_events(options.truth):
            scores = score_events(read_events(options.truth), counts, options.window)
        else:
            true = count_truth(load_truth(options.truth), counts.rules, clock, params, n_frames)
            scores = score_counts(true, counts, options.window)
        result |= {"scores": scores.to_json()}
    _write_counts(path, options.out, counts, result)
    if options.json_output:
        print(json.dumps(result, indent=2))
    else:
        print_counts(result, PlainConsole())


def _write_counts(tracks: Path, folder: Path | None, counts: Counts, result: dict[str, Any]) -> None:
    """Write events.csv and counts.json to a folder, else next to our own tracks; never into a folder of input data."""
    if folder is None and (tracks.name != "tracks.csv" or not os.access(tracks.parent, os.W_OK)):
        say("no events.csv and counts.json written: --out names a folder for them")
        return
    folder = folder or tracks.parent
    files = [file for file in (folder / "events.csv", folder / "counts.json") if file.exists()]
    events = io.StringIO()
    write_event_header(events)
    write_event_rows(events, counts.events)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_result(folder / "events.csv", events.getvalue())
    write_result(folder / "counts.json", json.dumps(result, indent=2) + "\n")
    if files:
        say(f"replaced {' and '.join(map(str, files))}")


def _plane(camera: Path | None, rig: Path | None, run: RunFolder | None) -> RulePlane:
    if camera is not None and rig is not None:
        raise InputError("--camera and --rig cannot be combined")
    if camera is not None:
        return RulePlane(load_one_camera(camera))
    if rig is not None:
        return stereo_plane(rig)
    return run.rule_plane if run is not None else RulePlane()


def _is_events(path: Path) -> bool:
    require_file(path, "truth or events")
    try:
        with path.open("rb") as file:
            return b"rule" in file.readline(10_000).strip().split(b",")
    except OSError as error:
        raise InputError(f"{path}: expected truth or events, found {reason(error)}") from error


def print_counts(result: dict[str, Any], console: Console) -> None:
    """A table of the totals, and of the scores where there are any."""
    table = Table("rule", "kind", "counts", title=f"{result['duration_s']:.1f} s of recording")
    for name, values in result["rules"].items():
        table.add_row(name, values["kind"], ", ".join(_figures(values)))
    console.print(table)
    for name, values in result.get("scores", {}).get("rules", {}).items():
        console.print(f"{name} against truth: " + ", ".join(_figures(values)), highlight=False)


def _figures(values: dict[str, Any]) -> list[str]:
    numbers = ((words_of(key), value) for key, value in values.items() if isinstance(value, int | float))
    figures = [f"{label} {value:,}" if isinstance(value, int) else f"{label} {value:.2f}" for label, value in numbers]
    groups = (group for group in values.get("groups", []) if group["frames"])
    people = "{people} people: {right_percent:.1f} % right, {mean_difference:+.2f}"
    return figures + [people.format(**group) for group in groups]
