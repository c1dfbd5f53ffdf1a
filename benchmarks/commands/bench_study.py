"""``python -m benchmarks study``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.commands.options import JsonFlag
from benchmarks.study import JOBS, LIMITS, StudySpeed, measure
from calib.errors import InputError


def bench_study(*, recording: Path | None = None, frames: int = 60, json_output: JsonFlag = False) -> None:
    """Time a study of 16 runs on one process and on two, from plan-view maps, and when it is finished.

    Example: python -m benchmarks study --frames 60

    Parameters
    ----------
    recording
        A stereo recording; the committed clip by default.
    frames
        Of each run.
    json_output
        Print one JSON object.
    """
    if frames < 1:
        raise InputError(f"--frames: expected at least 1, found {frames}")
    messages = Console(stderr=True, markup=False, highlight=False)
    speed = measure(recording, frames, messages.print)
    if json_output:
        print(json.dumps(asdict(speed) | {"ratios": speed.ratios}, indent=2))
    else:
        print_study(speed, Console(markup=False, highlight=False, soft_wrap=True))


def print_study(speed: StudySpeed, console: Console) -> None:
    """The times, and the ratios beside what they must keep."""
    rows = {
        f"{JOBS} runs of {speed.frames} frames, one process": speed.one_process_s,
        "the same on two processes": speed.two_processes_s,
        "from plan-view maps, recorded first": speed.maps_recorded_s,
        "another value of a tracker parameter, maps reused": speed.maps_reused_s,
        "the finished study again (the whole command)": speed.finished_again_s,
        "one run from the images, without opening": speed.job_s,
    }
    table = Table("study", "s")
    for name, value in rows.items():
        table.add_row(name, f"{value:.1f}")
    console.print(table)
    ratios = speed.ratios
    console.print(f"two processes: {ratios['two_processes']:.2f} times as fast (at least {LIMITS['two_processes']:g})")
    console.print(f"maps reused: {ratios['from_maps']:.1f} times as fast (at least {LIMITS['from_maps']:g})")
    console.print(f"finished again: {speed.finished_again_s:.1f} s (at most {LIMITS['finished_again_s']:g})")
    console.print(f"{speed.cores} cores, load {speed.load[0]:.1f} before and {speed.load[1]:.1f} after")
    if max(speed.load[0], speed.load[1] - 2) > 0.5:
        console.print("other programs were running: these times are not those of a free machine")
