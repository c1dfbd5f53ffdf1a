"""``planview bench memory``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from calib.errors import InputError
from planview.bench.commands.options import JsonFlag
from planview.bench.memory import EVERY, WARM, measure


def bench_memory(
    *,
    recording: Path | None = None,
    frames: int = 2000,
    json_output: JsonFlag = False,
) -> None:
    """Watch the memory of a long run.

    Example: planview bench memory --frames 2000

    Example of an hour at 15 frames per second: planview bench memory --recording out/maps.h5 --frames 54000

    Parameters
    ----------
    recording
        A stereo recording, begun again as often as needed (the committed clip by default), or plan-view maps, tracked
        as one run whose frames and times go on.
    frames
        How many frames to track.
    json_output
        Print one JSON object.
    """
    if frames < WARM + 3 * EVERY:
        raise InputError(f"--frames: expected at least {WARM + 3 * EVERY}, found {frames}")
    messages = Console(stderr=True, markup=False)
    memory = measure(recording, frames, lambda text: messages.print(text, highlight=False))
    if json_output:
        print(json.dumps(asdict(memory), indent=2))
        return
    flat = "flat" if memory.slope_kb_per_frame <= memory.limit_kb_per_frame else "growing"
    Console(markup=False).print(
        f"{memory.frames} frames: {memory.start_mb:g} MB after {WARM}, {memory.end_mb:g} MB at the end, "
        f"{memory.slope_kb_per_frame:+.2f} kB per frame (at most {memory.limit_kb_per_frame:g}): {flat}",
        highlight=False,
        soft_wrap=True,
    )
