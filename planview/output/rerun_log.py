"""A run in rerun: a file, or a viewer during the run."""

from __future__ import annotations

import ctypes
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import rerun as rr

from calib.errors import InputError, WorkError
from calib.io import reason, refuse_full_disk, sync
from calib.types import F64
from planview.drawing.plan import bounds_of
from planview.engine.engine import Engine, FrameResult
from planview.output import rerun_shapes as shapes
from planview.output.folder import rrd_parts
from planview.output.report.page import scores_of
from planview.output.rerun_frames import RerunFrames
from planview.output.run_folder import RunFolder
from planview.trajectories.clock import Clock
from planview.trajectories.table import Trajectories

UNKNOWN_HEIGHT_M = 1.7
"""Height at which the head of a true person is drawn whose height is not known."""


def log_assessment(stream: rr.RecordingStream, results: RunFolder) -> None:
    """Log the truth of the recording and the errors against it, where there is one."""
    truth = results.truth
    if truth is not None and len(truth):
        floor = np.full(len(truth), 0.04)
        heads = np.nan_to_num(truth.height_m, nan=UNKNOWN_HEIGHT_M)
        _log_points(stream, "plan/truth", truth, results.clock, floor, 0.06)
        _log_points(stream, "world/truth", truth, results.clock, heads, 0.05)
    scores = scores_of(results)
    for error in () if scores is None else scores.significant:
        stream.set_time("frame", sequence=error.frame)
        stream.set_time("time", duration=float(results.clock.at(np.array([error.frame]))[0]))
        text = f"{error.kind.replace('_', ' ')}: {error.who}: {error.note}"
        stream.log("errors", rr.TextLog(text, level=rr.TextLogLevel.ERROR))


def _log_points(
    stream: rr.RecordingStream, path: str, truth: Trajectories, clock: Clock, z_m: F64, radius_m: float
) -> None:
    """A white point at each true person's place and at a height, a row per frame."""
    frames, counts = np.unique(truth.frame, return_counts=True)
    times = [rr.TimeColumn("frame", sequence=frames), rr.TimeColumn("time", duration=clock.at(frames))]
    places = np.column_stack([truth.x_m, truth.y_m, z_m]).astype(np.float32)
    columns = rr.Points3D.columns(positions=places).partition(counts)
    rr.send_columns(path, times, columns, recording=stream)
    stream.log(path, rr.Points3D.from_fields(colors=[(255, 255, 255)], radii=[radius_m]), static=True)


def _stream(engine: Engine, name: str, flush_s: float) -> rr.RecordingStream:
    """A stream whose files belong to one recording by its name; the viewer keeps a layout per application."""
    return rr.RecordingStream(
        shapes.layout_of(engine).application,
        recording_id=f"planview-{name}",
        batcher_config=rr.ChunkBatcherConfig(flush_tick=flush_s),
    )


class RerunLog:
    """Writes ``run.rrd``.

    Args:
        resumed: the run resumes: rerun cannot continue a file, so another one begins, ``run-2.rrd`` and so on, which
            the viewer shows as one recording.
        every: images, clouds and maps of every n-th frame only; people, decisions and curves of all.
    Raises:
        WorkError: too little free disk space.
    """

    def __init__(self, engine: Engine, path: Path, every: int = 1, *, resumed: bool = False) -> None:
        self._engine = engine
        self._path = path
        if resumed:
            self._path = path.with_name(f"{path.stem}-{len(rrd_parts(path)) + 1}.rrd")
        refuse_full_disk(self._path)
        self._every = every
        self._count = 0
        # Chunks of 10 s or 2 MB: the default is five a second of each path.
        self._stream = _stream(engine, path.parent.name, 10.0)
        self._stream.save(str(self._path))  # with a blueprint it would wait for ever on a disk without room for it
        self._stream.send_blueprint(shapes.blueprint(engine), make_active=False)
        # The first file of a resumed run has the scene.
        self._frames = RerunFrames(engine, self._stream, has_scene=not resumed)

    def mark(self) -> dict[str, int]:
        self._flush()
        sync(self._path)
        return {}

    def frame(self, result: FrameResult) -> None:
        """Log one frame."""
        refuse_full_disk(self._path)
        self._frames.log(result, has_images=result.frame % self._every == 0)
        self._count += 1
        # The most frames that may wait for rerun's thread: on a busy machine they would pile up in memory.
        if self._count % 100 == 0:
            self._flush()

    def close(self) -> None:
        with suppress(InputError, WorkError):  # tables that cannot be read
            results = RunFolder(self._path.parent)
            tracks = results.tracks.where(results.tracks.state == "confirmed")
            xy = np.column_stack([tracks.x_m, tracks.y_m])
            if np.isfinite(xy).any():
                bounds = bounds_of(xy)
                self._frames.keep("plan/grid", shapes.metre_grid(bounds))
                self._stream.send_blueprint(shapes.blueprint(self._engine, bounds))
            log_assessment(self._stream, results)
        self.mark()
        self._stream.disconnect()  # where rerun's thread could not write it would wait for ever
        sync(self._path)

    def _flush(self) -> None:
        """Wait for rerun's thread as long as the file grows; the thread may end without a word when it cannot write."""
        size = -1
        while True:
            try:
                return self._stream.flush(timeout_sec=4.0)
            except (RuntimeError, ValueError) as error:
                before = size
                size = self._path.stat().st_size
                if size == before:
                    # Neither the end of Python nor that of the stream, which is kept for ever, waits for the thread.
                    rr.unregister_shutdown()
                    ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._stream))
                    problem = f"{self._path}: cannot be written ({reason(error)}); earlier frames are kept"
                    raise WorkError(problem) from error


IMAGES_SHARE = 0.12
"""Share of a run's time that goes into images for a viewer. Our choice."""


class ViewerLog:
    """Sends a run to a viewer while it runs: people, decisions and curves of all frames, images, clouds and maps of
    as many as there is time for.

    Args:
        address: of the viewer's data.
    """

    def __init__(self, engine: Engine, address: str) -> None:
        self._stream: rr.RecordingStream | None = _stream(engine, f"live-{time.time_ns()}", 0.1)
        self._stream.connect_grpc(address)
        self._stream.send_blueprint(shapes.blueprint(engine))
        self._frames = RerunFrames(engine, self._stream)
        self._begun_s = time.monotonic()
        self._images_s = 0.0
        self._count = 0

    def mark(self) -> dict[str, int]:
        return {}

    def frame(self, result: FrameResult) -> None:
        """Log one frame; none once the user has closed the viewer."""
        if self._stream is None:
            return
        begun_s = time.monotonic()
        has_images = self._images_s <= IMAGES_SHARE * (begun_s - self._begun_s)
        self._frames.log(result, has_images=has_images)
        if has_images:
            self._images_s += time.monotonic() - begun_s
        self._count += 1
        if self._count % 100 == 0:  # before frames pile up in memory
            self._flush()

    def close(self) -> None:
        self._flush()
        if self._stream is not None:
            self._stream.disconnect()

    def _flush(self) -> None:
        try:
            if self._stream is not None:
                self._stream.flush(timeout_sec=4.0)
        except (RuntimeError, ValueError):
            self._stream = None
