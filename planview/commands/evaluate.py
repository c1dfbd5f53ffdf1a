"""``planview evaluate``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from calib.errors import InputError
from planview.commands.options import Flag, JsonFlag, checked
from planview.commands.spans import frame_span
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import KINDS, Evaluation, pooled
from planview.output.folder import read_run_info, unfinished_beside
from planview.output.progress import PlainConsole
from planview.trajectories.layouts import load_tracks, load_truth
from planview.trajectories.pairs import FilePair, file_pairs
from planview.trajectories.table import Trajectories

_FIGURES = (
    "mota", "idf1", "hota", "det_a", "ass_a", "switches", "switches_per_minute", "fragmentations", "mostly_tracked",
    "mostly_lost", "misses", "false_positives", "motp_m", "position_error_mean_m", "position_error_std_m",
    "height_error_mean_m",
)  # fmt: skip


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
    """Lay the tracks over the truth first by a rotation and a shift of the floor (another world frame)."""
    frames: str | None = None
    """First and last frame to score, e.g. 0:399."""
    fps: float = 30.0
    """Frame rate where the tracks have no timestamps."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def evaluate(tracks: Path, truth: Path, *, options: EvaluateOptions | None = None) -> None:
    """Score tracks against truth: CLEAR, IDF1, HOTA, position errors and significant errors.

    Of two folders every recording is scored by name, then all together.

    Example: planview evaluate out/tracks.csv recording/truth.csv --json

    Example on PETS: planview evaluate out/tracks.csv gt.txt --gate 1 --align --frames 0:399

    Example on MOTChallenge: planview evaluate trackers/mine gt --boxes --fps 25

    Parameters
    ----------
    tracks
        tracks.csv of a run, the folder of the run, trajectories in a format of planview export, or a folder of these.
    truth
        truth.csv (frame,id,x_m,y_m,height_m[,visible]), rows of PETS or MOTChallenge (gt.txt), another format of
        planview export, or a folder of these.
    """
    options = options or EvaluateOptions()
    params = checked(
        EvaluationParams,
        gate_m=options.gate,
        match_on="boxes" if options.boxes else "floor",
        min_visible=options.min_visible,
        align=options.align,
        fps=options.fps,
    )
    span = None if options.frames is None else frame_span(options.frames)
    pairs = file_pairs(tracks, truth)
    results = {pair.name: _evaluate_pair(pair, params, span) for pair in pairs}
    together = pooled(list(results.values())) if len(results) > 1 else next(iter(results.values()))
    if options.json_output:
        print(json.dumps(_json(pairs, results, together), indent=2))
    else:
        _print_all(pairs, results, together, PlainConsole())


def _evaluate_pair(pair: FilePair, params: EvaluationParams, span: tuple[int, int] | None) -> Evaluation:
    found, true = _tracks(pair.tracks, params), load_truth(pair.truth)
    _refuse_other_frames(pair, found, true)
    if told := unfinished_beside(pair.tracks):
        PlainConsole(stderr=True, soft_wrap=True).print(told)
    if span is None:
        _note_frames_beyond(found, true)
    try:
        return evaluate_tracks(found, true, params, span)
    except InputError as error:
        raise InputError(f"{pair.tracks} and {pair.truth}: {error}") from error


def _tracks(path: Path, params: EvaluationParams) -> Trajectories:
    """The tracks with what matching needs, and with boxes where they have nothing else."""
    boxes = params.align or params.match_on == "boxes"
    tracks = load_tracks(path, boxes=boxes)
    return tracks if boxes or np.isfinite(tracks.x_m).any() else load_tracks(path)


def _json(pairs: list[FilePair], results: dict[str, Evaluation], together: Evaluation) -> dict[str, Any]:
    """The figures of all, with those of every recording under its name where there are several."""
    if len(results) == 1:
        return {"tracks": str(pairs[0].tracks), "refined": _refined(pairs[0].tracks), **together.to_json()}
    recordings = {
        pair.name: {"tracks": str(pair.tracks), "refined": _refined(pair.tracks), **results[pair.name].to_json()}
        for pair in pairs
    }
    return {**together.to_json(), "recordings": recordings}


def _print_all(pairs: list[FilePair], results: dict[str, Evaluation], together: Evaluation, console: Console) -> None:
    for pair in pairs:
        kind = {True: " (refined)", False: " (online)", None: ""}[_refined(pair.tracks)]
        print_evaluation(results[pair.name], console, f"{pair.tracks}{kind}")
    if len(pairs) > 1:
        print_evaluation(together, console, f"{len(pairs)} recordings together", listed=False)


def _refined(tracks: Path) -> bool | None:
    """Whether the tracks of a run are refined; None where no run.json tells."""
    info = tracks.parent / "run.json"
    if tracks.name not in ("tracks.csv", "tracks_online.csv") or not info.is_file():
        return None
    return tracks.name == "tracks.csv" and read_run_info(info).refined


def print_evaluation(result: Evaluation, console: Console, title: str, *, listed: bool = True) -> None:
    """The figures as a table, the position errors by group, then every significant error in a line of its own."""
    values = result.to_json()
    console.print(_figures_table(values, title))
    console.print(_groups_table(values))
    if result.alignment is not None:
        console.print("tracks laid over the truth:", values["alignment"])
    for error in result.significant if listed else []:
        ids = [f"person {error.truth_id}"] if error.truth_id is not None else []
        ids += [f"track {error.track_id}"] if error.track_id is not None else []
        console.print(f"frame {error.frame}: {error.kind}: {', '.join(ids)}: {error.note}", highlight=False)


def _figures_table(values: dict[str, Any], title: str) -> Table:
    table = Table(title=f"{title}: {values['truth_rows']} truth rows ({values['ignored_rows']} too hidden, ignored)")
    table.add_column("metric")
    table.add_column("value", justify="right")
    for name in _FIGURES:
        table.add_row(name, _figure(values[name]))
    counts = values["significant_errors"]
    table.add_row("significant errors", f"{counts['total']}")
    for kind in KINDS:
        table.add_row(f"  {kind}", f"{counts[kind]}")
    for name in ("significant_errors_per_10_min", "strict_identity_changes", "strict_per_10_min"):
        table.add_row(name, _figure(values[name]))
    return table


def _groups_table(values: dict[str, Any]) -> Table:
    table = Table("group", "truth rows", "matched [%]", "position error [m]", "deviation [m]")
    for key, text in (("by_distance", "{} m away"), ("by_visibility", "{} visible"), ("by_people", "{} people")):
        for row in values[key]:
            if row["truth_rows"]:
                errors = (_figure(row[f"position_error_{name}_m"]) for name in ("mean", "std"))
                matched = f"{100 * row['matches'] / row['truth_rows']:.1f}"
                table.add_row(text.format(row["group"]), str(row["truth_rows"]), matched, *errors)
    return table


def _figure(value: float | int | None) -> str:
    return "-" if value is None else f"{value}" if isinstance(value, int) else f"{value:.3f}"


def _refuse_other_frames(pair: FilePair, tracks: Trajectories, truth: Trajectories) -> None:
    """Truth that ends before the first track or begins after the last one is of another recording."""
    if not len(tracks) or not len(truth):
        return
    (first, last), (begin, end) = ((int(t.frame.min()), int(t.frame.max())) for t in (tracks, truth))
    if begin > last or end < first:
        raise InputError(
            f"{pair.truth}: expected truth of the frames {first} to {last} of {pair.tracks}, found {begin} to {end}"
        )


def _note_frames_beyond(tracks: Trajectories, truth: Trajectories) -> None:
    if not len(truth):
        return
    end = int(tracks.frame.max()) if len(tracks) else -1
    beyond = int((truth.frame > end).sum())
    if beyond:
        PlainConsole(stderr=True).print(
            f"{beyond} truth rows lie after the last track (frame {end}) and count as misses; "
            f"--frames 0:{max(end, 0)} leaves them out"
        )
