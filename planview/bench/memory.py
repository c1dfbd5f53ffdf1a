"""Whether a long run keeps its memory."""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from planview.bench.clip import Clip

EVERY = 20
"""Frames between two readings."""
WARM = 200
"""Frames before memory counts: kernels, buffers and thread pools come into being."""
LIMIT_KB_PER_FRAME = 5.0
"""Flat: 10 MB in 2,000 frames, the jitter of the allocator."""


@dataclass(frozen=True)
class Memory:
    """Figures of ``planview bench memory``.

    Attributes:
        frames: how many were tracked.
        start_mb, end_mb: resident memory after WARM frames and at the end [MB].
        slope_kb_per_frame: of the line through all readings after WARM [kB].
        limit_kb_per_frame: what counts as flat.
    """

    frames: int
    start_mb: float
    end_mb: float
    slope_kb_per_frame: float
    limit_kb_per_frame: float = LIMIT_KB_PER_FRAME


def measure(recording: Path | None, n_frames: int, progress: Callable[[str], None] = lambda _: None) -> Memory:
    """Track n_frames, starting the recording again when it ends, and watch the resident memory.

    Raises:
        InputError: no such recording.
    """
    clip = Clip(recording, 2)
    engine = clip.looped()
    readings: list[tuple[int, float]] = []
    for i, _ in enumerate(islice(engine, n_frames)):
        if i >= WARM and i % EVERY == 0:
            readings.append((i, resident_mb()))
        if i % 500 == 0:
            progress(f"frame {i}: {resident_mb():.0f} MB")
    engine.close()
    frames, megabytes = np.array(readings).T
    slope = float(np.polyfit(frames, megabytes, 1)[0]) * 1e3
    return Memory(n_frames, round(megabytes[0], 1), round(megabytes[-1], 1), round(slope, 3))


def resident_mb() -> float:
    """Resident memory of this process [MB]; its peak where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1e6 if sys.platform == "darwin" else 1e3)
    return pages * resource.getpagesize() / 1e6
