"""Runs that are killed at random moments and resumed: are their results those of a run that was left alone?"""

from __future__ import annotations

import multiprocessing
import os
import runpy
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from calib.errors import WorkError
from planview.output.folder import read_run_info

COMPARED = ("tracks.csv", "events.csv", "decisions.csv", "counts.json")
"""Files that must be the same byte for byte, where the run writes them."""
KILLED_AGAIN = 0.3
"""Share of the resumed runs that are killed too (our choice)."""
WHILE_WRITING = 0.3
"""Share of the kills that fall while a checkpoint is written (our choice)."""
WRITING_S = 0.02
"""Longest time from the beginning of a checkpoint to the kill: about what writing takes [s]."""
DRAWS_MAX = 3
"""Moments drawn per kill asked for: a run can end between its last frame and the kill."""


class Moment(NamedTuple):
    """When a run is killed: ``delay_s`` after its n-th frame, or after it began to write its n-th checkpoint."""

    number: int
    while_writing: bool
    delay_s: float

    def __str__(self) -> str:
        return f"{'checkpoint' if self.while_writing else 'frame'} {self.number}"


@dataclass(frozen=True)
class ResumedRun:
    """One run that was killed and resumed.

    Attributes:
        killed_at: the moments of the processes that were killed, in words.
        resumed_at: frames that were kept at each kill; 0 where the run began anew.
        differing: files that differ from those of the run that was left alone.
    """

    killed_at: tuple[str, ...]
    resumed_at: tuple[int, ...]
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
    _frames: int = field(default=0, init=False)
    _frame_s: float = field(default=0.0, init=False)

    @property
    def _said(self) -> Path:
        return self.place / "said.txt"

    def reference(self) -> Path:
        """Results of the run that is left alone."""
        folder = self.place / "reference"
        import_module("planview.commands.run")  # here, so that no process that is forked has to
        started = time.monotonic()
        self._run(folder, ["--overwrite"])
        self._frames = read_run_info(folder / "run.json").frames_read
        self._frame_s = (time.monotonic() - started) / max(1, self._frames)
        return folder

    def kills(self, count: int, tell: Callable[[str], None]) -> list[ResumedRun]:
        """Kill so many runs, each at a moment of its own, and resume them; runs that ended before count for nothing.

        Raises:
            WorkError: a run fails that is not killed, or most runs end before they are killed.
        """
        rng, reference = np.random.default_rng(self.seed), self.reference()
        runs: list[ResumedRun] = []
        for n in range(DRAWS_MAX * count):
            done = self._killed(rng, reference, self.place / f"killed{n}")
            if done is None:
                tell("the run ended before it was killed: not counted")
                continue
            runs.append(done)
            told = f"differs in {', '.join(done.differing)}" if done.differing else "identical"
            kept = " and ".join(map(str, done.resumed_at))
            tell(f"run {len(runs)}: killed at {' and '.join(done.killed_at)}, resumed after {kept} frames: {told}")
            if len(runs) == count:
                return runs
        raise WorkError(
            f"only {len(runs)} of {DRAWS_MAX * count} runs could be killed before they ended: too few frames"
        )

    def _killed(self, rng: np.random.Generator, reference: Path, folder: Path) -> ResumedRun | None:
        moments = [self._drawn(rng, 0)]
        if not self._run(folder, ["--overwrite"], moments[0]):
            return None
        kept = [_frames_kept(folder)]
        if rng.random() < KILLED_AGAIN:
            again = self._drawn(rng, kept[0])
            if self._run(folder, ["--resume"], again):
                moments.append(again)
                kept.append(_frames_kept(folder))
        self._run(folder, ["--resume"])
        differing = [name for name in COMPARED if not _same(reference / name, folder / name)]
        return ResumedRun(tuple(map(str, moments)), tuple(kept), tuple(differing))

    def _drawn(self, rng: np.random.Generator, kept: int) -> Moment:
        """A moment after so many frames."""
        if rng.random() < WHILE_WRITING:
            return Moment(int(rng.integers(1, 4)), True, float(rng.uniform(0, WRITING_S)))
        return Moment(int(rng.integers(kept + 1, self._frames + 1)), False, float(rng.uniform(0, self._frame_s)))

    def _run(self, folder: Path, more: list[str], moment: Moment | None = None) -> bool:
        """One run in a process of its own, forked so that it does not begin with importing; whether it was killed."""
        words = ["run", *self.words, "--out", str(folder), *more]
        process = multiprocessing.get_context("fork").Process(target=_command, args=(words, self._said, moment))
        process.start()
        process.join()
        if process.exitcode == -signal.SIGKILL and moment is not None:
            return True
        if process.exitcode != 0:
            said = self._said.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["nothing said"]
            raise WorkError(f"planview {' '.join(words)}: ended with status {process.exitcode} ({said[-1]})")
        return False


def _command(words: list[str], said: Path, moment: Moment | None) -> None:
    """``python -m planview`` in this process, which kills itself at the moment."""
    with said.open("wb") as file:
        os.dup2(file.fileno(), 2)
    mock.patch("planview.output.report.page.write_report").start()  # the page takes longer than a short run
    if moment is not None:
        _arm(moment)
    sys.argv = ["planview", *words]
    runpy.run_module("planview", run_name="__main__")


def _arm(moment: Moment) -> None:
    """Let the run's own steps count, so that a moment means the same on a fast and on a slow machine."""
    from planview.output import run
    from planview.output.resume import write_checkpoint
    from planview.output.totals import RunTotals

    kill = threading.Timer(moment.delay_s, os.kill, (os.getpid(), signal.SIGKILL))
    kill.daemon = True
    take, write, written = RunTotals.take, write_checkpoint, 0

    def counted_take(totals: RunTotals, result: Any) -> None:
        take(totals, result)
        if totals.frames == moment.number:
            kill.start()

    def counted_write(*arguments: Any) -> None:
        nonlocal written
        written += 1
        if written == moment.number:
            kill.start()
        write(*arguments)

    place: tuple[Any, str, Any] = (RunTotals, "take", counted_take)
    if moment.while_writing:
        place = run, "write_checkpoint", counted_write
    mock.patch.object(*place).start()


def _frames_kept(folder: Path) -> int:
    """Frames before the checkpoint that a killed run is resumed from; 0 without one."""
    checkpoint, info = folder / "checkpoint.npz", folder / "run.json"
    return read_run_info(info).frames_read if checkpoint.is_file() and info.is_file() else 0


def _same(a: Path, b: Path) -> bool:
    if not a.exists() or not b.exists():
        return a.exists() == b.exists()
    return a.read_bytes() == b.read_bytes()
