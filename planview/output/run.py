"""An engine run over a recording, results written to a folder."""

from __future__ import annotations

import json
import math
import os
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from calib.carried import Carried
from calib.errors import WorkError
from calib.times import PAUSE_S, jump_note
from planview.checks.check import Check
from planview.checks.examine import RecordingWatch, refuse_unless_ok
from planview.checks.sensors import SensorPaths, SensorsWatch
from planview.counting.events import Event
from planview.counting.stream import Analytics
from planview.counting.totals import Counts
from planview.engine.engine import Engine, FrameResult
from planview.output import resume
from planview.output.folder import (
    RunInfo,
    RunWarning,
    SkippedFrame,
    folder_lock,
    prepare_folder,
    write_result,
    write_run_info,
)
from planview.output.tables import RunTables
from planview.tracking.base import notes_of
from planview.trajectories.clock import Span
from planview.trajectories.table import is_person
from stereo.recording import Skipped


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


@dataclass
class RunOptions:
    """Options of a run, besides its engine and its folder."""

    analytics: Analytics | None = None
    """Counts while running; None for no rules."""
    first_frame: int = 0
    """Frame of the recording to begin with, as if it were the first: the background is learned from it on."""
    last_frame: int | None = None
    """Last frame of the recording to track; None for all."""
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
    checkpoint: resume.Checkpoint | None = None,
) -> RunInfo:
    """Track a recording and write the output folder, which is held meanwhile (``folder_lock``): see ``track_into``.

    Raises InputError: another call holds the folder.
    """
    with folder_lock(folder):
        return track_into(engine, folder, options, logs, watch, checkpoint)


def track_into(
    engine: Engine,
    folder: Path,
    options: RunOptions | None = None,
    logs: Sequence[RunLog] = (),
    watch: Callable[[FrameResult], None] | None = None,
    checkpoint: resume.Checkpoint | None = None,
) -> RunInfo:
    """Track a recording into a folder that the caller holds.

    The folder must be empty of results (``prepare_folder``). When the run is interrupted or fails, ``run.json`` has
    ``finished: false`` and every file is valid up to the last finished frame.

    Args:
        engine: from ``open_engine``, or composed by hand.
        logs: take every frame, one of each class; closed at the end, whatever happens.
        watch: called after every frame, e.g. to show progress.
        checkpoint: to resume from (``checkpoint_of``), with logs made for its positions.
    Raises:
        InputError: the recording fails a check (``strict``); what was tracked until then is kept.
        WorkError: the disk is full, or no frame can be used.
        KeyboardInterrupt: Ctrl-C, SIGTERM or SIGHUP came; raised after the frame under way, with all files closed.
    """
    job = _Run(engine, folder, options or RunOptions(), logs)
    try:
        job.track(watch, checkpoint)
    except BaseException:
        job.end(finished=False)
        raise
    return job.end(finished=True)


def begin_run(engine: Engine, folder: Path, options: RunOptions, *, overwrite: bool) -> None:
    """Empty a folder that the caller holds for a run, with a ``run.json`` before anything else is written (errors of
    ``prepare_folder``)."""
    prepare_folder(folder, overwrite, engine.recording.path)
    write_run_info(_info_of(engine, options).model_copy(update={"state": "running"}), folder / "run.json")


TIMES_MAX = 4096
"""Times of a stage that are kept, the last ones: their median is known to 2 %."""


@dataclass
class RunTotals(Carried):
    """Counts of a run so far."""

    RECORDS = (Event,)
    frames: int = 0
    last_frame: int = -1
    tracks: int = 0
    """Rows."""
    people: dict[int, int] = field(default_factory=dict)
    """In how many frames each id was confirmed."""
    stages: dict[str, deque[float]] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    first_s: float = 0.0
    last_s: float = 0.0
    elapsed_s: float = 0.0
    """Time of the run up to its last checkpoint [s]."""
    jump: str = ""
    """The last jump of the clock, in words."""

    def take(self, result: FrameResult) -> None:
        """Count a frame."""
        if self.frames == 0:
            self.first_s = result.timestamp_s
        elif result.timestamp_s - self.last_s > PAUSE_S:
            self.jump = jump_note(self.last_frame, result.frame, result.timestamp_s - self.last_s)
        self.frames += 1
        self.last_frame = result.frame
        self.last_s = result.timestamp_s
        self.tracks += len(result.tracks)
        for track in result.tracks:
            if track.state == "confirmed":
                self.people[track.track_id] = self.people.get(track.track_id, 0) + 1
        for stage, duration in result.stages_ms.items():
            self.stages.setdefault(stage, deque(maxlen=TIMES_MAX)).append(duration)

    def remark(self, people: int) -> str:
        """Sentence on why there are no people, or on a jump of the clock; or nothing."""
        if people or not self.frames:
            return self.jump
        if not self.tracks:
            return f"nothing of a person's size moved in {self.frames} frames"
        return "everything that moved was too short-lived or too small for a person (decisions.csv has the reasons)"


class RunChecks(Carried):
    """Watches a run; ``strict``: raise InputError when a check fails, before the first frame and while tracking."""

    CARRIED = "_watch", "_sensors", "_frames"

    def __init__(self, engine: Engine, strict: bool) -> None:
        self._engine = engine
        self._strict = strict
        self._watch = RecordingWatch(engine.stereo) if engine.rigs else None
        self._sensors = SensorsWatch([SensorPaths(name, rig.camera) for name, rig in engine.rigs.items()])
        self._frames = 0
        self.refuse()

    def update(self, result: FrameResult) -> None:
        """Take a frame, and refuse the recording where that is wanted and a check fails by now."""
        if self._watch is not None:
            confirmed = [person for person in result.tracks if person.state == "confirmed"]
            places = {person.track_id: (person.x_m, person.y_m) for person in confirmed}
            self._watch.update(result.timestamp_s, result.depth, result.views[0].foreground, places)
        if len(self._engine.rigs) > 1:
            self._sensors.update(result.timestamp_s, [view.points for view in result.views])
        self._frames += 1
        if self._frames % 60 == 0:
            self.refuse()

    def refuse(self) -> None:
        """Raise InputError where that is wanted and a check has failed by now."""
        if self._strict:
            refuse_unless_ok(self._all(), str(self._engine.recording.path))

    def warnings(self) -> list[RunWarning]:
        """The checks that failed."""
        warnings = []
        for check in self._all():
            if not check.ok:
                value = check.value if math.isfinite(check.value) else None
                warnings.append(RunWarning(name=check.name, value=value, unit=check.unit, text=check.sentence))
        return warnings

    def _all(self) -> list[Check]:
        watched = [] if self._watch is None else self._watch.checks()
        return [*self._engine.checks, *watched, *self._sensors.checks()]


class _Run:
    """A run under way: what it has counted and seen, and what it writes."""

    def __init__(self, engine: Engine, folder: Path, options: RunOptions, logs: Sequence[RunLog]) -> None:
        self._engine = engine
        self._folder = folder
        self._options = options
        self._logs = {type(log).__name__: log for log in logs}
        self._totals = RunTotals()
        self._started_s = time.monotonic()
        self._checks = RunChecks(engine, options.strict)
        self._carried: dict[str, Any] = {"engine": engine, "totals": self._totals, "checks": self._checks}
        if options.analytics is not None:
            self._carried["analytics"] = options.analytics
        self._info = _info_of(engine, options)
        self._identity: dict[str, Any] | None = None
        self._mark_every_s = 0.0 if engine.recording.is_live else options.checkpoint_every_s
        self._marked_s = time.monotonic()

    def track(self, watch: Callable[[FrameResult], None] | None, checkpoint: resume.Checkpoint | None) -> None:
        """Track what is left of the recording; all files are closed at the end, whatever happens."""
        recording = self._engine.recording
        with ExitStack() as stack:
            interrupted = stack.enter_context(interrupt_event())
            tables = self._open(stack, checkpoint)
            done = max(self._totals.last_frame, self._options.first_frame - 1)
            for result in self._engine.after(done, self._options.last_frame):
                self._take(result, tables)
                if watch:
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
        for log in self._logs.values():
            stack.callback(log.close)
        if checkpoint is not None or not (self._folder / "run.json").is_file():
            write_run_info(self._information("running"), self._folder / "run.json")
        marks = checkpoint and checkpoint.written["tables"]
        tables = RunTables(self._folder, self._options.analytics is not None, marks)
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
        if self._options.analytics is not None:
            events = self._options.analytics.update(result.frame, result.timestamp_s, result.tracks)
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
            self._identity = self._identity or run_identity(self._engine, self._options, list(self._logs))
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

    def _information(self, state: str) -> RunInfo:
        """run.json as it is now."""
        totals = self._totals
        recording = self._engine.recording
        skipped = skipped_between(self._engine, self._options.first_frame, self._options.last_frame)
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
        if self._options.analytics is not None and state != "running":
            changes["counts"] = Counts.of(self._options.analytics, totals.events, span).to_json()
        return self._info.model_copy(update=changes)


SKIPPED_SHOWN = 1000
"""Skipped frames that run.json names at most, so that it stays small."""


def skipped_between(engine: Engine, first: int, last: int | None) -> list[Skipped]:
    """Frames from the first to the last, or to the end, that could not be used so far."""
    end = math.inf if last is None else last
    return [frame for frame in engine.recording.skipped if first <= frame.index <= end]


def run_identity(engine: Engine, options: RunOptions, logs: Sequence[str]) -> dict[str, dict[str, Any]]:
    """All that decides the tracks of a run, as JSON; ``logs``: names of their classes. Raises UnidentifiedError: a part
    or a recording that cannot be told from another one."""
    recording = engine.recording
    resume.refuse_unidentified(engine)
    identity = resume.known_identity(_info_of(engine, options))
    identity["version"] = resume.library_versions() | {"planview": resume.code_version()}
    identity["recording"] |= {
        "images": resume.content_key(recording.path, recording.files),
        "calibration": resume.calibration_key(recording),
        "frames": recording.n_frames,
    }
    identity["settings"] |= {"rules": "", "logs": sorted(logs)}
    if (counts := options.analytics) is not None:
        rules = {"rules": replace(counts.rules, source=""), "params": counts.params}
        identity["settings"]["rules"] = resume.digest_of(rules)
    return identity


def refuse_another_run(engine: Engine, options: RunOptions, folder: Path) -> None:
    """Raise HoldsResultsError where the run in a folder is another one, as far as run.json describes it."""
    resume.refuse_another_run(folder, resume.known_identity(_info_of(engine, options)))


def _info_of(engine: Engine, options: RunOptions) -> RunInfo:
    recording = engine.recording
    path = recording.path
    return RunInfo(
        input=os.fspath(path),
        recording=os.fspath(path.resolve()) if path.exists() else "",
        opened=recording.options.resolved(),
        notes=list(recording.notes),
        size_px=engine.size,
        fps=recording.fps,
        plane="floor" if engine.camera is not None else "image",
        rig=engine.camera_info(),
        floor=engine.floor_info(),
        tracker=engine.tracker_name,
        own_parts={role: resume.part_name(part) for role, part in engine.own_parts.items()},
        first_frame=options.first_frame,
        config=engine.config.model_dump(mode="json"),
        started_at=datetime.now(UTC).astimezone().isoformat(timespec="seconds"),
        versions=resume.library_versions(),
    )
