"""Real plan-view recordings with truth: how often the right number of people is found, and who is who."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from pandas import read_csv

from benchmarks.options import JsonFlag, progress, report
from benchmarks.passes import FACING, bench_engine
from calib.errors import InputError
from calib.types import I64
from planview.engine.config import load_config
from planview.engine.open import base_config
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.script import run
from planview.synthetic.assets import real_recordings
from planview.trajectories.table import Trajectories, positions_table, read_truth

BASELINE = "peaks"
"""The tracker to beat, which is always scored too."""
PRINTED = ("mota", "idf1", "position_error_mean_m", "misses", "false_positives", "facing deg")
WALKER_PATH = "walker_path_from_depth.csv"
WALKER_VISIBLE_FRAMES, BESIDE_WALKER_M = 30, 0.3
"""The walker's path comes without ids: later the walker stands cut by the image's border, and so does a second person
to the right [m] (README of the recording). Its frames without a row are not judged."""


def recordings_with_truth(data: Path, names: Sequence[str] = ()) -> list[Path]:
    """Folders of recordings with truth on the floor, by name. Raises InputError: there is none, or none of a name."""
    known = {p.name: p for p in sorted(data.glob("*")) if (p / "truth.csv").is_file() or (p / WALKER_PATH).is_file()}
    for name in names:
        if name not in known:
            raise InputError(f"--recording: expected one of {', '.join(known) or 'none'} in {data}, found {name!r}")
    if not known:
        raise InputError(
            f"{data}: no recordings with truth.csv; --data or $PLANVIEW_TEST_DATA names their folder, and "
            "docs/results.md has their sources"
        )
    return [known[name] for name in names or known]


def truth_of(folder: Path) -> Trajectories:
    """People of a recording on the floor."""
    if (folder / "truth.csv").is_file():
        return read_truth(folder / "truth.csv")
    rows = read_csv(folder / WALKER_PATH)[["frame", "x_m", "z_m", "height_m"]].to_numpy(np.float64)
    frame = rows[:, 0].astype(np.int64)
    is_second = (frame >= WALKER_VISIBLE_FRAMES) & (rows[:, 1] > BESIDE_WALKER_M)
    ids = 1 + is_second.astype(np.int64)
    order = np.lexsort((ids, frame))
    visible = (frame < WALKER_VISIBLE_FRAMES).astype(np.float64)
    return positions_table(frame[order], ids[order], rows[order, 1:3], rows[order, 3], visible=visible[order])


def score_real(tracks: Trajectories, truth: Trajectories, frames: I64) -> dict[str, float]:
    """Figures of the confirmed tracks of a recording in the (F,) frames that are judged.

    Returns:
        right_number: share of frames in which as many people are reported as show; those too hidden or cut off to judge
        (``visible`` 0 in the truth) may be reported or not. ids, people: confirmed ids, and people who show at any
        time.
    """
    confirmed = tracks.where(np.isin(tracks.frame, frames) & (tracks.state == "confirmed"))
    shown = truth.where(~(truth.visible <= 0))
    n = int(frames.max()) + 1
    found, least, most = (np.bincount(t.frame, minlength=n)[frames] for t in (confirmed, shown, truth))
    return {
        "right_number": float(((found >= least) & (found <= most)).mean()),
        "ids": len(np.unique(confirmed.track_id)),
        "people": len(np.unique(shown.track_id)),
    }


@Parameter(name="*")
@dataclass(frozen=True)
class RealOptions:
    """Which recordings are tracked, and by what."""

    data: Path | None = None
    """Folder with recordings; $PLANVIEW_TEST_DATA, else ../shared/data of the repository, by default."""
    recording: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these recordings, by the names of their folders."""
    tracker: Annotated[Sequence[str], Parameter(negative="")] = ("joint",)
    """Trackers, as of planview run; the baseline of height peaks is always added."""
    set_: Annotated[Sequence[str], Parameter(name="--set", negative="", show_default=False)] = ()
    """One parameter of the engine."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def real(*, options: RealOptions | None = None) -> None:
    """Score every real plan-view recording with truth, and the baseline of height peaks.

    A recording is a folder with truth.csv (frame, id, x_m, y_m, height_m, visible); people with visible 0 are too
    hidden or cut off to judge, and may be reported or not. docs/results.md has the sources of the recordings.

    Example: python -m benchmarks real --data ../shared/data --recording rgbd-six-people
    """
    o = options or RealOptions()
    rows = []
    for folder in recordings_with_truth(o.data or real_recordings(), o.recording):
        truth = truth_of(folder)
        for tracker in dict.fromkeys((*o.tracker, BASELINE)):
            progress(f"{folder.name}: {tracker}")
            engine = bench_engine(folder, tracker, load_config(None, o.set_, base_config(folder)))
            tracks = run(engine)
            judged = np.unique(truth.frame)
            if (folder / "truth.csv").is_file():  # frames without a row are empty
                judged = np.arange(max(engine.recording.n_frames, int(judged.max()) + 1))
            scores = evaluate_tracks(tracks.where(np.isin(tracks.frame, judged)), truth)
            figures = scores.to_json() | {"facing deg": scores.facing.walkers_deg}
            names = figures if o.json_output else PRINTED
            counts = {"recording": folder.name, "tracker": tracker, **score_real(tracks, truth, judged)}
            rows.append(counts | {name: figures[name] for name in names})
    report(o.json_output, scores=rows)
    progress("right number: as many people are reported as show; those too hidden to judge may be reported or not")
    progress(f"facing deg: {FACING}")
