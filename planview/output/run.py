"""An engine run over a recording, results written to a folder."""

from __future__ import annotations

import json
import logging
import math
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from calib.errors import WorkError
from planview.counting.events import Event
from planview.counting.totals import Counts
from planview.engine.engine import Engine, FrameResult
from planview.offline.refine import refine
from planview.output import resume
from planview.output.finished import refine_held_run
from planview.output.folder import (
    RunInfo,
    SkippedFrame,
    finished_run,
    folder_lock,
    prepare_folder,
    write_result,
    write_run_info,
)
from planview.output.report.page import write_report
from planview.output.run_folder import RunFolder
from planview.output.run_spec import RunSpec
from planview.output.run_state import RunChecks, RunTotals
from planview.output.tables import MapsLog, RunTables, refuse_unrecorded
from planview.output.viewer import LiveViewer
from planview.progress import Progress, unseen
from planview.tracking.base import notes_of
from planview.trajectories.clock import Span
from planview.trajectories.table import Trajectories, TrajectoryCollector, is_person
from stereo.recording import Skipped

log = logging.getLogger(__name__)
Watch = Callable[[FrameResult], object]


class RunLog(Protocol):
    """Takes every frame of a run."""

    def frame(self, result: FrameResult) -> None: ...

    def mark(self) -> dict[str, int]:
        """Bring all frames so far to the disk; the position to resume from after a kill."""

    def close(self) -> None:
        """All frames are complete on the disk, whether the run finished or not; it may be resumed."""


@contextmanager
def interrupt_event() -> Iterator[threading.Event]:
    """Set an event at the first SIGINT, SIGTERM or SIGHUP until the block ends, so that a run stops where that loses
    nothing; the second raises KeyboardInterrupt. Signals that are ignored (``nohup``) stay ignored, and outside of the
    main thread Python takes none."""
    interrupted = threading.Event()
    handlers = {}

    def note(*_: object) -> None:
        if interrupted.is_set():
            raise KeyboardInterrupt
        interrupted.set()

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                handlers[number] = signal.signal(number, note)
    try:
        yield interrupted
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def track(
    engine: Engine,
    spec: RunSpec,
    watch: Watch | None = None,
    progress: Progress = unseen,
    viewer: LiveViewer | None = None,
) -> Trajectories:
    """The tracks of a recording, written to the folder of a run that has one (errors of ``run``).

    Args:
        watch: called after every frame.
        progress: called after every frame, too.
        viewer: shows every frame.
    """
    total = spec.n_frames(engine.recording.n_frames)
    log.debug("tracking")
    with ExitStack() as stack:
        watches: list[Watch] = [lambda result: progress(result.frame + 1 - spec.first_frame, total)]
        if watch is not None:
            watches.append(watch)
        if viewer is not None:
            watches.append(stack.enter_context(viewer.showing(engine)))
        if spec.out is None:
            return _track_in_memory(engine, spec, watches)
        run(engine, spec, watches)
        return RunFolder(spec.out).tracks


def _track_in_memory(engine: Engine, spec: RunSpec, watches: Sequence[Watch]) -> Trajectories:
    rows = TrajectoryCollector()
    n_read = 0
    engine.reset()
    for result in engine.after(spec.first_frame - 1, spec.last_frame):
        rows.add(result.frame, result.timestamp_s, result.tracks)
        n_read += 1
        for watch in watches:
            watch(result)
    tracks = rows.trajectories()
    if spec.refine:
        tracks = refine(tracks).tracks
    n_frames = spec.first_frame + n_read + len(_skipped_frames(engine, spec))
    return replace(tracks, first_frame=spec.first_frame, n_frames=n_frames)


def run(engine: Engine, spec: RunSpec, watches: Sequence[Watch] = ()) -> RunInfo:
    """Track a recording into the folder of a run, which is held meanwhile (``folder_lock``).

    When the run is interrupted or fails, ``run.json`` has ``finished: false`` and every file is valid up to the last
    finished frame.

    Args:
        engine: from ``open_engine``, or composed by hand.
        watches: called after every frame, e.g. to show progress.
    Raises:
        InputError: another call holds the folder, or it holds another run than the one to resume; or the recording
            fails a check (``strict``), and what was tracked until then is kept.
        WorkError: the disk is full, or no frame can be used.
        KeyboardInterrupt: Ctrl-C, SIGTERM or SIGHUP came; raised after the frame under way, with all files closed.
    """
    folder = spec.folder
    if spec.maps:
        refuse_unrecorded(engine)
    job = _Run(engine, spec)  # whatever refuses the run comes before the folder is touched
    with folder_lock(folder):
        if spec.resume and finished_run(folder) is not None:
            resume.refuse_another_run(folder, resume.known_identity(spec.info(engine)))
            return _complete(spec)
        checkpoint = job.begin()
        try:
            job.track(watches, checkpoint)
        except BaseException:
            job.end(finished=False)
            raise
        info = job.end(finished=True)
        if spec.report:
            write_report(folder)
        if note := job.far_rule_note():
            warnings.warn(note, stacklevel=2)
        return refine_held_run(folder)[1] if spec.refine else info


def _complete(spec: RunSpec) -> RunInfo:
    """Do what a kill after the last frame left undone, the page last."""
    folder = spec.folder
    info = RunFolder(folder).info
    resume.remove_checkpoint(folder)
    if (folder / "report.html").is_file() and (info.refined or not spec.refine):
        log.info("%s: the run is finished; nothing is left to resume", folder)
    elif info.refined or spec.refine:
        return refine_held_run(folder)[1]
    else:
        write_report(folder)
    return info


class _Run:
    """A run under way: what it has counted and seen, and what it writes."""

    def __init__(self, engine: Engine, spec: RunSpec) -> None:
        self._engine = engine
        self._spec = spec
        self._folder = spec.folder
        self._analytics = spec.analytics(engine)
        self._logs: dict[str, RunLog] = {}
        self._totals = RunTotals()
        self._started_s = time.monotonic()
        self._checks = RunChecks(engine, spec.strict)
        self._carried: dict[str, Any] = {"engine": engine, "totals": self._totals, "checks": self._checks}
        if self._analytics is not None:
            self._carried["analytics"] = self._analytics
        self._info = spec.info(engine)
        self._identity: dict[str, Any] | None = None
        cannot_resume = engine.recording.is_live or engine.tracker_name == "detections"
        self._mark_every_s = 0.0 if cannot_resume else spec.checkpoint_every_s
        self._marked_s = time.monotonic()

    def begin(self) -> resume.Checkpoint | None:
        """Make room for the results, with a run.json before anything else; or the checkpoint to resume from."""
        spec = self._spec
        if spec.resume:
            checkpoint = resume.checkpoint_of(self._folder, spec.identity(self._engine))
            if checkpoint is not None:
                return checkpoint
        prepare_folder(self._folder, spec.overwrite or spec.resume, self._engine.recording.path)
        write_run_info(self._information("running"), self._folder / "run.json")
        return None

    def track(self, watches: Sequence[Watch], checkpoint: resume.Checkpoint | None) -> None:
        """Track what is left of the recording; all files are closed at the end, whatever happens."""
        recording = self._engine.recording
        with ExitStack() as stack:
            interrupted = stack.enter_context(interrupt_event())
            tables = self._open(stack, checkpoint)
            done = max(self._totals.last_frame, self._spec.first_frame - 1)
            for result in self._engine.after(done, self._spec.last_frame):
                self._take(result, tables)
                for watch in watches:
                    watch(result)
                self._mark_when_due(tables, interrupted.is_set())
                if interrupted.is_set() and recording.is_live:
                    break  # the usual end of cameras that run
                if interrupted.is_set():
                    raise KeyboardInterrupt
        if self._totals.frames == 0:
            why = f" ({recording.skipped[0].why})" if recording.skipped else ""
            raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used{why}")
        self._checks.refuse()

    def _open(self, stack: ExitStack, checkpoint: resume.Checkpoint | None) -> RunTables:
        """Begin or resume everything; the stack closes the tables, which are returned, and the logs."""
        spec = self._spec
        written: dict[str, Any] = {"logs": {}, "tables": None}
        if checkpoint is not None:
            written = checkpoint.written
            write_run_info(self._information("running"), self._folder / "run.json")
        if spec.maps:
            maps = self._folder / "maps.h5"
            self._logs["MapsLog"] = MapsLog(self._engine, maps, written["logs"].get("MapsLog"))
            stack.callback(self._logs["MapsLog"].close)
        if spec.rrd_every:
            from planview.output.rerun_log import RerunLog  # rerun takes a second, and few runs write for it

            rrd = self._folder / "run.rrd"
            self._logs["RerunLog"] = RerunLog(self._engine, rrd, spec.rrd_every, resumed=checkpoint is not None)
            stack.callback(self._logs["RerunLog"].close)
        tables = RunTables(self._folder, self._analytics is not None, written["tables"])
        stack.callback(tables.close)
        for name, part in self._carried.items():
            part.reset()
            if checkpoint is not None:
                part.set_state(checkpoint.state[name])
        return tables

    def _take(self, result: FrameResult, tables: RunTables) -> None:
        """Count a frame, and write what is known of it."""
        self._totals.take(result)
        events: Sequence[Event] = ()
        if self._analytics is not None:
            events = self._analytics.update(result.frame, result.timestamp_s, result.tracks)
            self._totals.events.extend(events)
        tables.add(result, events)
        for log in self._logs.values():
            log.frame(result)
        self._checks.update(result)

    def _mark_when_due(self, tables: RunTables, is_interrupted: bool) -> None:
        """Write a checkpoint after some time, or before the run ends early."""
        now_s = time.monotonic()
        if self._mark_every_s and (is_interrupted or now_s - self._marked_s >= self._mark_every_s):
            self._marked_s = now_s
            if not self._mark(tables):
                self._mark_every_s = 0.0

    def _mark(self, tables: RunTables) -> bool:
        """Write all that a checkpoint refers to, the checkpoint, then run.json; False where the engine has parts that
        cannot be identified, or hold what a checkpoint cannot."""
        self._totals.elapsed_s = self._elapsed_s()
        self._started_s = time.monotonic()
        try:
            self._identity = self._identity or self._spec.identity(self._engine)
            state = {name: part.state() for name, part in self._carried.items()}
        except (resume.UnidentifiedError, TypeError) as error:
            warnings.warn(f"this run writes no checkpoints: {error}", stacklevel=2)
            return False
        written = {"tables": tables.mark(), "logs": {name: log.mark() for name, log in self._logs.items()}}
        resume.write_checkpoint(self._folder, resume.Checkpoint(self._identity, written, state))
        write_run_info(self._information("running"), self._folder / "run.json")
        return True

    def _elapsed_s(self) -> float:
        return self._totals.elapsed_s + time.monotonic() - self._started_s

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
            resume.remove_checkpoint(self._folder)
        return info

    def far_rule_note(self) -> str:
        """A sentence on rules where nobody was; empty without any."""
        return "" if self._analytics is None else self._analytics.rules.far_rule_note(RunFolder(self._folder).tracks)

    def _information(self, state: str) -> RunInfo:
        """run.json as it is now."""
        totals = self._totals
        recording = self._engine.recording
        skipped = _skipped_frames(self._engine, self._spec)
        frame_s = 1 / recording.fps
        confirmed_s = frame_s * np.array(list(totals.people.values()), dtype=np.float64)
        people = int(is_person(confirmed_s).sum())
        changes: dict[str, Any] = {
            "state": state,
            "finished": state == "finished",
            "elapsed_s": self._elapsed_s(),
            "frames_read": totals.frames,
            "frames_skipped": len(skipped),
            "skipped": [SkippedFrame(index=frame.index, why=frame.why) for frame in skipped[:SKIPPED_SHOWN]],
            "notes": [*self._info.notes, *notes_of(self._engine.tracker)],
            "stages_ms": {stage: float(np.median(list(times))) for stage, times in totals.stages.items()},
            "people": people,
            "remark": totals.remark(people),
            "warnings": self._checks.warnings(),
        }
        span = Span(totals.first_s, totals.last_s + frame_s, frame_s)
        if totals.frames:
            changes |= {"start_s": span.start_s, "end_s": span.end_s}
        if self._analytics is not None and state != "running":
            changes["counts"] = Counts.of(self._analytics, totals.events, span).to_json()
        return self._info.model_copy(update=changes)


SKIPPED_SHOWN = 1000
"""Skipped frames that run.json names at most, so that it stays small."""


def _skipped_frames(engine: Engine, spec: RunSpec) -> list[Skipped]:
    """Frames to track that could not be used so far."""
    end = math.inf if spec.last_frame is None else spec.last_frame
    return [frame for frame in engine.recording.skipped if spec.first_frame <= frame.index <= end]
