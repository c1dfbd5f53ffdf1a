"""Truth and significant errors on the timelines of a rerun recording, once the run is over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from calib.errors import InputError, WorkError
from planview.evaluation.significant import SignificantError
from planview.output.report.scores import errors_of, scores_of
from planview.output.scene.results import RunResults, read_results
from planview.trajectories.table import Trajectories

HEIGHT_M = 1.7
"""Of a true person whose height is not known."""
TRUTH_COLOUR = (255, 255, 255)


def log_verdict(stream: rr.RecordingStream, folder: Path) -> RunResults | None:
    """Log the truth of the recording and the errors against it, where there is one.

    Args:
        folder: of the run, its tables complete.
    Returns:
        What the run left; None where it cannot be read.
    """
    try:
        results = read_results(folder)
        errors = errors_of(scores_of(results))
    except (InputError, WorkError):
        return None
    if results.truth is not None:
        _log_truth(stream, results, results.truth)
    _log_errors(stream, results, errors)
    return results


def _log_truth(stream: rr.RecordingStream, results: RunResults, truth: Trajectories) -> None:
    """Points on the floor and at the heads, a row per frame."""
    frames, starts, counts = np.unique(truth.frame, return_index=True, return_counts=True)
    if not len(frames):
        return
    rows = slice(int(starts[0]), int(starts[-1] + counts[-1]))
    xy = np.column_stack([truth.x_m[rows], truth.y_m[rows]])
    heights = np.nan_to_num(truth.height_m[rows], nan=HEIGHT_M)
    indexes = [
        rr.TimeColumn("frame", sequence=frames),
        rr.TimeColumn("time", duration=results.clock.at(frames)),
    ]
    for path, z, radius in (("plan/truth", np.full(len(xy), 0.04), 0.06), ("world/truth", heights, 0.05)):
        points = np.column_stack([xy, z]).astype(np.float32)
        columns = rr.Points3D.columns(positions=points).partition(counts)
        rr.send_columns(path, indexes, columns, recording=stream)
        stream.log(path, rr.Points3D.from_fields(colors=[TRUTH_COLOUR], radii=[radius]), static=True)


def _log_errors(stream: rr.RecordingStream, results: RunResults, errors: list[SignificantError]) -> None:
    for error in errors:
        stream.set_time("frame", sequence=error.frame)
        stream.set_time("time", duration=float(results.clock.at(np.array([error.frame]))[0]))
        who = [f"person {error.truth_id}"] if error.truth_id is not None else []
        who += [f"track {error.track_id}"] if error.track_id is not None else []
        text = f"{error.kind.replace('_', ' ')}: {', '.join(who)}: {error.note}"
        stream.log("errors", rr.TextLog(text, level=rr.TextLogLevel.ERROR))
