"""``planview evaluate``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from calib.errors import InputError
from calib.params import first_problem
from planview.evaluation.evaluate import KINDS, Evaluation, EvaluationParams, evaluate_tracks
from planview.trajectories.layouts import load_tracks, load_truth
from planview.trajectories.table import Trajectories


def evaluate(
    tracks: Path,
    truth: Path,
    *,
    gate: float = 0.5,
    boxes: Annotated[bool, Parameter(negative="")] = False,
    min_visible: float = 0.25,
    align: Annotated[bool, Parameter(negative="")] = False,
    frames: str | None = None,
    fps: float = 30.0,
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Score tracks against truth: CLEAR, IDF1, HOTA, position errors and significant errors.

    Example: planview evaluate out/tracks.csv recording/truth.csv --json

    Example on PETS: planview evaluate out/tracks.csv gt.txt --gate 1 --align --frames 0:399

    Parameters
    ----------
    tracks
        tracks.csv of a run, or the folder of the run.
    truth
        truth.csv (frame,id,x_m,y_m,height_m[,visible]) or rows of PETS or MOTChallenge (gt.txt).
    gate
        Largest distance on the floor of a match, in metres.
    boxes
        Match image boxes at IoU 0.5 instead of floor positions.
    min_visible
        Ignore truth rows less visible than this fraction, and tracks on them.
    align
        Lay the tracks over the truth first by a rotation and a shift of the floor (another world frame).
    frames
        First and last frame to score, e.g. 0:399.
    fps
        Frame rate where the tracks have no timestamps.
    json_output
        Print one JSON object.
    """
    try:
        params = EvaluationParams(
            gate_m=gate, match_on="boxes" if boxes else "floor", min_visible=min_visible, align=align, fps=fps
        )
    except ValueError as error:
        raise InputError(_option_error(error)) from error
    tracks_path = tracks / "tracks.csv" if tracks.is_dir() else tracks
    found, true = load_tracks(tracks_path), load_truth(truth)
    span = None if frames is None else _span(frames)
    if span is None:
        _note_frames_beyond(found, true)
    try:
        result = evaluate_tracks(found, true, params, span)
    except InputError as error:
        raise InputError(f"{tracks_path} and {truth}: {error}") from error
    if json_output:
        print(json.dumps(result.to_json(), indent=2))
    else:
        print_evaluation(result, Console(markup=False))


def print_evaluation(result: Evaluation, console: Console) -> None:
    """The figures as a table, then every significant error in a line of its own."""
    values = result.to_json()
    table = Table(title=f"{values['truth_rows']} truth rows ({values['ignored_rows']} too hidden, ignored)")
    table.add_column("metric")
    table.add_column("value", justify="right")
    for name in (
        "mota", "idf1", "hota", "switches", "misses", "false_positives", "motp_m",
        "position_error_mean_m", "position_error_std_m", "height_error_mean_m",
    ):  # fmt: skip
        table.add_row(name, _figure(values[name]))
    counts = values["significant_errors"]
    table.add_row("significant errors", f"{counts['total']}")
    for kind in KINDS:
        table.add_row(f"  {kind}", f"{counts[kind]}")
    console.print(table)
    if result.alignment is not None:
        console.print("tracks laid over the truth:", values["alignment"])
    for error in result.significant:
        ids = [f"person {error.truth_id}"] if error.truth_id is not None else []
        ids += [f"track {error.track_id}"] if error.track_id is not None else []
        console.print(f"frame {error.frame}: {error.kind}: {', '.join(ids)}: {error.note}", highlight=False)


def _figure(value: float | int | None) -> str:
    return "-" if value is None else f"{value}" if isinstance(value, int) else f"{value:.3f}"


def _span(text: str) -> tuple[int, int]:
    first, _, last = text.partition(":")
    try:
        span = int(first or 0), int(last)
    except ValueError:
        raise InputError(f"--frames: expected FIRST:LAST, e.g. 0:399, found {text!r}") from None
    if span[0] > span[1]:
        raise InputError(f"--frames: expected FIRST:LAST with FIRST not after LAST, found {text!r}")
    return span


def _note_frames_beyond(tracks: Trajectories, truth: Trajectories) -> None:
    if not len(truth):
        return
    end = int(tracks.frame.max()) if len(tracks) else -1
    beyond = int((truth.frame > end).sum())
    if beyond:
        Console(stderr=True, markup=False).print(
            f"{beyond} truth rows lie after the last track (frame {end}) and count as misses; "
            f"--frames 0:{max(end, 0)} leaves them out"
        )


def _option_error(error: ValueError) -> str:
    from pydantic import ValidationError

    return first_problem(error) if isinstance(error, ValidationError) else str(error)
