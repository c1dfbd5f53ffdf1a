"""``planview bench speed``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from calib.errors import InputError
from planview.bench.commands.options import JsonFlag
from planview.bench.speed import LIMITS, Speed, measure


def bench_speed(
    *,
    recording: Path | None = None,
    frames: int = 200,
    json_output: JsonFlag = False,
) -> None:
    """Time every stage side by side with plain OpenCV on the same frames.

    Example: planview bench speed --json

    Example on your own recording: planview bench speed --recording my_recording --frames 100

    Parameters
    ----------
    recording
        A stereo recording; the committed clip by default. Its first frames should show nobody.
    frames
        Medians over so many frames.
    json_output
        Print one JSON object.
    """
    if frames < 10:
        raise InputError(f"--frames: expected at least 10, found {frames}")
    messages = Console(stderr=True, markup=False)
    speed = measure(recording, frames, lambda text: messages.print(text, highlight=False))
    if json_output:
        print(json.dumps(asdict(speed), indent=2))
    else:
        print_speed(speed, Console(markup=False))


def print_speed(speed: Speed, console: Console) -> None:
    """The times of the stages, then the ratios beside what they must keep."""
    stages = Table(title=f"{speed.details['recording']}, {speed.details['image']}: median times")
    stages.add_column("stage")
    stages.add_column("ms", justify="right")
    for name, value in speed.stages_ms.items():
        stages.add_row(name, f"{value:.2f}")
    console.print(stages)
    ratios = Table(title="ours / OpenCV, same frames, same run")
    for column in ("ratio", "value", "at most"):
        ratios.add_column(column, justify="left" if column == "ratio" else "right")
    for name, value in speed.ratios.items():
        ratios.add_row(name.replace("_", " "), f"{value:.3f}", f"{LIMITS[name]:g}" if name in LIMITS else "-")
    console.print(ratios)
    for name, detail in speed.details.items():
        if isinstance(detail, float):
            console.print(f"{name.replace('_', ' ')}: {detail:g}", highlight=False)
