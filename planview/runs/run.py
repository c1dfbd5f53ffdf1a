"""``planview run``: an engine over a recording, results to a folder."""

from __future__ import annotations

import csv
import json
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO

import numpy as np

from calib.errors import WorkError
from planview.analytics.clock import Span
from planview.analytics.events import Event, write_event_header, write_event_rows
from planview.analytics.stream import Analytics
from planview.analytics.totals import Counts
from planview.pipeline.engine import Engine, FrameResult
from planview.runs.folder import FrameFile
from planview.runs.info import RunInfo, SkippedFrame, write_result, write_run_info
from planview.runs.interrupts import Interrupts
from planview.runs.lock import folder_lock
from planview.runs.log import RunLog
from planview.tracking.base import Decision
from planview.trajectories.table import write_header, write_rows

LIBRARIES = ("planview", "numpy", "opencv-python-headless", "scipy", "open3d", "numba")
DECISION_COLUMNS = ("frame", "timestamp_s", "id", "kind", "reason", "value")
SKIPPED_MAX = 1000
"""run.json names at most so many skipped frames."""


@dataclass
class RunOptions:
    """What a run writes besides tracks.

    Attributes:
        tracker: name for run.json.
        analytics: counts while running; None for no rules.
        debug: write ``decisions.csv``, every decision of the tracker with its reason.
        max_frames: stop after so many frames; 0 for all.
    """

    tracker: str = "template"
    analytics: Analytics | None = None
    debug: bool = False
    max_frames: int = 0


@dataclass
class _Progress:
    """What a run has counted so far."""

    frames: int = 0
    tracks: int = 0
    people: set[int] = field(default_factory=set)
    stages: dict[str, list[float]] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    first_s: float = 0.0
    last_s: float = 0.0

    def take(self, result: FrameResult) -> None:
        if self.frames == 0:
            self.first_s = result.timestamp_s
        self.frames += 1
        self.last_s = result.timestamp_s
        self.tracks += len(result.tracks)
        self.people |= {track.track_id for track in result.tracks if track.state == "confirmed"}
        for stage, duration in result.stages_ms.items():
            self.stages.setdefault(stage, []).append(duration)

    def remark(self) -> str:
        """Why nobody was found; empty when somebody was."""
        if self.people or not self.frames:
            return ""
        if not self.tracks:
            return f"nothing of a person's size moved in {self.frames} frames"
        return "what moved was too short or too small to be believed (--rrd and --debug show why)"


def run(
    engine: Engine,
    folder: Path,
    options: RunOptions | None = None,
    logs: Sequence[RunLog] = (),
    watch: Callable[[FrameResult], None] | None = None,
) -> RunInfo:
    """Track a recording and write the output folder.

    The folder must exist (``planview.runs.folder.prepare_folder``). When the run is interrupted or fails, ``run.json``
    says ``finished: false`` and every file is valid up to the last finished frame.

    Args:
        engine: from ``open_engine``, or composed by hand.
        logs: take every frame; closed at the end, whatever happens.
        watch: called after every frame, e.g. to show progress.
    Raises:
        InputError: another process writes into the folder.
        WorkError: the disk is full, or no frame can be used.
        KeyboardInterrupt: Ctrl-C, SIGTERM or SIGHUP came; raised after the frame under way, with all files closed.
    """
    options = options or RunOptions()
    info, started, progress = _start(engine, options), time.monotonic(), _Progress()
    finished = False
    try:
        with ExitStack() as stack:
            for log in logs:
                stack.callback(log.close)
            stack.enter_context(folder_lock(folder))
            interrupts = stack.enter_context(Interrupts())
            write_run_info(info, folder / "run.json")
            files = stack.enter_context(closing(_Files(folder, options)))
            for result in _limited(engine, options.max_frames):
                progress.take(result)
                files.add(result, progress)
                for log in logs:
                    log.frame(result)
                if watch:
                    watch(result)
                if interrupts.noted and getattr(engine.recording, "is_live", False):
                    break  # the usual end of cameras that run
                interrupts.check()
        _refuse_empty(engine, progress)
        finished = True
    finally:
        info = _finish(info, engine, progress, options, time.monotonic() - started, finished)
        _write_end(info, folder)
    return info


def _refuse_empty(engine: Engine, progress: _Progress) -> None:
    if progress.frames == 0:
        skipped = engine.recording.skipped
        why = f" ({skipped[0].why})" if skipped else ""
        raise WorkError(f"{engine.recording.path}: none of {engine.recording.n_frames} frames can be used{why}")


def _write_end(info: RunInfo, folder: Path) -> None:
    """A run that failed may have no room for its last words either: run.json then stays as it was, unfinished."""
    try:
        if info.counts:
            write_result(folder / "counts.json", json.dumps(info.counts, indent=2) + "\n")
        write_run_info(info, folder / "run.json")
    except WorkError:
        if info.finished:
            raise


class _Files:
    """tracks.csv, and events.csv and decisions.csv where asked for."""

    def __init__(self, folder: Path, options: RunOptions) -> None:
        self._analytics = options.analytics
        self._tracks = FrameFile(folder / "tracks.csv", write_header)
        self._events = FrameFile(folder / "events.csv", write_event_header) if options.analytics else None
        self._decisions = FrameFile(folder / "decisions.csv", _decision_header) if options.debug else None

    def add(self, result: FrameResult, progress: _Progress) -> None:
        frame, moment = result.frame, result.timestamp_s
        self._tracks.add(lambda file: write_rows(file, frame, moment, result.tracks))
        if self._analytics and self._events:
            events = self._analytics.update(frame, moment, result.tracks)
            progress.events.extend(events)
            self._events.add(lambda file: write_event_rows(file, events))
        if self._decisions:
            self._decisions.add(lambda file: _decision_rows(file, frame, moment, result.decisions))

    def close(self) -> None:
        for file in (self._tracks, self._events, self._decisions):
            if file:
                file.close()


def _limited(engine: Engine, max_frames: int) -> Iterator[FrameResult]:
    for n, result in enumerate(engine, 1):
        yield result
        if n == max_frames:
            break


def _start(engine: Engine, options: RunOptions) -> RunInfo:
    return RunInfo(
        input=os.fspath(engine.recording.path),
        tracker=options.tracker,
        state="running",
        started_at=datetime.now(UTC).astimezone().isoformat(timespec="seconds"),
        versions={"python": platform.python_version(), **_versions()},
        config=engine.config.model_dump(mode="json"),
        rig=engine.camera_info(),
        floor=engine.floor_info(),
        notes=list(getattr(engine.recording, "notes", ())),
    )


def _versions() -> dict[str, str]:
    """Of what is installed: OpenCV comes under several names."""
    found = {}
    for name in LIBRARIES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _finish(
    info: RunInfo, engine: Engine, progress: _Progress, options: RunOptions, elapsed_s: float, finished: bool
) -> RunInfo:
    skipped = engine.recording.skipped
    return info.model_copy(
        update={
            "state": "finished" if finished else "interrupted",
            "finished": finished,
            "elapsed_s": elapsed_s,
            "frames_read": progress.frames,
            "frames_skipped": len(skipped),
            "skipped": [SkippedFrame(index=s.index, why=s.why) for s in skipped[:SKIPPED_MAX]],
            "stages_ms": {stage: float(np.median(times)) for stage, times in progress.stages.items()},
            "people": len(progress.people),
            "remark": progress.remark(),
            "counts": _counts(progress, options, engine.recording.fps),
        }
    )


def _counts(progress: _Progress, options: RunOptions, fps: float) -> dict[str, object]:
    analytics = options.analytics
    if analytics is None:
        return {}
    span = Span(progress.first_s, progress.last_s + 1 / fps, 1 / fps)
    stays = {name: sorted(stays, key=lambda s: s.start_s) for name, stays in analytics.stays.items()}
    events = sorted(progress.events, key=lambda e: e.timestamp_s)
    return Counts(analytics.rules, events, stays, span, analytics.params.interval_s).to_json()


def _decision_header(file: IO[str]) -> None:
    csv.writer(file, lineterminator="\n").writerow(DECISION_COLUMNS)


def _decision_rows(file: IO[str], frame: int, timestamp_s: float, decisions: tuple[Decision, ...]) -> None:
    csv.writer(file, lineterminator="\n").writerows(
        (frame, f"{timestamp_s:.4f}", d.track_id, d.kind, d.reason, "" if np.isnan(d.value) else f"{d.value:.4f}")
        for d in decisions
    )
