"""Count how often people who leave and come back get their id again: in members of the rendered scene ``returning``, or
in a run of a recording with a truth.csv.

Run: python tools/returns.py --seed 1301 --seed 1302
     python tools/returns.py RUN_FOLDER
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

import planview
from benchmarks.options import cache_folder
from benchmarks.suite import SUITE, suite_recording
from planview.output.report.plots import UNHELD, held_by
from planview.output.run_folder import RunFolder
from planview.trajectories.table import Trajectories

AWAY_S = 1.0
"""Somebody has left after this time without a row in the truth [s]."""


class Return(NamedTuple):
    """A true person who came back, how long after, and the ids before and after; UNHELD for none."""

    person: int
    away_s: float
    before: int
    after: int


def returns_of(tracks: Trajectories, truth: Trajectories, frame_s: float) -> list[Return]:
    """Everybody who came back, by the last id before and the first id after."""
    held = held_by(tracks, truth)
    found = []
    for person in np.unique(truth.track_id).tolist():
        rows = np.flatnonzero(truth.track_id == person)
        steps_s = np.diff(truth.frame[rows]) * frame_s
        for gap in np.flatnonzero(steps_s > AWAY_S).tolist():
            before = held[rows[: gap + 1]]
            after = held[rows[gap + 1 :]]
            found.append(Return(person, float(steps_s[gap]), last_held(before), last_held(after[::-1])))
    return found


def last_held(ids: np.ndarray) -> int:
    """The last id that is one."""
    known = ids[ids != UNHELD]
    return int(known[-1]) if len(known) else UNHELD


def main() -> None:
    """Print a row per return, and the share of those who got their id again."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, nargs="?")
    parser.add_argument("--seed", type=int, action="append", default=[])
    given = parser.parse_args()
    found: list[Return] = []
    if given.run is not None:
        run = RunFolder(given.run)
        found += returns_of(run.tracks, run.truth, run.frame_s)
    for seed in given.seed:
        recording, scene = suite_recording(SUITE / "returning.toml", seed, cache_folder(None))
        with TemporaryDirectory() as temporary:
            tracks = planview.run(recording, out=Path(temporary) / "out")
        found += returns_of(tracks, planview.read_truth(recording / "truth.csv"), 1.0 / scene.fps)
    judged = [each for each in found if UNHELD not in (each.before, each.after)]
    for each in judged:
        print(f"person {each.person}: away {each.away_s:.1f} s, id {each.before} -> {each.after}")
    same = sum(each.before == each.after for each in judged)
    print(f"{same} of {len(judged)} who came back got their id again ({len(found) - len(judged)} were not tracked)")


if __name__ == "__main__":
    main()
