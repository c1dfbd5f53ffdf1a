"""``python -m benchmarks resume``."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from benchmarks.commands.options import JsonFlag
from benchmarks.resume import KillBench, ResumedRun
from calib.errors import InputError, WorkError
from planview.engine.factory import TrackerName


def bench_resume(
    recording: Path,
    *,
    kills: int = 50,
    seed: int = 0,
    frames: int = 0,
    tracker: TrackerName = "template",
    camera: Path | None = None,
    rules: Path | None = None,
    checkpoint_every: float = 0.05,
    set_: Annotated[Sequence[str], Parameter(name="--set")] = (),
    json_output: JsonFlag = False,
) -> None:
    """Kill runs at random frames and while they write checkpoints, resume them, and compare their results with those of
    a run that is left alone.

    Example: python -m benchmarks resume out/maps.h5 --kills 50

    Parameters
    ----------
    recording
        Whatever planview run takes; plan-view maps are the cheapest.
    kills
        How many runs are killed (three in ten of them twice).
    seed
        Of the moments.
    frames
        Frames per run; 0 for all.
    tracker
        As for planview run.
    camera
        As for planview run.
    rules
        As for planview run.
    checkpoint_every
        Time between two checkpoints, in seconds.
    set_
        As for planview run.
    json_output
        Print one JSON object.
    """
    if kills < 1:
        raise InputError(f"--kills: expected a number from 1, found {kills}")
    words = _words(recording, frames, checkpoint_every, set_, tracker=tracker, camera=camera, rules=rules)
    messages = Console(stderr=True, markup=False, soft_wrap=True)
    with tempfile.TemporaryDirectory(prefix="planview-resume-") as place:
        runs = KillBench(words, Path(place), seed).kills(kills, lambda text: messages.print(text, highlight=False))
    _report(runs, json_output)


def _words(
    recording: Path, frames: int, checkpoint_every: float, settings: Sequence[str], **options: str | Path | None
) -> list[str]:
    """Words of ``planview run``; options that are None are left out."""
    given: dict[str, object] = {"checkpoint-every": f"{checkpoint_every:g}", "frames": frames or None, **options}
    words = [str(recording), "--debug"]
    words += [word for name, value in given.items() if value is not None for word in (f"--{name}", str(value))]
    return words + [word for setting in settings for word in ("--set", setting)]


def _report(runs: Sequence[ResumedRun], json_output: bool) -> None:
    kills, identical = len(runs), sum(not run.differing for run in runs)
    resumed = sum(kept > 0 for run in runs for kept in run.resumed_at)
    total = sum(len(run.resumed_at) for run in runs)
    if json_output:
        figures = {"kills": kills, "identical": identical, "from_checkpoint": resumed, "resumptions": total}
        print(json.dumps(figures | {"runs": [asdict(run) for run in runs]}, indent=2))
    else:
        print(
            f"{identical}/{kills} runs identical after kill and resumption "
            f"({resumed} of {total} resumptions from a checkpoint, the others from the beginning)"
        )
    if identical < kills:
        raise WorkError(f"{kills - identical} of {kills} resumed runs differ from the run that was left alone")
