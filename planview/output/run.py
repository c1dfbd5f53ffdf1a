"""An engine run over a recording, results written to a folder."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from calib.errors import WorkError
from planview.counting.stream import Analytics
from planview.counting.totals import Counts, Span
from planview.engine.engine import Engine, FrameResult
from planview.output.folder import RunInfo, SkippedFrame, folder_lock, prepare_folder, write_result, write_run_info
from planview.output.resume import (
    Checkpoint,
    calibration_key,
    code_version,
    content_key,
    digest_of,
    library_versions,
    remove_checkpoint,
    write_checkpoint,
)
from planview.output.state import decode, encode
from planview.output.tables import RunTables
from planview.output.totals import RunChecks, RunTotals
from planview.trajectories.table import is_person
from stereo.recording import OpenOptions


class RunLog(Protocol):
    """Takes every frame of a run."""

    def frame(self, result: FrameResult) -> None: ...

    def mark(self) -> dict[str, int]:
        """Bring all frames so far to the disk; the position to resume from after a kill."""

    def close(self) -> None:
        """All frames are complete on the disk, whether the run finished or not; it may be resumed."""


@contextmanager
def noted_interrupts() -> Iterator[threading.Event]:
    """Set an event at the first SIGINT, SIGTERM or SIGHUP until the block ends, so that a run stops where that loses
    nothing; the second raises KeyboardInterrupt. Signals that are ignored (``nohup``) stay ignored, and outside of the
    main thread Python takes none."""
    noted, before = threading.Event(), {}

    def note(*_: object) -> None:
        if noted.is_set():
            raise KeyboardInterrupt
        noted.set()

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, note)
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass
class RunOptions:
    """What a run writes besides tracks."""

    tracker: str = "joint"
    """Name for run.json."""
    analytics: Analytics | None = None
    """Counts while running; None for no rules."""
    first_frame: int = 0
    """Frame of the recording to begin with, as if it were the first: the background is learned from it on."""
    max_frames: int = 0
    """Stop after this many frames; 0 for all."""
    checkpoint_every_s: float = 0.0
    """Time between two checkpoints [s]; 0 for none."""
    strict: bool = False
    """Refuse a recording that fails a check instead of warning."""


def run(
    engine: Engine,
    folder: Path,
    options: RunOptions | None = None,
    logs: Sequence[RunLog] = (),
    watch: Callable[[FrameResult], None] | None = None,
    checkpoint: Checkpoint | None = None,
) -> RunInfo:
    """Track a recording and write the output folder.

    The folder must be empty of results (``prepare_folder``). When the run is interrupted or fails, ``run.json`` has
    ``finished: false`` and every file is valid up to the last finished frame.

    Args:
        engine: from ``open_engine``, or composed by hand.
        logs: take every frame, one of each class; closed at the end, whatever happens.
        watch: called after every frame, e.g. to show progress.
        checkpoint: to resume from (``checkpoint_of``), with logs made for its positions.
    Raises:
        InputError: another process writes into the folder; or the recording fails a check (``strict``), and what was
            tracked until then is kept.
        WorkError: the disk is full, or no frame can be used.
        KeyboardInterrupt: Ctrl-C, SIGTERM or SIGHUP came; raised after the frame under way, with all files closed.
    """
    job = _Run(engine, folder, options or RunOptions(), logs)
    finished = False
    with folder_lock(folder):
        try:
            job.track(watch, checkpoint)
            finished = True
        finally:
            info = job.end(finished)
    return info


def begin_run(engine: Engine, folder: Path, options: RunOptions, *, overwrite: bool) -> None:
    """Make an empty folder for a run, with a ``run.json`` before anything else is written (errors of
    ``prepare_folder``)."""
    prepare_folder(folder, overwrite)
    write_run_info(_info_of(engine, options).model_copy(update={"state": "running"}), folder / "run.json")


class _Run:
    def __init__(self, engine: Engine, folder: Path, options: RunOptions, logs: Sequence[RunLog]) -> None:
        self._engine, self._folder, self._options = engine, folder, options
        self._logs = {type(log).__name__: log for log in logs}
        self._totals, self._started = RunTotals(), time.monotonic()
        self._info = _info_of(engine, options)
        self._identity: dict[str, Any] | None = None
        self._checks = RunChecks(engine, options.strict)

    def track(self, watch: Callable[[FrameResult], None] | None, checkpoint: Checkpoint | None) -> None:
        options = self._options
        with ExitStack() as stack:
            for log in self._logs.values():
                stack.callback(log.close)
            interrupts = stack.enter_context(noted_interrupts())
            frames = self._frames(checkpoint)
            if checkpoint is not None or not (self._folder / "run.json").is_file():
                write_run_info(self._information("running"), self._folder / "run.json")
            marks = checkpoint and checkpoint.written["tables"]
            tables = RunTables(self._folder, options.analytics is not None, marks)
            stack.callback(tables.close)
            is_live = getattr(self._engine.recording, "is_live", False)
            every_s = 0.0 if is_live else options.checkpoint_every_s
            marked_s = time.monotonic()
            for result in frames:
                self._totals.take(result)
                analytics = options.analytics
                events = analytics.update(result.frame, result.timestamp_s, result.tracks) if analytics else ()
                self._totals.events.extend(events)
                tables.add(result, events)
                for log in self._logs.values():
                    log.frame(result)
                if watch:
                    watch(result)
                self._checks.update(result)
                now_s = time.monotonic()
                if every_s and (now_s - marked_s >= every_s or interrupts.is_set()):
                    every_s, marked_s = every_s if self._mark(tables) else 0.0, now_s
                if interrupts.is_set() and is_live:
                    break  # the usual end of cameras that run
                if interrupts.is_set():
                    raise KeyboardInterrupt
        recording = self._engine.recording
        if self._totals.frames == 0:
            why = f" ({recording.skipped[0].why})" if recording.skipped else ""
            raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used{why}")
        self._checks.refuse()

    def _frames(self, checkpoint: Checkpoint | None) -> Iterator[FrameResult]:
        self._engine.reset()
        if checkpoint is not None:
            state = decode(checkpoint.state)
            self._engine.set_state(state["engine"])
            self._totals.set_state(state["totals"])
            if self._options.analytics is not None:
                self._options.analytics.set_state(state["analytics"])
        limit = self._options.max_frames
        if limit and self._totals.frames >= limit:
            return
        for result in self._engine.after(max(self._totals.last_frame, self._options.first_frame - 1)):
            yield result
            if self._totals.frames == limit:
                return

    def _state(self) -> dict[str, object]:
        analytics = self._options.analytics
        counted = {} if analytics is None else {"analytics": analytics.state()}
        return {"engine": self._engine.state(), "totals": self._totals.state(), **counted}

    def _mark(self, tables: RunTables) -> bool:
        """Write all that a checkpoint refers to, the checkpoint, then run.json; False when the engine holds what a
        checkpoint cannot (a tracker from elsewhere)."""
        written = {"tables": tables.mark(), "logs": {name: log.mark() for name, log in self._logs.items()}}
        before_s = self._totals.elapsed_s
        self._totals.elapsed_s = self._elapsed_s()
        try:
            state = encode(self._state())
        except TypeError as error:
            warnings.warn(f"this run writes no checkpoints: {error}", stacklevel=2)
            return False
        finally:
            self._totals.elapsed_s = before_s
        if self._identity is None:
            self._identity = run_identity(self._engine, self._options, list(self._logs))
        write_checkpoint(self._folder, Checkpoint(self._identity, written, state))
        write_run_info(self._information("running"), self._folder / "run.json")
        return True

    def _elapsed_s(self) -> float:
        return self._totals.elapsed_s + time.monotonic() - self._started

    def end(self, finished: bool) -> RunInfo:
        """Write the end; where a run that failed has no room for it, run.json stays as it was, unfinished."""
        info = self._information("finished" if finished else "interrupted")
        try:
            if info.counts:
                write_result(self._folder / "counts.json", json.dumps(info.counts, indent=2) + "\n")
            write_run_info(info, self._folder / "run.json")
        except WorkError:
            if finished:
                raise
        if finished:
            remove_checkpoint(self._folder)
        return info

    def _information(self, state: str) -> RunInfo:
        skipped, totals, analytics = self._engine.recording.skipped, self._totals, self._options.analytics
        frame_s = 1 / self._engine.recording.fps
        span, counts = Span(totals.first_s, totals.last_s + frame_s, frame_s), None
        if analytics is not None and state != "running":
            counts = Counts.of(analytics, totals.events, span)
        people = int(is_person(np.array(list(totals.people.values()), dtype=np.int64), frame_s).sum())
        return self._info.model_copy(
            update={
                "state": state,
                "finished": state == "finished",
                "elapsed_s": self._elapsed_s(),
                "frames_read": totals.frames,
                "start_s": span.start_s if totals.frames else None,
                "end_s": span.end_s if totals.frames else None,
                "notes": [*self._info.notes, *getattr(self._engine.tracker, "notes", ())],
                "frames_skipped": len(skipped),
                # The first thousand, as run.json stays small.
                "skipped": [SkippedFrame(index=s.index, why=s.why) for s in skipped[:1000]],
                "stages_ms": {stage: float(np.median(list(times))) for stage, times in totals.stages.items()},
                "people": people,
                "remark": totals.remark(people),
                "warnings": self._checks.warnings(),
                "counts": counts.to_json() if counts is not None else {},
            }
        )


def run_identity(engine: Engine, options: RunOptions, logs: Sequence[str]) -> dict[str, Any]:
    """All that decides the tracks of a run, as JSON; ``logs``: names of their classes."""
    counts, recording = options.analytics, engine.recording
    rules = counts and {"rules": replace(counts.rules, source=""), "params": counts.params}
    camera, floor = engine.camera_info(), engine.floor_info()
    named = {"calibration": True, "heads": {"__all__": {"calibration"}}}
    right = getattr(recording, "options", OpenOptions()).right
    return {
        "version": library_versions() | {"planview": code_version()},
        "configuration": engine.config.model_dump(mode="json"),
        "recording": {
            "images": [content_key(path, texts=False) for path in (recording.path, right) if path and path.exists()],
            "calibration": calibration_key(recording),
            "frames": recording.n_frames,
            "fps": recording.fps,
            "camera": camera and camera.model_dump(mode="json", exclude=named),  # type: ignore[arg-type]
            "floor": floor and floor.model_dump(mode="json", exclude={"source"}),
        },
        "settings": {
            "tracker": options.tracker, "rules": digest_of(rules) if rules else "", "logs": sorted(logs),
            "first_frame": options.first_frame,
        },
    }  # fmt: skip


def _info_of(engine: Engine, options: RunOptions) -> RunInfo:
    path = engine.recording.path
    return RunInfo(
        input=os.fspath(path),
        recording=os.fspath(path.resolve()) if path.exists() else "",
        opened=getattr(engine.recording, "options", OpenOptions()).resolved(),
        size_px=engine.size,
        fps=engine.recording.fps,
        plane="floor" if engine.camera is not None else "image",
        tracker=options.tracker,
        first_frame=options.first_frame,
        started_at=datetime.now(UTC).astimezone().isoformat(timespec="seconds"),
        versions=library_versions(),
        config=engine.config.model_dump(mode="json"),
        rig=engine.camera_info(),
        floor=engine.floor_info(),
        notes=list(getattr(engine.recording, "notes", ())),
    )
