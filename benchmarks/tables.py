"""What long tables cost: count, evaluate and report of a run of hours, in processes of their own."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.errors import WorkError
from calib.types import F64
from planview.output.folder import RunInfo, write_run_info
from planview.trajectories.table import TRACK_COLUMNS, Trajectories, positions_table

LIMIT_S, LIMIT_MB = 10.0, 300.0
"""Asked for of every command on 500,000 rows."""
FPS = 15.0
HALL_M = (12.0, 8.0)
"""Width and depth of the floor on which people walk."""
VISIT_FRAMES = (300, 900)
"""Shortest and longest visit: 20 to 60 s."""
NOISE_M = 0.05
"""Deviation of a tracked position on each axis."""
_ID_SWITCHED = 1_000_000
RULES = """\
[[tripwire]]
name = "across"
from_m = [-6.0, 4.0]
to_m = [6.0, 4.0]

[[tripwire]]
name = "door"
from_m = [0.0, 0.0]
to_m = [0.0, 8.0]

[[zone]]
name = "till"
polygon_m = [[-2.0, 1.0], [2.0, 1.0], [2.0, 3.0], [-2.0, 3.0]]

[[queue]]
name = "waiting"
zone = "till"
"""
_REPORT = """\
import pathlib, sys
from planview.output.report.page import write_report
write_report(pathlib.Path(sys.argv[1]))
"""
_COMMANDS = {
    "count": ("-m", "planview", "count", "{run}", "--rules", "{run}/rules.toml", "--out", "{run}/counted", "--json"),
    "evaluate": ("-m", "planview", "evaluate", "{run}", "{run}/truth.csv", "--json"),
    "report": ("-c", _REPORT, "{run}"),
}


@dataclass(frozen=True)
class Cost:
    """What one command took: its processor time, its time from start to end [s], its greatest resident memory [MB]."""

    processor_s: float
    elapsed_s: float
    peak_mb: float


def measure(folder: Path, rows: int, people: float, say: Callable[[str], None], seed: int = 0) -> dict[str, Cost]:
    """Write the folder of a run with so many rows and its truth, and give its commands' costs by their names.

    Args:
        folder: an empty folder.
        rows: of the truth; the tracks have a few fewer.
        people: mean number in view.
        say: is told what is under way.
    Raises:
        WorkError: a command fails.
    """
    say(f"writing {rows} rows of about {people:g} people")
    # What a process has held until then counts in the peak of those that it starts: rows are written by another one.
    writer = multiprocessing.get_context("spawn").Process(target=write_run, args=(folder, rows, people, seed))
    writer.start()
    writer.join()
    if writer.exitcode:
        raise WorkError(f"{folder}: the tables could not be written (status {writer.exitcode})")
    costs = {}
    for name, words in _COMMANDS.items():
        say(name)
        costs[name] = _cost([word.replace("{run}", str(folder)) for word in words], folder / f"{name}.out")
    return costs


def walkers(rows: int, people: float, seed: int) -> Trajectories:
    """True positions of people who cross a hall on bent ways, ``rows`` of them."""
    rng = np.random.default_rng(seed)
    visits = int(np.ceil(rows / np.mean(VISIT_FRAMES) * 1.1)) + 1
    length = rng.integers(*VISIT_FRAMES, visits, endpoint=True)
    first = np.sort(rng.integers(0, max(1, round(rows / people)), visits))
    row_visit = np.repeat(np.arange(visits), length)
    since = np.arange(len(row_visit)) - np.repeat(np.cumsum(length) - length, length)
    part = since / length[row_visit]
    start, end = (rng.uniform((-HALL_M[0] / 2, 0.0), (HALL_M[0] / 2, HALL_M[1]), (visits, 2)) for _ in range(2))
    bend = rng.normal(0.0, 1.5, (visits, 2))[row_visit] * np.sin(np.pi * part)[:, None]
    xy = start[row_visit] + (end - start)[row_visit] * part[:, None] + bend
    frame, height = first[row_visit] + since, rng.normal(1.72, 0.09, visits)[row_visit]
    order = np.lexsort((row_visit, frame))[:rows]
    return positions_table(
        frame[order], row_visit[order] + 1, np.round(xy[order], 4), np.round(height[order], 3), frame[order] / FPS
    )


def write_run(folder: Path, rows: int, people: float, seed: int) -> None:
    """``tracks.csv`` and ``run.json`` of a finished run that found walkers, ``truth.csv`` and ``rules.toml``."""
    truth = walkers(rows, people, seed)
    tracks = _tracked(truth, np.random.default_rng([seed, 1]))
    columns = (*tracks.velocity_mps.T, tracks.height_m)
    with (folder / "tracks.csv").open("w", encoding="utf-8") as file:
        file.write(",".join(TRACK_COLUMNS) + "\n")
        places = zip(tracks.frame, tracks.timestamp_s, tracks.track_id, tracks.x_m, tracks.y_m, *columns, strict=True)
        for place, state, box in zip(places, tracks.state, tracks.box_px, strict=True):
            frame, moment, track_id, x, y, vx, vy, height = place
            tall = "" if np.isnan(height) else f"{height:.4f}"
            around = ",".join(f"{value:.1f}" for value in box)
            file.write(f"{frame},{moment:.4f},{track_id},{x:.4f},{y:.4f},{vx:.4f},{vy:.4f},{tall},{state},{around}\n")
    with (folder / "truth.csv").open("w", encoding="utf-8") as file:
        file.write("frame,id,x_m,y_m,height_m\n")
        for row in zip(truth.frame, truth.track_id, truth.x_m, truth.y_m, truth.height_m, strict=True):
            file.write("{},{},{:.4f},{:.4f},{:.3f}\n".format(*row))
    frames = int(truth.frame.max()) + 1 if len(truth) else 0
    info = RunInfo(input="hall", tracker="template", state="finished", finished=True, frames_read=frames)
    write_run_info(info, folder / "run.json")
    (folder / "rules.toml").write_text(RULES, encoding="utf-8")


def _tracked(truth: Trajectories, rng: np.random.Generator) -> Trajectories:
    """What a tracker would give: noise, a row in fifty missing, a tentative beginning, hidden stretches, and one person
    in five taken for another from the middle of the visit on."""
    kept = truth.where(rng.random(len(truth)) > 0.02)
    ids, first = np.unique(kept.track_id, return_index=True)
    visit = np.searchsorted(ids, kept.track_id)
    since = kept.frame - kept.frame[first][visit]
    switched = (rng.random(len(ids)) < 0.2)[visit] & (since > np.mean(VISIT_FRAMES) / 2)
    hidden = (since // 15 + 7 * visit) % 31 == 5
    state = np.select([since < 3, hidden], ["tentative", "lost"], "confirmed")
    xy = np.column_stack([kept.x_m, kept.y_m]) + rng.normal(0.0, NOISE_M, (len(kept), 2))
    tracks = replace(
        kept,
        track_id=np.where(switched, kept.track_id + _ID_SWITCHED, kept.track_id),
        x_m=xy[:, 0],
        y_m=xy[:, 1],
        height_m=np.where(since < 10, np.nan, kept.height_m),
        state=state,
        box_px=_boxes(xy, kept.height_m),
        velocity_mps=rng.normal(0.0, 0.8, (len(kept), 2)),
    )
    return tracks.where(np.lexsort((tracks.track_id, tracks.frame)))


def _boxes(xy_m: F64, height_m: F64) -> F64:
    """(N, 4) left, top, width, height as a camera of 400 px focal length 3 m before the hall would show them [px]."""
    scale = 400.0 / (xy_m[:, 1] + 3.0)
    tall = height_m * scale
    return np.column_stack([320 + xy_m[:, 0] * scale - tall / 6, 400 - tall, tall / 3, tall])


def _cost(words: list[str], said: Path) -> Cost:
    """Of Python with these words, which is waited for."""
    started = time.monotonic()
    with said.open("wb") as file:
        process = subprocess.Popen([sys.executable, *words], stdout=file, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    elapsed_s = time.monotonic() - started
    if process.returncode:
        told = said.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["nothing said"]
        raise WorkError(f"{' '.join(words[:3])}: ended with status {process.returncode} ({told[-1]})")
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return Cost(usage.ru_utime + usage.ru_stime, elapsed_s, usage.ru_maxrss / unit)
