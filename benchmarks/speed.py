"""Time that the engine takes for a frame, by stage, by number of people and next to bare stereo, and that its start
takes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from functools import partial, singledispatch
from itertools import islice
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import pandas

from benchmarks.options import Report, Row, benchmark, progress, tables
from benchmarks.passes import bench_engine
from calib.errors import WorkError
from calib.images import as_grey
from calib.rig import StereoRig
from calib.types import U8, AnyArray
from planview.api.arguments import in_range
from planview.api.run import run
from planview.engine.config import load_config
from planview.engine.engine import STAGES, Engine
from planview.engine.open import TrackerName
from planview.output.report.page import write_report
from planview.output.tables import RunTables
from planview.synthetic.assets import DEMO
from stereo.recording import Frame, Recording, Shot, StereoPair

SETTLED_FRAMES = 100
"""Frames before anything is timed: the background is learned, buffers are warm, kernels compiled."""
BLOCK_PX = 5
"""Side of the block that bare stereo matches [px]."""
BARE_DISPARITIES = 64
WIDE_PX = 640
"""Number of disparities that bare stereo searches, and twice as many in images that are wider than this [px]."""


@benchmark
def speed(
    *,
    recording: Path = DEMO,
    tracker: TrackerName = "joint",
    camera: Path | None = None,
    frames: int = 200,
    start: bool = False,
    overrides: Sequence[str] = (),
) -> Report:
    """Time the engine on all cores and on one.

    A machine that does other things meanwhile slows every figure: to compare two versions, run both in turns.

    Example: python -m benchmarks speed --json

    Example of an overhead camera at full resolution: python -m benchmarks speed --recording my_recording --frames 100
    --set rectify.working_px=0 --set analysis.width_px=1280

    Args:
        recording: A recording. Its first frames should show no person.
        tracker: Tracker that follows people.
        camera: camera.toml of a video, for the human-model tracker.
        frames: Number of frames over which medians are taken, after 100 in which the background is learned.
        start: Time only the start, of a run of one frame and of commands that do not run.
        overrides: One parameter of the engine, like analysis.width_px=1280; can be repeated.
    """
    if start:
        return tables(start=start_rows(recording))
    in_range("frames", frames, 10, 1_000_000)
    engine = bench_engine(recording, tracker, load_config(overrides=overrides), camera)
    decoded = list(islice(engine.recording, SETTLED_FRAMES + frames))
    if len(decoded) < 2:
        raise WorkError(f"{recording}: expected at least 2 frames, found {len(decoded)}")
    progress("the engine on all cores")
    on_all = time_frames(engine, decoded)
    with one_core():
        progress("the engine on one core")
        on_one = time_frames(engine, decoded)
        bare = bare_rows(engine, decoded)
    progress("tables and report of a run")
    written = output_rows(engine, decoded)
    return tables(stages=stage_rows(on_all, on_one), people=people_rows(on_one), bare=bare, output=written)


def time_frames(engine: Engine, frames: Sequence[Any]) -> pandas.DataFrame:
    """Times of the engine, its stages and its tracker alone [ms] and confirmed people, a row per frame after
    SETTLED_FRAMES, or in the second half of a short clip."""
    engine.reset()
    tracker = deepcopy(engine.tracker)
    rows = []
    for frame in frames:
        start_s = time.perf_counter()
        result = engine.step(frame)
        spent_ms = 1e3 * (time.perf_counter() - start_s)
        people = sum(track.state == "confirmed" for track in result.tracks)
        tracker_ms = _processor_ms(partial(tracker.update, result.observation))
        rows.append({"all": spent_ms, **result.stages_ms, "people": people, "tracker": tracker_ms})
    return pandas.DataFrame(rows[min(SETTLED_FRAMES, len(rows) // 2) :])


def stage_rows(on_all: pandas.DataFrame, on_one: pandas.DataFrame) -> list[Row]:
    """Median time of the engine and of each stage."""
    medians = pandas.DataFrame({"ms, all cores": on_all.median(), "ms, one core": on_one.median()})
    return [{"stage": name, **medians.loc[name]} for name in ("all", *STAGES) if name in on_all]


def people_rows(times: pandas.DataFrame) -> list[Row]:
    """Mean processor time of the tracker by number of people."""
    by_people = times.groupby("people")["tracker"]
    return [{"people": people, "frames": len(part), "tracker, ms": part.mean()} for people, part in by_people]


class BareStereo:
    """OpenCV's remap of both cameras and its three-way SGBM, at the recorded size and with no setting of the engine."""

    def __init__(self, rig: StereoRig, is_grey: bool) -> None:
        left = rig.left
        right = rig.right
        pose = rig.right_SE3_left
        shift = pose.translation.reshape(3, 1)
        lenses = left.matrix, left.coefficients, right.matrix, right.coefficients
        turns_and_views = cv2.stereoRectify(*lenses, left.size, pose.rotation, shift, alpha=0.0)[:4]
        self._is_grey = is_grey
        self._maps = []
        for camera, turn, view in zip((left, right), turns_and_views[:2], turns_and_views[2:], strict=True):
            lens = camera.matrix, camera.coefficients
            self._maps.append(cv2.initUndistortRectifyMap(*lens, turn, view, left.size, cv2.CV_16SC2))
        disparities = BARE_DISPARITIES * (1 + (left.width > WIDE_PX))
        area = BLOCK_PX * BLOCK_PX * (1 if is_grey else 3)  # OpenCV's recommendation: 8 and 32 times this
        mode = cv2.STEREO_SGBM_MODE_SGBM_3WAY
        self._sgbm = cv2.StereoSGBM.create(0, disparities, BLOCK_PX, 8 * area, 32 * area, mode=mode)

    def __call__(self, left: U8, right: U8) -> AnyArray:
        """(H, W) int16 disparity [1/16 px] of a recorded pair."""
        images = (as_grey(left), as_grey(right)) if self._is_grey else (left, right)
        rectified = [cv2.remap(image, *maps, cv2.INTER_LINEAR) for image, maps in zip(images, self._maps, strict=True)]
        return self._sgbm.compute(*rectified)


@singledispatch
def bare_of(recorded: object) -> dict[str, BareStereo]:
    """Bare stereo, in grey and in colour, of the pairs that one sensor recorded; none where it cannot be."""
    return {}


@bare_of.register(Recording)
def _bare_of_recording(recording: Recording[Any]) -> dict[str, BareStereo]:
    return bare_of(recording.sensor)


@bare_of.register
def _bare_of_pair(sensor: StereoPair) -> dict[str, BareStereo]:
    if sensor.rig.left.model == "fisheye":
        return {}
    return {"grey": BareStereo(sensor.rig, True), "colour": BareStereo(sensor.rig, False)}


def bare_rows(engine: Engine, frames: Sequence[Frame[Shot]]) -> list[Row]:
    """Processor time of the engine over that of bare stereo in colour and in grey, of the same frames in turns."""
    bare = bare_of(engine.recording)
    if not bare:
        return []
    if frames[0].image.ndim == 2:
        del bare["colour"]
    rows = []
    engine.reset()
    for frame in frames:
        row = {"engine": _processor_ms(partial(engine.step, frame))}
        for name, stereo in bare.items():
            row[name] = _processor_ms(partial(stereo, *frame.images))
        rows.append(row)
    medians = pandas.DataFrame(rows[SETTLED_FRAMES:] or rows).median().to_dict()
    ours_ms = medians["engine"]
    return [{"bare stereo": name, "ms": medians[name], "ratio": ours_ms / medians[name]} for name in bare]


def output_rows(engine: Engine, frames: Sequence[Frame[Shot]]) -> list[Row]:
    """Processor time of what a run adds to the engine."""
    with TemporaryDirectory() as name:
        out = Path(name) / "run"
        run(engine, out=out, frames=len(frames))
        report_ms = _processor_ms(partial(write_report, out))
        files = RunTables(Path(name), events=False)
        engine.reset()
        tables_ms = 0.0
        for frame in frames:
            tables_ms += _processor_ms(partial(files.add, engine.step(frame), ()))
        files.close()
    return [
        {"output": "tables, a frame", "ms": tables_ms / len(frames)},
        {"output": "report, a run", "ms": report_ms},
    ]


def _processor_ms(work: Callable[[], object]) -> float:
    """Time that all threads of this process compute during some work."""
    start_s = time.process_time()
    work()
    return 1e3 * (time.process_time() - start_s)


def start_rows(recording: Path) -> list[Row]:
    """Processor time of commands, each in a process of its own, of which the first compiles its kernels."""
    rows = []
    with TemporaryDirectory() as folder:
        copy = f"{folder}/recording"
        copytree(recording, copy)
        run_one = ["run", copy, "--frames", "1", "--out", f"{folder}/out", "--overwrite"]
        commands = {
            "kernels compiled": run_one,
            "one frame": run_one,
            "its floor saved": ["calibrate", "floor", copy, "--save"],
            "one frame with world.toml": run_one,
            "help": ["run", "--help"],
            "usage error": ["run", "--nothing"],
        }
        for name, words in commands.items():
            progress(f"a process of its own: {name}")
            before_s = sum(os.times()[2:4])  # of processes that have ended
            command = [sys.executable, "-m", "planview", *words]
            subprocess.run(command, env=os.environ | {"NUMBA_CACHE_DIR": folder}, capture_output=True, check=False)
            rows.append({"start": name, "processor_s": sum(os.times()[2:4]) - before_s})
    return rows


@contextmanager
def one_core() -> Iterator[None]:
    """Keep OpenCV, this thread and those it starts to one core."""
    threads = cv2.getNumThreads()
    cores = os.sched_getaffinity(0)
    try:
        cv2.setNumThreads(1)
        os.sched_setaffinity(0, {max(cores)})
        yield
    finally:
        cv2.setNumThreads(threads)
        os.sched_setaffinity(0, cores)
