"""Runs that are killed at random moments and resumed: are their results those of a run that was left alone?"""

from __future__ import annotations

import multiprocessing
import os
import runpy
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calib.errors import WorkError
from planview.runs.info import read_run_info

COMPARED = ("tracks.csv", "events.csv", "decisions.csv", "counts.json")
"""Files that must be the same byte for byte, where the run writes them."""
KILLED_AGAIN = 0.3
"""Share of the resumed runs that are killed too (our choice)."""


@dataclass(frozen=True)
class ResumedRun:
    """One run that was killed and resumed.

    Attributes:
        killed_after_s: time from the start of every process that was killed to its end [s].
        resumed_at: frames that were kept at the first kill.
        differing: files that differ from those of the run that was left alone.
    """

    killed_after_s: tuple[float, ...]
    resumed_at: int
    differing: tuple[str, ...]


@dataclass
class KillBench:
    """Kills runs of one command line.

    Attributes:
        words: of the command ``planview run``, without its output folder.
        place: folder for the results of all runs.
        seed: of the moments.
    """

    words: Sequence[str]
    place: Path
    seed: int = 0
    _longest_s: float = field(default=0.0, init=False)

    @property
    def _said(self) -> Path:
        return self.place / "said.txt"

    def reference(self) -> Path:
        """Results of the run that is left alone."""
        folder = self.place / "reference"
        started = time.monotonic()
        self._run(folder, ["--overwrite"])
        self._longest_s = time.monotonic() - started
        return folder

    def kills(self, count: int, tell: Callable[[str], None]) -> list[ResumedRun]:
        """Kill so many runs, each at a moment of its own, and resume them.

        Raises:
            WorkError: a run fails that is not killed.
        """
        rng, reference = np.random.default_rng(self.seed), self.reference()
        runs = []
        for n in range(count):
            runs.append(self._killed(rng, reference, self.place / f"killed{n}"))
            told = f"differs in {', '.join(runs[-1].differing)}" if runs[-1].differing else "identical"
            moments = " and ".join(f"{moment:.2f}" for moment in runs[-1].killed_after_s)
            tell(f"run {n + 1}: killed after {moments} s, resumed after {runs[-1].resumed_at} frames: {told}")
        return runs

    def _killed(self, rng: np.random.Generator, reference: Path, folder: Path) -> ResumedRun:
        moments = [float(rng.uniform(0.0, self._longest_s))]
        self._run(folder, ["--overwrite"], moments[0])
        kept = _frames_kept(folder)
        if rng.random() < KILLED_AGAIN:
            moments.append(float(rng.uniform(0.0, self._longest_s)))
            self._run(folder, ["--resume"], moments[1])
        self._run(folder, ["--resume"])
        differing = [name for name in COMPARED if not _same(reference / name, folder / name)]
        return ResumedRun(tuple(moments), kept, tuple(differing))

    def _run(self, folder: Path, more: list[str], kill_after_s: float | None = None) -> None:
        """One run in a process of its own, forked so that it does not begin with importing."""
        words = ["run", *self.words, "--out", str(folder), *more]
        process = multiprocessing.get_context("fork").Process(target=_command, args=(words, self._said))
        process.start()
        process.join(kill_after_s)
        if kill_after_s is not None:
            process.kill()
            process.join()
        elif process.exitcode != 0:
            said = self._said.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["nothing said"]
            raise WorkError(f"planview {' '.join(words)}: ended with status {process.exitcode} ({said[-1]})")


def _command(words: list[str], said: Path) -> None:
    """``python -m planview`` in this process."""
    with said.open("wb") as file:
        os.dup2(file.fileno(), 2)
    sys.argv = ["planview", *words]
    runpy.run_module("planview", run_name="__main__")


def _frames_kept(folder: Path) -> int:
    """Frames before the checkpoint that a killed run is resumed from; 0 without one."""
    checkpoint, info = folder / "checkpoint.npz", folder / "run.json"
    return read_run_info(info).frames_read if checkpoint.is_file() and info.is_file() else 0


def _same(a: Path, b: Path) -> bool:
    if not a.exists() or not b.exists():
        return a.exists() == b.exists()
    return a.read_bytes() == b.read_bytes()
