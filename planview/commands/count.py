"""``planview count``."""

from __future__ import annotations

import io
import json
import os
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from calib.errors import InputError, WorkError
from calib.files import write_whole
from calib.text import reason, require_file
from planview.commands.options import JsonFlag, checked
from planview.counting.clock import Clock
from planview.counting.count import count_tracks, count_truth
from planview.counting.events import read_events, write_event_header, write_event_rows
from planview.counting.geometry import RulePlane
from planview.counting.params import AnalyticsParams
from planview.counting.rules import load_rules
from planview.counting.scoring import CountScores, score_counts, score_events
from planview.counting.totals import Counts
from planview.output.folder import RunInfo, read_run_info, unfinished_beside
from planview.output.progress import PlainConsole
from planview.trajectories.layouts import load_file, load_truth
from planview.trajectories.pairs import tracks_file
from planview.trajectories.regions import limited
from planview.trajectories.table import Trajectories

_DEFAULTS = AnalyticsParams()


@Parameter(name="*")
@dataclass(frozen=True)
class CountOptions:
    """What rules refer to, when a person counts, and where results go."""

    camera: Path | None = None
    """camera.toml that relates the pixels of rules to the floor."""
    rig: Path | None = None
    """Calibration of a stereo rig, with world.toml beside it, for the same."""
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
    """Tracks younger than this count nothing yet, in seconds."""
    region: str | None = None
    """Polygon in well-known text [m], or a file with it: rows outside do not count."""
    ignore: str | None = None
    """Polygon in well-known text [m], or a file with it: rows inside do not count."""
    fps: float = 30.0
    """Frame rate where the tracks have no timestamps."""
    out: Path | None = None
    """Folder for events.csv and counts.json; by default beside a file named tracks.csv, else nowhere."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def count(tracks: Path, *, rules: Path, options: CountOptions | None = None) -> None:
    """Count line crossings, zone occupancy and queues in tracks; write events.csv and counts.json.

    Example: planview count out/tracks.csv --rules rules.toml --json

    Example of rules.toml: [[tripwire]] name = "door", from_m = [0, 2], to_m = [1, 2]; [[zone]] name = "till",
    polygon_m = [[0, 0], [2, 0], [2, 1]]; [[queue]] name = "waiting", zone = "till".

    Parameters
    ----------
    tracks
        tracks.csv of a run, the folder of the run, or trajectories in a format of planview export.
    rules
        rules.toml with tripwires, zones (in metres or in pixels) and queues.
    """
    options = options or CountOptions()
    params = checked(
        AnalyticsParams,
        hysteresis_m=options.hysteresis,
        zone_hysteresis_m=options.zone_hysteresis,
        min_age_s=options.min_age,
        interval_s=options.interval,
    )
    path = tracks_file(tracks)
    found = limited(load_file(path), options.region, options.ignore).table
    info = _run_beside(path)
    clock = Clock(found, options.fps)
    for told in (unfinished_beside(path), clock.jump()):
        if told:
            PlainConsole(stderr=True, soft_wrap=True).print(told)
    rules_in_plane = load_rules(rules, _plane(options.camera, options.rig, info))
    n_frames = info.frames_read + info.frames_skipped if info else 0
    counts = count_tracks(found, rules_in_plane, params, clock=clock, n_frames=n_frames)
    result = counts.to_json()
    if options.truth is not None:
        result |= {"scores": _score(options.truth, counts, params, clock, options.window, n_frames).to_json()}
    folder = _folder(options.out, path)
    if folder is not None:
        _write(counts, result, folder)
    if options.json_output:
        print(json.dumps(result, indent=2))
    else:
        print_counts(result, PlainConsole())


def _run_beside(path: Path) -> RunInfo | None:
    info = path.parent / "run.json"
    return read_run_info(info) if info.is_file() else None


def _plane(camera: Path | None, rig: Path | None, info: RunInfo | None) -> RulePlane:
    if camera is not None and rig is not None:
        raise InputError("expected --camera or --rig, found both")
    if camera is not None:
        from calib.ground_camera import load_ground_camera

        return RulePlane(load_ground_camera(camera))
    if rig is not None:
        from planview.counting.cameras import stereo_plane

        return stereo_plane(rig)
    return RulePlane(image_size=(info.rig.width, info.rig.height) if info and info.rig else None)


def _score(
    truth: Path, counts: Counts, params: AnalyticsParams, clock: Clock, window: float, n_frames: int
) -> CountScores:
    if not window > 0:
        raise InputError(f"--window: expected a time greater than 0 s, found {window}")
    if _is_events(truth):
        return score_events(read_events(truth), counts, window)
    true: Trajectories = load_truth(truth)
    return score_counts(count_truth(true, counts.rules, clock, params, n_frames), counts, window)


def _is_events(path: Path) -> bool:
    require_file(path, "truth or events")
    try:
        with path.open("rb") as file:
            return b"rule" in file.readline(10_000).strip().split(b",")
    except OSError as error:
        raise InputError(f"{path}: expected truth or events, found {reason(error)}") from error


def _folder(out: Path | None, tracks: Path) -> Path | None:
    """Where results go: as asked for, else beside our own tracks; never into a folder of input data."""
    if out is not None:
        return out
    beside = tracks.parent
    if tracks.name == "tracks.csv" and beside.stat().st_mode & stat.S_IWUSR and os.access(beside, os.W_OK):
        return beside
    PlainConsole(stderr=True).print("no events.csv and counts.json written: --out names a folder for them")
    return None


def _write(counts: Counts, result: dict[str, Any], folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        events = io.StringIO()
        write_event_header(events)
        write_event_rows(events, counts.events)
        write_whole(folder / "events.csv", events.getvalue())
        write_whole(folder / "counts.json", json.dumps(result, indent=2) + "\n")
    except OSError as error:
        raise WorkError(f"{folder}: could not write events.csv and counts.json: {reason(error)}") from error


def print_counts(result: dict[str, Any], console: Console) -> None:
    """A table of the totals, and of the scores where there are any."""
    table = Table("rule", "kind", "counts", title=f"{result['duration_s']:.1f} s of recording")
    for name, values in result["rules"].items():
        table.add_row(name, values["kind"], ", ".join(_figures(values)))
    console.print(table)
    for name, values in result.get("scores", {}).get("rules", {}).items():
        console.print(f"{name} against truth: " + ", ".join(_figures(values)), highlight=False)


def _figures(values: dict[str, Any]) -> Sequence[str]:
    shown = {key: value for key, value in values.items() if isinstance(value, int | float)}
    figures = [f"{key} {value}" if isinstance(value, int) else f"{key} {value:.2f}" for key, value in shown.items()]
    groups = [group for group in values.get("groups", []) if group["frames"]]
    return figures + [
        f"{group['people']} people: {group['right_percent']:.1f} % right, {group['mean_difference']:+.2f}"
        for group in groups
    ]
