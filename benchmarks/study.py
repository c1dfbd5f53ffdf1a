"""What a study gains: from two processes, from what is done already, from plan-view recordings."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from calib.errors import WorkError
from planview.sweep.pools import ProcessPool, cores
from planview.sweep.results import JobResult
from planview.sweep.study import RecordingEntry, Study
from planview.sweep.sweep import run_study
from planview.synthetic.assets import DEMO

JOBS = 16
PARAMETER = "template.width_m"
WIDTHS = [0.30 + 0.01 * i for i in range(JOBS)]
LIMITS = {"two_processes": 1.8, "finished_again_s": 3.0, "from_maps": 8.0}
"""Asked for: at least, at most, at least."""


@dataclass(frozen=True)
class StudySpeed:
    """Times [s] of a study of JOBS runs.

    Attributes:
        one_process_s, two_processes_s: all runs from the images.
        maps_recorded_s: the first study from plan-view maps, which records them.
        maps_reused_s: JOBS other values of one tracker parameter, on two processes.
        finished_again_s: the command on a finished study, from its start to its end.
        job_s: a run from the images, in its process.
        load: processes that wanted a core at the beginning and at the end, ours among them.
    """

    frames: int
    cores: int
    one_process_s: float
    two_processes_s: float
    maps_recorded_s: float
    maps_reused_s: float
    finished_again_s: float
    job_s: float
    load: tuple[float, float]

    @property
    def ratios(self) -> dict[str, float]:
        """The figures of LIMITS."""
        return {
            "two_processes": self.one_process_s / self.two_processes_s,
            "finished_again_s": self.finished_again_s,
            "from_maps": self.two_processes_s / self.maps_reused_s,
        }


class _Quiet:
    """A ``StudyWatch`` that keeps the longest run."""

    def __init__(self) -> None:
        self.job_s = 0.0

    def planned(self, runs: int, maps: int) -> None: ...

    def recorded(self, error: str) -> None: ...

    def ended(self, result: JobResult) -> None:
        if result.error:
            raise WorkError(f"{result.recording}: {result.error}")
        self.job_s = max(self.job_s, result.figures["elapsed_s"])


def measure(recording: Path | None, frames: int, say: Callable[[str], None]) -> StudySpeed:
    """Run the studies side by side.

    Args:
        recording: a stereo recording; the committed clip when None.
        frames: of each run.
        say: is told what is under way.
    Raises:
        WorkError: a run fails.
    """
    path, watch, before = (recording or DEMO).absolute(), _Quiet(), os.getloadavg()[0]
    with TemporaryDirectory(prefix="planview-study-") as folder:
        out = Path(folder)

        def timed(what: str, name: str, processes: int, maps: bool, widths: list[float]) -> float:
            say(what)
            study = Study(
                recordings=[RecordingEntry(path=path)], frames=frames, maps=maps, parameters={PARAMETER: widths}
            )
            started = time.monotonic()
            pool = ProcessPool(processes)
            run_study(study, [path.name], out / name, lambda: pool, watch)
            return time.monotonic() - started

        one = timed(f"{JOBS} runs on one process", "one", 1, False, WIDTHS)
        two = timed(f"{JOBS} runs on two processes", "two", 2, False, WIDTHS)
        job_s = watch.job_s
        first = timed(f"{JOBS} runs from plan-view maps, which are recorded first", "maps", 2, True, WIDTHS)
        changed = [width + 0.005 for width in WIDTHS]
        again = timed(f"{JOBS} runs with other values of {PARAMETER}", "maps", 2, True, changed)
        say("the finished study again")
        finished = _again(path, frames, out, changed)
    load = (before, os.getloadavg()[0])
    return StudySpeed(frames, cores(), one, two, first, again, finished, job_s, load)


def _again(recording: Path, frames: int, out: Path, widths: list[float]) -> float:
    """Time of the command on what the last study has finished."""
    path = out / "study.toml"
    path.write_text(
        f"recordings = [{json.dumps(str(recording))}]\nframes = {frames}\n[parameters]\n{PARAMETER} = {widths}\n"
    )
    command = [sys.executable, "-m", "planview", "sweep", str(path), "--out", str(out / "maps"), "--json"]
    started = time.monotonic()
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    taken = time.monotonic() - started
    with suppress(ValueError, KeyError):
        if all(run["reused"] for run in json.loads(ended.stdout)["runs"]):
            return taken
    raise WorkError(f"expected the finished study to be found again, found {ended.stderr[-300:]!r}")
