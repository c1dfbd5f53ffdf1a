"""Speed of the engine next to plain OpenCV on the same frames.

Both sides take turns, frame by frame, so that whatever else the machine does slows both.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
from cyclopts import Parameter

from benchmarks.options import Flag, JsonFlag, Row, progress, report
from benchmarks.passes import bench_engine
from calib.errors import InputError, WorkError
from calib.images import as_grey
from calib.rig import StereoRig
from calib.types import F64, I64, AnyArray, Bool
from planview.engine.config import load_config
from planview.engine.engine import STAGES, Engine
from planview.engine.open import TrackerName
from planview.synthetic.assets import DEMO
from stereo.recording import Frame, Pair, Recording, Shot

BLOCK_PX = 5
"""Side of the yardstick's matched block [px]."""
SETTLED_FRAMES = 100
"""Frames before anything is timed: the background is learned, buffers are warm, kernels compiled."""
TURN_FRAMES = 4
"""Frames of the engine between two turns of OpenCV, which takes longer."""
COUNTED_PEOPLE = 4
"""People in the frames that count."""
COUNTED_FRAMES_MIN = 10
"""Where fewer frames than this have COUNTED_PEOPLE people, all frames with people count."""
LIMITS = {
    "engine / remap, SGBM in grey": 0.5,
    "engine / remap, SGBM in colour": 0.5,
    "foreground / MOG2": 0.7,
}
"""What each ratio must not exceed for four people at 640x480."""
Rivals = Mapping[str, Callable[[Any], float]]


class Yardstick:
    """OpenCV's remap of both cameras and its StereoSGBM (three-way, block 5), without any setting of the engine; in
    grey or in the colours of the recording."""

    def __init__(self, rig: StereoRig, grey: bool) -> None:
        left, right, size = rig.left, rig.right, rig.left.size
        right_SE3_left = rig.right_SE3_left
        r1, r2, p1, p2 = cv2.stereoRectify(
            left.matrix, left.coefficients, right.matrix, right.coefficients, size,
            right_SE3_left.rotation, right_SE3_left.translation.reshape(3, 1), alpha=0.0,
        )[:4]  # fmt: skip
        self._grey = grey
        self._maps = [
            cv2.initUndistortRectifyMap(camera.matrix, camera.coefficients, turn, matrix, size, cv2.CV_16SC2)
            for camera, turn, matrix in ((left, r1, p1), (right, r2, p2))
        ]
        # The yardstick searches images up to this width over 64 disparities, wider ones over 128.
        self.disparities = 64 if size[0] <= 640 else 128
        area = BLOCK_PX * BLOCK_PX * (1 if grey else 3)  # OpenCV's recommendation: 8 and 32 times channels and block
        self._sgbm = cv2.StereoSGBM.create(
            0, self.disparities, BLOCK_PX, 8 * area, 32 * area, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY
        )

    def _remap(self, image: AnyArray, side: int) -> AnyArray:
        return cv2.remap(as_grey(image) if self._grey else image, *self._maps[side], cv2.INTER_LINEAR)

    def __call__(self, frame: Frame[Shot]) -> float:
        """Time of both [s]."""
        start = time.perf_counter()
        left, right = frame.images
        self._sgbm.compute(self._remap(left, 0), self._remap(right, 1))
        return time.perf_counter() - start


class Mog2:
    """OpenCV's MOG2 on (the left) images, reduced to at most a width."""

    def __init__(self, most_px: int) -> None:
        self._most_px, self._mog2 = most_px, cv2.createBackgroundSubtractorMOG2()

    def __call__(self, frame: Frame[Shot]) -> float:
        """Time of an update [s]."""
        image = frame.image
        height, width = image.shape[:2]
        columns = min(width, self._most_px)
        small = cv2.resize(image, (columns, round(columns * height / width)))
        start = time.perf_counter()
        self._mog2.apply(small)
        return time.perf_counter() - start


def ratio_row(name: str, ours_ms: F64, theirs_ms: F64) -> Row:
    """Median times of both sides, and the median and the quartiles of their ratio."""
    low, middle, high = map(float, np.percentile(ours_ms / theirs_ms, (25, 50, 75)))
    times = {"ours_ms": float(np.median(ours_ms)), "opencv_ms": float(np.median(theirs_ms))}
    return {"ours / OpenCV": name, **times, "ratio": (middle, low, high), "limit": LIMITS.get(name)}


def take_turns(engine: Engine, frames: Sequence[Frame[Shot]], rivals: Rivals) -> tuple[dict[str, F64], I64]:
    """The engine over decoded frames, and rivals on every TURN_FRAMES-th; timed after SETTLED_FRAMES, or in the second
    half of a clip that is that short. (N,) times [ms] of the engine, its stages and rivals; and confirmed people."""
    engine.reset()
    rows: list[dict[str, float]] = []
    people: list[int] = []
    theirs: dict[str, float] = {}
    for n, frame in enumerate(frames):
        start = time.perf_counter()
        result = engine.step(frame)
        spent_ms = 1e3 * (time.perf_counter() - start)
        if n % TURN_FRAMES == 0:
            theirs = {name: 1e3 * rival(frame) for name, rival in rivals.items()}
        rows.append({"engine": spent_ms, **result.stages_ms, **theirs})
        people.append(sum(track.state == "confirmed" for track in result.tracks))
    settled = SETTLED_FRAMES if len(rows) > SETTLED_FRAMES else len(rows) // 2
    timed = rows[settled:]
    return {name: np.array([row[name] for row in timed]) for name in timed[0]}, np.array(people[settled:])


def counted(people: I64) -> Bool:
    """Of (N,) people, (N,) bool: the frames that count, with four people; with anyone where those are too few."""
    four, anyone = people == COUNTED_PEOPLE, people > 0
    enough = [chosen for chosen in (four, anyone) if chosen.sum() >= COUNTED_FRAMES_MIN]
    return enough[0] if enough else people >= 0


def compared(engine: Engine, n_frames: int) -> dict[str, list[Row]]:
    """Ratios of the engine and its foreground to OpenCV on all cores and on one, and its stages on one, over n_frames
    after SETTLED_FRAMES. Raises InputError: several heads, or recorded maps. Raises WorkError: too few frames."""
    recording = engine.recording
    if not isinstance(recording, Recording):
        raise InputError(f"{recording.path}: expected the recording of one head")
    frames = list(islice(recording, SETTLED_FRAMES + n_frames))
    if len(frames) < 2:
        raise WorkError(f"{recording.path}: expected at least 2 frames, found {len(frames)}")
    yardsticks: dict[str, Yardstick] = {}
    if isinstance(recording.head, Pair):
        rig = recording.head.rig
        yardsticks = {f"remap, SGBM in {name}": Yardstick(rig, name == "grey") for name in ("grey", "colour")}
    rivals: Rivals = {**yardsticks, "MOG2": Mog2(engine.config.analysis.width_px)}
    ratios: list[Row] = []
    for cores, limited in ((" on all cores", nullcontext()), ("", one_core())):
        progress(f"the engine and {', '.join(rivals)}{cores or ' on one core'}")
        with limited:
            ms, people = take_turns(engine, frames, rivals)
        counts = {name: values[counted(people)] for name, values in ms.items()}
        for name in yardsticks or rivals:
            ratios.append(ratio_row(f"engine{cores} / {name}", counts["engine"], counts[name]))
    ratios.append(ratio_row("foreground / MOG2", counts["foreground"], counts["MOG2"]))
    stages = {name: counts[name] for name in STAGES if name in counts}
    stages |= {f"all, with {n} people": ms["engine"][people == n] for n in np.unique(people).tolist()}
    medians = [{"stage": name, "ms": float(np.median(values))} for name, values in stages.items()]
    return {"ratios": ratios, "stages": medians}


def start_up(recording: Path) -> list[Row]:
    """A run that compiles its kernels, one whose kernels are there, and one to its first frame: a process each."""
    code = (
        "import sys; from itertools import islice; from planview import open_engine; "
        "list(islice(open_engine(sys.argv[1]), int(sys.argv[2])))"
    )
    rows: list[Row] = []
    with TemporaryDirectory() as cache:
        for name, n_frames in (("compiles", SETTLED_FRAMES), ("again", SETTLED_FRAMES), ("to the first frame", 1)):
            progress(f"a process of its own: {n_frames} frames, {name}")
            start, before = time.perf_counter(), os.times()
            command = [sys.executable, "-c", code, str(recording), str(n_frames)]
            subprocess.run(command, env=os.environ | {"NUMBA_CACHE_DIR": cache}, check=True)
            spent_s, processor_s = time.perf_counter() - start, sum(os.times()[2:4]) - sum(before[2:4])
            row = {"start": name, "frames": n_frames, "s": spent_s, "processor_s": processor_s}
            rows.append(row | {"kernels": len(list(Path(cache).rglob("*.nbc")))})
    return rows


@contextmanager
def one_core() -> Iterator[None]:
    """Keep OpenCV, this thread and those it starts to one core."""
    threads, cores = cv2.getNumThreads(), os.sched_getaffinity(0)
    try:
        cv2.setNumThreads(1)
        os.sched_setaffinity(0, {max(cores)})
        yield
    finally:
        cv2.setNumThreads(threads)
        os.sched_setaffinity(0, cores)


@Parameter(name="*")
@dataclass(frozen=True)
class SpeedOptions:
    """What is timed, and what becomes of the figures."""

    recording: Path = DEMO
    """A recording. Its first frames should show no person."""
    tracker: TrackerName = "joint"
    """Tracker that follows people; those of one camera take turns with MOG2 alone."""
    camera: Path | None = None
    """camera.toml of a video, for the human-model tracker."""
    frames: int = 200
    """Number of frames over which medians are taken, after 100 in which the background is learned."""
    start: Flag = False
    """Time only the start: kernels, compiling them, which is what the first of two equal processes takes longer, and
    the first frame."""
    set_: Annotated[Sequence[str], Parameter(name="--set", negative="", show_default=False)] = ()
    """Set one parameter of the engine, like analysis.width_px=1280; repeat for more."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def speed(*, options: SpeedOptions | None = None) -> None:
    """Time the engine side by side with plain OpenCV on the same frames.

    The yardstick is OpenCV's remap and StereoSGBM of both cameras at the recorded size, with no setting of the engine:
    three-way, block 5, 64 disparities up to 640 px, 128 beyond.

    Example: python -m benchmarks speed --json

    Example of an overhead camera at full resolution: python -m benchmarks speed --recording my_recording --frames 100
    --set rectify.working_px=0 --set analysis.width_px=1280
    """
    o = options or SpeedOptions()
    if o.frames < 10:
        raise InputError(f"--frames: expected at least 10, found {o.frames}")
    if not o.recording.exists():
        raise InputError(f"{o.recording}: no such recording; name one with --recording")
    if o.start:
        report(o.json_output, start=start_up(o.recording))
        return
    engine = bench_engine(o.recording, o.tracker, load_config(set=o.set_), o.camera)
    report(o.json_output, **compared(engine, o.frames))
