"""Whether a long run keeps its memory."""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from itertools import count, islice
from pathlib import Path

import numpy as np

from planview.bench.clip import Clip
from planview.maps.recording import MapsRecording, is_maps
from planview.pipeline.engine import FrameResult
from planview.pipeline.factory import floor_tracker
from planview.pipeline.maps_pipeline import MapsPipeline, recorded_config
from planview.runs.totals import RunTotals

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
    """Track n_frames and watch the resident memory, with all that a run counts.

    A recording of images is started again when it ends. Plan-view maps are tracked as one long run: frames and times
    go on when the recording begins again, and the tracker forgets nothing.

    Raises:
        InputError: no such recording.
    """
    results = _endless_maps(recording) if recording is not None and is_maps(recording) else Clip(recording, 2).looped()
    readings: list[tuple[int, float]] = []
    totals = RunTotals()
    for i, result in enumerate(islice(results, n_frames)):
        totals.take(result)
        if i >= WARM and i % EVERY == 0:
            readings.append((i, resident_mb()))
        if i % max(500, n_frames // 20) == 0:
            progress(f"frame {i}: {resident_mb():.1f} MB, {len(totals.people)} people so far")
    results.close()
    frames, megabytes = np.array(readings).T
    slope = float(np.polyfit(frames, megabytes, 1)[0]) * 1e3
    return Memory(n_frames, round(megabytes[0], 1), round(megabytes[-1], 1), round(slope, 3))


def _endless_maps(path: Path) -> Generator[FrameResult, None, None]:
    """The results of a plan-view recording that begins again without an end, as one run."""
    recording = MapsRecording(path)
    config = recorded_config(recording)
    engine = MapsPipeline(recording, floor_tracker("template", config), config)
    engine.reset()
    frames = list(recording)
    span = frames[-1].index + 1
    for turn in count():
        for frame in frames:
            moment = frame.timestamp_s + turn * span / recording.fps
            yield engine.step(replace(frame, index=frame.index + turn * span, timestamp_s=moment))


def resident_mb() -> float:
    """Resident memory of this process [MB]; its peak where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1e6 if sys.platform == "darwin" else 1e3)
    return pages * resource.getpagesize() / 1e6
