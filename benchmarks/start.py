"""Time from typing ``planview run`` to the first frame's tracks, in units of 100 frames of the yardstick."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.side_by_side import seconds
from benchmarks.yardstick import Yardstick
from calib.errors import WorkError
from calib.types import F64
from stereo.recording import Recording, StereoFrame

UNIT = 100
"""Frames of the yardstick in a unit."""
STARTS = 5
"""Starts of each kind; medians count."""
TIMED = 12
"""Frames of the yardstick between two starts."""
Kind = Literal["first", "second"]
_CHILD = """
import os, sys, time
from planview.cli import main
from planview.output import progress
def told(self, result):
    print(time.monotonic(), flush=True)
    os._exit(0)
progress.FrameProgress.__call__ = told
main(sys.argv[1:])
"""
"""``planview run`` as a process of its own, which tells when the first frame is tracked."""


def start_to_first_frame(recording: Recording, frames: Sequence[StereoFrame]) -> dict[Kind, F64]:
    """Starts of ``planview run`` over 100 frames of the yardstick in colour on all cores, in turns.

    The first run on a recording finds row offset and floor; the second one takes what the first kept. Kernels are
    compiled and files in the system's cache before.

    Args:
        frames: of the recording, decoded, for the yardstick.
    Returns:
        by kind (STARTS,) float64.
    Raises:
        WorkError: the command fails.
    """
    yardstick = Yardstick(recording.rig, grey=False)
    ratios: dict[Kind, list[float]] = {"first": [], "second": []}
    with tempfile.TemporaryDirectory(prefix="planview-start-") as folder:
        _started_s(recording.path, Path(folder), "first")
        for _ in range(STARTS):
            for kind, measured in ratios.items():
                spent = _started_s(recording.path, Path(folder), kind)
                theirs = [seconds(yardstick, frame.left, frame.right) for frame in frames[:TIMED]]
                measured.append(spent / (UNIT * float(np.median(theirs))))
    return {kind: np.array(measured) for kind, measured in ratios.items()}


def _started_s(recording: Path, folder: Path, kind: Kind) -> float:
    """Seconds from the start of the process to its first frame."""
    if kind == "first":
        for kept in (folder / "planview" / "setups").glob("*.json"):
            kept.unlink()
    environment = os.environ | {"XDG_CACHE_HOME": str(folder)}
    words = ["run", str(recording), "--out", tempfile.mkdtemp(dir=folder), "--frames", "1"]
    began = time.monotonic()
    child = subprocess.run(
        [sys.executable, "-c", _CHILD, *words], capture_output=True, text=True, env=environment, check=False
    )
    if child.returncode != 0 or not child.stdout:
        raise WorkError(f"{recording}: expected planview run to track a frame, found: {child.stderr.strip()[-300:]}")
    return float(child.stdout.split()[0]) - began
