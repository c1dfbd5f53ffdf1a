"""Speed of the engine compared with plain OpenCV on the same frames, in one run.

Both sides take turns, frame by frame, so that whatever else the machine does slows both.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Annotated, Any, Literal, NamedTuple, get_args

import cv2
import numpy as np
from cyclopts import Parameter

from benchmarks.options import JsonFlag, progress, report
from calib.errors import InputError, WorkError
from calib.ground_camera import GroundCamera
from calib.images import as_grey
from calib.people.model import HumanModel
from calib.rig import StereoRig
from calib.types import F64, I64, U8, AnyArray, Bool
from planview.engine.config import Config, load_config
from planview.engine.engine import STAGES, Engine
from planview.engine.one_camera import one_camera_engine
from planview.engine.open import ImageTrackerName, image_tracker
from planview.engine.stereo import stereo_engine
from planview.synthetic.assets import DEMO, real_recordings
from stereo.readers import open_recording
from stereo.recording import StereoFrame, VideoFrame

Part = Literal["engine", "foreground", "after-disparity", "full-resolution", "one-camera", "start"]
Row = dict[str, Any]
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
PAINTED_FPS = 15.0
ONE_CAMERA: dict[str, tuple[ImageTrackerName, int, int]] = {
    "human model, five people": ("human-model", 5, 320),
    "human model, eight people": ("human-model", 8, 640),
    "ellipses, eight people": ("ellipse-particle", 8, 480),
}
"""Tracker, people and columns of what is timed of one camera; 320x240 as in Zhang et al. 2008, section 5."""
AFTER_MATCHING = STAGES[STAGES.index("match") + 1 :]
LIMITS = {
    "engine / remap, SGBM in grey": 0.5,
    "engine / remap, SGBM in colour": 0.5,
    "overhead / remap, SGBM in grey": 0.08,
    "overhead at full resolution / remap, SGBM in grey": 0.35,
    "foreground / MOG2": 0.7,
    "after disparity / SGBM": 0.3,
    "one more person / after disparity": 0.04,
    "human model, five people / MOG2": 3.0,
    "ellipses, eight people / MOG2": 3.0,
}
"""What each ratio must not exceed; those of the engine for four people at 640x480."""


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
        self._grey, self._size = grey, size
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

    def remap(self, frame: StereoFrame) -> list[AnyArray]:
        """Both images rectified, scaled before to the yardstick's size where they have another."""
        images = [as_grey(image) if self._grey else image for image in (frame.left, frame.right)]
        if images[0].shape[1::-1] != self._size:
            images = [np.asarray(cv2.resize(image, self._size), np.uint8) for image in images]
        return [cv2.remap(image, *maps, cv2.INTER_LINEAR) for image, maps in zip(images, self._maps, strict=True)]

    def match(self, frame: StereoFrame) -> float:
        """Time of StereoSGBM alone [s]."""
        rectified = self.remap(frame)
        return seconds(self._sgbm.compute, *rectified)

    def __call__(self, frame: StereoFrame) -> float:
        """Time of both [s]."""
        return seconds(lambda: self._sgbm.compute(*self.remap(frame)))


class Mog2:
    """OpenCV's MOG2 on (the left) images of a width."""

    def __init__(self, width_px: int) -> None:
        self._width_px, self._mog2 = width_px, cv2.createBackgroundSubtractorMOG2()

    def __call__(self, frame: StereoFrame | VideoFrame) -> float:
        """Time of an update [s]."""
        image = frame.left if isinstance(frame, StereoFrame) else frame.image
        height, width = image.shape[:2]
        small = cv2.resize(image, (self._width_px, round(self._width_px * height / width)))
        return seconds(self._mog2.apply, small)


class Turns(NamedTuple):
    """Times over the (N,) timed frames [ms]: of the engine, its stages and its rivals; and confirmed people."""

    ms: dict[str, F64]
    people: I64

    def counted(self, *names: str) -> F64:
        """(M,) float64 sums of times in the frames that count."""
        return self.sums(*names)[counted(self.people)]

    def sums(self, *names: str) -> F64:
        """(N,) float64 sums of times of those stages that there are."""
        return np.asarray(np.sum([self.ms[name] for name in names if name in self.ms], axis=0), dtype=np.float64)

    def row(self, name: str, rival: str, ours: Sequence[str] = ("engine",)) -> Row:
        """A ratio with its quartiles, measured frame by frame."""
        return ratio_row(f"{name} / {rival}", self.counted(*ours), self.counted(rival))


def ratio_row(name: str, ours_ms: F64, theirs_ms: F64) -> Row:
    """Median times of both sides, and the median and the quartiles of their ratio."""
    low, middle, high = map(float, np.percentile(ours_ms / theirs_ms, (25, 50, 75)))
    times = {"ours_ms": float(np.median(ours_ms)), "opencv_ms": float(np.median(theirs_ms))}
    return {"ours / OpenCV": name, **times, "ratio": (middle, low, high), "limit": LIMITS.get(name)}


def take_turns(
    engine: Engine, frames: Iterable[StereoFrame | VideoFrame], rivals: Mapping[str, Callable[[Any], float]]
) -> Turns:
    """The engine over decoded frames, and rivals on every TURN_FRAMES-th; timed after SETTLED_FRAMES, or in the second
    half of a clip that is that short."""
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
    return Turns({name: np.array([row[name] for row in timed]) for name in timed[0]}, np.array(people[settled:]))


def counted(people: I64) -> Bool:
    """Of (N,) people, (N,) bool: the frames that count, with four people; with anyone where those are too few."""
    four, anyone = people == COUNTED_PEOPLE, people > 0
    enough = [chosen for chosen in (four, anyone) if chosen.sum() >= COUNTED_FRAMES_MIN]
    return enough[0] if enough else people >= 0


class Clip:
    """The first frames of a recording, decoded, and an engine for it. Raises InputError: no such recording. Raises
    WorkError: too few frames."""

    def __init__(self, path: Path, n_frames: int, overrides: Sequence[str] = ()) -> None:
        if not path.exists():
            raise InputError(f"{path}: no such recording; name one with --recording")
        recording = open_recording(path)
        self.rig, self._recording = recording.rig, recording
        self.engine = self.engine_at(640, overrides)
        self.frames = list(islice(recording, n_frames))
        if len(self.frames) < 2:
            raise WorkError(f"{path}: expected at least 2 frames, found {len(self.frames)}")

    def engine_at(self, width_px: int, overrides: Sequence[str]) -> Engine:
        """An engine that works at a width."""
        sized = {"rectify": {"working_px": width_px}, "analysis": {"width_px": min(width_px, 400)}}
        return stereo_engine(self._recording, load_config(overrides=overrides, base=Config.model_validate(sized)))

    def yardsticks(self) -> dict[str, Yardstick]:
        return {f"remap, SGBM in {name}": Yardstick(self.rig, name == "grey") for name in ("grey", "colour")}


def measure(recording: Path, n_frames: int, parts: Sequence[Part], overrides: Sequence[str]) -> dict[str, list[Row]]:
    """Tables of rows by name; medians are taken over n_frames after SETTLED_FRAMES."""
    ratios: list[Row] = []
    stages: list[Row] = []
    if {"engine", "foreground", "after-disparity"} & set(parts):
        progress("opening the recording")
        clip = Clip(recording, SETTLED_FRAMES + n_frames, overrides)
    if {"engine", "foreground"} & set(parts):
        mog2 = Mog2(clip.engine.config.analysis.width_px)
        rivals: dict[str, Callable[[Any], float]] = {**clip.yardsticks(), "MOG2": mog2}
        for cores, limited in (("all cores", nullcontext()), ("one core", one_core())):
            progress(f"the whole engine, remap with SGBM, and MOG2 on {cores}")
            with limited:
                turns = take_turns(clip.engine, clip.frames, rivals)
            suffix = "" if cores == "one core" else f" on {cores}"
            if "engine" in parts:
                ratios += [turns.row(f"engine{suffix}", name) for name in clip.yardsticks()]
        if "engine" in parts:
            timed = [name for name in STAGES if name in turns.ms]
            stages = [{"stage": name, "ms": float(np.median(turns.counted(name)))} for name in timed]
            for count in np.unique(turns.people).tolist():
                ms = float(np.median(turns.ms["engine"][turns.people == count]))
                stages.append({"stage": f"all, with {count} people", "ms": ms})
        if "foreground" in parts:
            ratios.append(turns.row("foreground", "MOG2", ["foreground"]))
    if "after-disparity" in parts:
        progress("everything after disparity at 320x240, and SGBM")
        ratios += after_disparity(clip, overrides)
    if "full-resolution" in parts:
        ratios += full_resolution()
    if "one-camera" in parts:
        ratios += [one_camera(*named, n_frames, load_config(overrides=overrides)) for named in ONE_CAMERA.items()]
    return {"ratios": ratios, "stages": stages, "start": start_up(recording) if "start" in parts else []}


def after_disparity(clip: Clip, overrides: Sequence[str]) -> list[Row]:
    """Foreground, maps and tracker at 320x240 over the yardstick's SGBM, and what one more person adds."""
    plain = Yardstick(clip.rig.scaled(320, round(320 * clip.rig.left.size[1] / clip.rig.left.size[0])), grey=True)
    turns = take_turns(clip.engine_at(320, overrides), clip.frames, {"SGBM": plain.match})
    rows = [turns.row("after disparity", "SGBM", AFTER_MATCHING)]
    of_count = {n: turns.sums(*AFTER_MATCHING)[turns.people == n] for n in np.unique(turns.people).tolist()}
    medians = {n: float(np.median(times)) for n, times in of_count.items() if len(times) >= COUNTED_FRAMES_MIN}
    if len(medians) > 1:
        added_ms = np.polyfit(list(medians), list(medians.values()), 1)[:1]
        all_ms = np.median(turns.counted(*AFTER_MATCHING), keepdims=True)
        rows.append(ratio_row("one more person / after disparity", added_ms, all_ms))
    return rows


def full_resolution() -> list[Row]:
    """Engine over the yardstick in grey on one core on the real overhead pair, at half and at full resolution."""
    recording, rows = real_recordings() / "overhead-stereo", []
    if not recording.is_dir():
        progress(f"{recording}: not there, so that full resolution is not measured (set PLANVIEW_TEST_DATA)")
        return []
    full = ("rectify.working_px=0", "analysis.width_px=1280")
    for name, overrides in (("overhead", ()), ("overhead at full resolution", full)):
        progress(f"real pair: {name}")
        # A person walks through the view in the second half.
        clip = Clip(recording, SETTLED_FRAMES + 200, overrides)
        with one_core():
            turns = take_turns(clip.engine, clip.frames, clip.yardsticks())
        rows.append(turns.row(name, "remap, SGBM in grey"))
    return rows


def one_camera(name: str, timed: tuple[ImageTrackerName, int, int], n_frames: int, config: Config) -> Row:
    """Foreground and tracker of one camera in turns with MOG2 on the same painted frames, on one core."""
    tracker, people, width_px = timed
    progress(f"{name}, {width_px} columns, and MOG2")
    camera = GroundCamera(width_px, width_px * 3 // 4, 260.0 * width_px / 320, 3.5, math.radians(60))
    video: Any = SimpleNamespace(size=camera.size)
    engine = one_camera_engine(video, image_tracker(tracker, config, camera), config, camera)
    painted = enumerate(walking_people(camera, people, SETTLED_FRAMES + n_frames))
    frames = (VideoFrame(i, i / PAINTED_FPS, image) for i, image in painted)
    with one_core():
        return take_turns(engine, frames, {"MOG2": Mog2(width_px)}).row(name, "MOG2")


def walking_people(camera: GroundCamera, people: int, n_frames: int) -> Iterator[U8]:
    """(H, W, 3) uint8 frames of people of the model's shape who walk to and fro 3.5 to 7.5 m away, in one colour above
    the hip and another below; nobody in the first 10."""
    rng = np.random.default_rng(5)
    width, height = camera.size
    texture = cv2.GaussianBlur(rng.uniform(40, 215, (height, width, 3)), (7, 7), 2)
    noise = rng.normal(0, 2.5, (4, height, width, 3))
    clothes = rng.uniform(0, 255, (people, 2, 3))
    far = np.linspace(7.5, 3.5, people)
    reach = 0.55 * far
    speed = rng.uniform(0.8, 1.4, people) * np.where(np.arange(people) % 2, 1, -1)
    start = rng.uniform(-reach, reach)
    rows = np.arange(height)[:, None]
    for i in range(n_frames):
        frame = texture + noise[i % 4]
        x_m = abs((start + reach + speed * i / PAINTED_FPS) % (4 * reach) - 2 * reach) - reach
        for k in range(people if i >= 10 else 0):
            hull = np.round(HumanModel().hull(camera, x_m[k], far[k])).astype(np.int32)
            body = cv2.fillPoly(np.zeros((height, width), np.uint8), [hull], 1) > 0
            frame[body & (rows < hull[:, 1].mean())] = clothes[k, 0]
            frame[body & (rows >= hull[:, 1].mean())] = clothes[k, 1]
        yield np.clip(frame, 0, 255).astype(np.uint8)


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


def seconds(run: Callable[..., object], *args: object) -> float:
    """Time that a call takes [s]."""
    start = time.perf_counter()
    run(*args)
    return time.perf_counter() - start


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
    """A stereo recording. Its first frames should show no person."""
    frames: int = 200
    """Number of frames over which medians are taken, after 100 in which the background is learned."""
    part: Annotated[Sequence[Part], Parameter(negative="", show_default=False)] = ()
    """Measure only this; repeat for more: engine, foreground, after-disparity (at 320x240), full-resolution (the real
    overhead pair of the shared recordings), one-camera (its trackers on painted people), start (kernels, compiling
    them, which is what the first of two equal processes takes longer, and the first frame). All by default."""
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
    --part engine --set rectify.working_px=0 --set analysis.width_px=1280
    """
    o = options or SpeedOptions()
    if o.frames < 10:
        raise InputError(f"--frames: expected at least 10, found {o.frames}")
    report(o.json_output, **measure(o.recording, o.frames, o.part or get_args(Part), o.set_))
