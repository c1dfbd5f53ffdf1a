"""Whether a long run keeps its memory."""

from __future__ import annotations

import resource
import sys
import tempfile
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, islice
from pathlib import Path

import numpy as np

from benchmarks.clip import Clip
from benchmarks.looped import LoopedRecording
from planview.engine.engine import FrameResult
from planview.engine.factory import floor_tracker
from planview.engine.maps_pipeline import MapsPipeline, recorded_config
from planview.engine.pipeline import Pipeline
from planview.engine.setup import set_up
from planview.maps.recording import MapsRecording, is_maps
from planview.output.run import RunLog, RunOptions, run
from planview.output.totals import RunTotals

EVERY = 20
"""Frames between two readings."""
WARM = 1000
"""Frames before memory counts: kernels, buffers, arenas of the allocator and thread pools come into being."""
HOUR = 54_000
"""Frames of an hour at 15 Hz."""
LIMIT_PERCENT = 1.0
"""Growth in an hour that counts as flat."""
COURSE = 60
"""Readings kept for a plot."""
WIDTH_PX = 320
"""Width of the images (Harville 2002, section 5, ran at 320x240): an hour's frames are tracked in a quarter of it."""


@dataclass(frozen=True)
class Memory:
    """Figures of ``python -m benchmarks memory``.

    Attributes:
        frames: how many were tracked.
        start_mb, end_mb: resident memory after WARM frames and at the end, medians of a tenth of the readings [MB].
        slope_kb_per_frame: of the line through all readings after WARM [kB].
        growth_percent: by that line, in an hour at 15 Hz.
        course: frames and megabytes, some COURSE of the readings.
        rrd_kb_per_frame: size of ``run.rrd`` per frame; None where none was written.
        limit_percent: growth that counts as flat.
    """

    frames: int
    start_mb: float
    end_mb: float
    slope_kb_per_frame: float
    growth_percent: float
    course: tuple[tuple[int, float], ...] = ()
    rrd_kb_per_frame: float | None = None
    limit_percent: float = LIMIT_PERCENT


@dataclass
class _Watch:
    """Reads the memory while frames come."""

    n_frames: int
    progress: Callable[[str], None]
    readings: list[tuple[int, float]] = field(default_factory=list)
    frames: int = 0

    def __call__(self, result: FrameResult) -> None:
        if self.frames >= WARM and self.frames % EVERY == 0:
            self.readings.append((self.frames, resident_mb()))
        if self.frames % max(500, self.n_frames // 20) == 0:
            self.progress(f"frame {self.frames}: {resident_mb():.1f} MB")
        self.frames += 1


def measure(
    recording: Path | None, n_frames: int, rrd: bool = False, progress: Callable[[str], None] = lambda _: None
) -> Memory:
    """Run over n_frames with all that a run writes, and watch the resident memory.

    A recording of images is read again when it ends, as one long recording whose frames and times go on. Of plan-view
    maps nothing is written.

    Args:
        rrd: write ``run.rrd`` too.
        progress: told how it stands.
    Raises:
        InputError: no such recording.
    """
    watch, written = _Watch(n_frames, progress), None
    if recording is not None and is_maps(recording):
        totals, results = RunTotals(), _endless_maps(recording)
        for result in islice(results, n_frames):
            totals.take(result)
            watch(result)
        results.close()
    else:
        engine = _looped(recording, n_frames)
        with tempfile.TemporaryDirectory(prefix="planview-memory-") as folder:
            logs = _logs(engine, Path(folder)) if rrd else []
            run(engine, Path(folder), RunOptions(debug=True, checkpoint_every_s=30.0), logs, watch)
            written = sum(path.stat().st_size for path in Path(folder).glob("*.rrd")) / 1e3 / n_frames if rrd else None
    return _figures(watch, written)


def _looped(recording: Path | None, n_frames: int) -> Pipeline:
    clip = Clip(recording, 2, WIDTH_PX)
    looped = LoopedRecording(clip.recording, n_frames, WIDTH_PX, clip.setup.floor.world_SE3_left)
    return Pipeline(looped, set_up(looped, clip.config), clip.config)


def _logs(engine: Pipeline, folder: Path) -> Sequence[RunLog]:
    from planview.output.rerun.log import RerunLog

    return [RerunLog(engine, folder / "run.rrd")]


def _figures(watch: _Watch, written: float | None) -> Memory:
    frames, megabytes = np.array(watch.readings).T
    slope = float(np.polyfit(frames, megabytes, 1)[0]) * 1e3
    tenth = max(1, len(megabytes) // 10)
    start, end = float(np.median(megabytes[:tenth])), float(np.median(megabytes[-tenth:]))
    growth = 100.0 * slope * 1e-3 * HOUR / start
    course = tuple((n, round(mb, 1)) for n, mb in watch.readings[:: -(-len(frames) // COURSE)])
    rrd = None if written is None else round(written, 1)
    return Memory(watch.frames, round(start, 1), round(end, 1), round(slope, 3), round(growth, 2), course, rrd)


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
