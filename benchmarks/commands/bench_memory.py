"""``python -m benchmarks memory``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from benchmarks.commands.options import Flag, JsonFlag
from benchmarks.memory import EVERY, WARM, measure
from calib.errors import InputError


def bench_memory(
    *,
    recording: Path | None = None,
    frames: int = 6000,
    rrd: Flag = False,
    json_output: JsonFlag = False,
) -> None:
    """Watch the memory of a long run.

    Images are reduced to 320 px; the run writes tracks, decisions and checkpoints to a temporary folder.

    Example: python -m benchmarks memory

    Example of an hour at 15 frames per second: python -m benchmarks memory --frames 54000

    Parameters
    ----------
    recording
        A stereo recording (the committed clip by default) or plan-view maps, begun again as often as needed, and
        tracked as one run whose frames and times go on.
    frames
        How many frames to track; the fewer, the less sure the growth is.
    rrd
        Write run.rrd too.
    json_output
        Print one JSON object.
    """
    if frames < WARM + 3 * EVERY:
        raise InputError(f"--frames: expected at least {WARM + 3 * EVERY}, found {frames}")
    messages = Console(stderr=True, markup=False)
    memory = measure(recording, frames, rrd, lambda text: messages.print(text, highlight=False))
    if json_output:
        print(json.dumps(asdict(memory), indent=2))
        return
    flat = "flat" if memory.growth_percent <= memory.limit_percent else "growing"
    written = "" if memory.rrd_kb_per_frame is None else f"; run.rrd {memory.rrd_kb_per_frame:g} kB per frame"
    Console(markup=False).print(
        f"{memory.frames} frames: {memory.start_mb:g} MB after {WARM}, {memory.end_mb:g} MB at the end, "
        f"{memory.slope_kb_per_frame:+.3f} kB per frame, {memory.growth_percent:+.2f} % in an hour at 15 Hz "
        f"(at most {memory.limit_percent:g} %): {flat}{written}",
        highlight=False,
        soft_wrap=True,
    )
