"""Speed of the engine compared with plain OpenCV on the same frames, in one run.

Both sides take turns, frame by frame, so that whatever else the machine does slows both.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
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
from planview.engine.engine import STAGES, FrameResult
from planview.engine.one_camera import OneCameraEngine
from planview.engine.open import ImageTrackerName, image_tracker
from planview.engine.stereo import stereo_engine
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams
from planview.synthetic.assets import DEMO, real_recordings
from stereo.readers import open_recording
from stereo.recording import StereoFrame, VideoFrame

Part = Literal["engine", "foreground", "after-disparity", "full-resolution", "one-camera", "start"]
BLOCK_PX = 5
"""Side of the yardstick's matched block [px]."""
SETTLED = 100
"""Frames before anything is timed: the background is learned, buffers are warm, kernels compiled."""
TURN = 4
"""Frames of the engine between two turns of OpenCV, which takes longer."""
PEOPLE = 4
"""People in the frames that count."""
PAINTED_FPS = 15.0
ENOUGH = 10
"""Where fewer frames than this have PEOPLE people, all frames with people count."""
ONE_CAMERA: dict[str, tuple[ImageTrackerName, int, int]] = {
    "human_model_five": ("human-model", 5, 320),
    "human_model_eight": ("human-model", 8, 640),
    "ellipse_particle_eight": ("ellipse-particle", 8, 480),
}
"""Tracker, people and columns of what is timed of one camera; 320x240 as in Zhang et al. 2008, section 5."""
FULL_RESOLUTION = ("rectify.working_px=0", "analysis.width_px=1280")
LIMITS = {
    "engine_to_yardstick_grey": 0.5,
    "engine_to_yardstick_colour": 0.5,
    "overhead": 0.08,
    "foreground_to_mog2": 0.7,
    "after_disparity_to_sgbm": 0.3,
    "one_more_person": 0.04,
    "full_resolution": 0.35,
    "human_model_five_to_mog2": 3.0,
    "ellipse_particle_eight_to_mog2": 3.0,
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

    def remap(self, left: U8, right: U8) -> list[AnyArray]:
        """Both images rectified."""
        images = (as_grey(left), as_grey(right)) if self._grey else (left, right)
        return [cv2.remap(image, *maps, cv2.INTER_LINEAR) for image, maps in zip(images, self._maps, strict=True)]

    def match(self, rectified: list[AnyArray]) -> AnyArray:
        """(H, W) int16 disparity [1/16 px]."""
        return self._sgbm.compute(*rectified)

    def __call__(self, left: U8, right: U8) -> AnyArray:
        """(H, W) int16 disparity [1/16 px] of a recorded pair."""
        return self.match(self.remap(left, right))


class Clip:
    """The first frames of a recording (the committed clip when None), decoded here or by another clip, and the engine
    on it at a width. Raises InputError: no such recording. Raises WorkError: too few frames."""

    def __init__(
        self, path: Path | None, n_frames: int, width_px: int = 640, frames: Sequence[StereoFrame] | None = None,
        overrides: Sequence[str] = (),
    ) -> None:  # fmt: skip
        path = path or DEMO
        if not path.exists():
            raise InputError(f"{path}: expected a recording, found nothing; name one with --recording")
        recording = open_recording(path)
        sized = {"rectify": {"working_px": width_px}, "analysis": {"width_px": min(width_px, 400)}}
        config = load_config(overrides=overrides, base=Config.model_validate(sized))
        self.rig = recording.rig
        self.engine = stereo_engine(recording, config)
        self.frames: Sequence[StereoFrame] = frames or list(islice(recording, n_frames))
        if len(self.frames) < 2:
            raise WorkError(f"{path}: expected at least 2 frames, found {len(self.frames)}")


@dataclass
class Speed:
    """Figures of ``python -m benchmarks speed``, as rows."""

    stages: list[dict[str, Any]] = field(default_factory=list)
    """Median time per stage of the frames that count, on one core [ms]."""
    ratios: list[dict[str, Any]] = field(default_factory=list)
    """Ours over OpenCV's."""
    details: list[dict[str, Any]] = field(default_factory=list)
    """The times behind the ratios [ms] and what was measured on."""

    def add(self, name: str, ratios: F64) -> None:
        """Median and quartiles of a ratio, measured frame by frame; of a single number no quartiles."""
        low, middle, high = np.percentile(ratios, (25, 50, 75)) if ratios.ndim else (math.nan, ratios, math.nan)
        row = {"ours / OpenCV": name, "median": float(middle), "from": float(low), "to": float(high)}
        self.ratios.append(row | {"limit": LIMITS.get(name)})

    def detail(self, name: str, value: str | float | Sequence[float] | F64) -> None:
        """A figure, of several their median."""
        self.details.append({"detail": name, "value": value if isinstance(value, str) else float(np.median(value))})


class SpeedTurns(NamedTuple):
    """One engine and its rivals over the (N,) timed frames of a clip; of each rival the latest of its turns."""

    engine_ms: F64
    people: I64
    rivals_ms: dict[str, F64]
    stages_ms: list[dict[str, float]]

    def ratios(self, name: str) -> F64:
        """(M,) float64 the engine's time over a rival's, in the frames that count."""
        return np.asarray((self.engine_ms / self.rivals_ms[name])[counted(self.people)], dtype=np.float64)


def measure(recording: Path | None, n_frames: int, parts: Sequence[Part], overrides: Sequence[str] = ()) -> Speed:
    """Measure parts on one recording (the committed clip when None); medians are taken over n_frames after SETTLED."""
    speed, config = Speed(), load_config(overrides=overrides)
    speed.detail("recording", str(recording or DEMO))
    if set(parts) - {"full-resolution", "one-camera", "start"}:
        progress("opening the recording")
        clip = Clip(recording, SETTLED + n_frames, overrides=overrides)
        speed.detail("image", "{}x{}".format(*clip.rig.left.size))
    if "engine" in parts:
        # All cores first: what is printed by stage and by people is of one core.
        for suffix, cores in (("_all_cores", nullcontext()), ("", one_core())):
            progress(f"whole engine and remap with SGBM{suffix.replace('_', ' ') or ' on one core'}")
            with cores:
                turns = take_turns(clip, {name: Yardstick(clip.rig, name == "grey") for name in ("grey", "colour")})
            chosen = counted(turns.people)
            for name, rival_ms in turns.rivals_ms.items():
                speed.add(f"engine_to_yardstick_{name}{suffix}", turns.ratios(name))
                speed.detail(f"yardstick_{name}_ms{suffix}", rival_ms)
            speed.detail(f"engine_ms{suffix}", turns.engine_ms[chosen])
        speed.detail("frames_counted", float(chosen.sum()))
        for count in np.unique(turns.people):
            speed.detail(f"engine_ms_{count}_people", turns.engine_ms[turns.people == count])
        stages = [stages for stages, counts in zip(turns.stages_ms, chosen, strict=True) if counts]
        names = [name for name in STAGES if name in stages[0]]
        speed.stages = [{"stage": name, "ms": float(np.median([s[name] for s in stages]))} for name in names]
    if "foreground" in parts:
        progress("foreground and MOG2")
        foreground_to_mog2(clip, speed)
    if "after-disparity" in parts:
        progress("everything after disparity at 320x240, and SGBM")
        after_disparity_to_sgbm(Clip(recording, 0, width_px=320, frames=clip.frames), speed)
    if "full-resolution" in parts:
        full_resolution(speed)
    if "one-camera" in parts:
        for name, (tracker, people, width) in ONE_CAMERA.items():
            progress(f"{tracker}, {people} people, {width} columns, and MOG2 on one core")
            with one_core():
                ours_ms, theirs_ms, found = one_camera_and_mog2(tracker, people, width, n_frames, config)
            speed.add(f"{name}_to_mog2", ours_ms / theirs_ms)
            speed.detail(f"{name}_ms", ours_ms)
            speed.detail(f"{name}_found", found)
    if "start" in parts:
        start_up(recording or DEMO, speed)
    return speed


def start_up(recording: Path, speed: Speed) -> None:
    """Kernels that a run compiles, how long that takes, and how long a run whose kernels are there takes to start."""
    code = (
        "import sys; from itertools import islice; from planview import open_engine; "
        "list(islice(open_engine(sys.argv[1]), int(sys.argv[2])))"
    )
    with TemporaryDirectory() as cache:
        for name, n_frames in (("compiled", SETTLED), ("again", SETTLED), ("to_first_frame", 1)):
            progress(f"a process of its own: {n_frames} frames, {name.replace('_', ' ')}")
            start, before = time.perf_counter(), os.times()
            command = [sys.executable, "-c", code, str(recording), str(n_frames)]
            subprocess.run(command, env=os.environ | {"NUMBA_CACHE_DIR": cache}, check=True)
            speed.detail(f"{name}_s", time.perf_counter() - start)
            speed.detail(f"{name}_processor_s", sum(os.times()[2:4]) - sum(before[2:4]))
        speed.detail("kernels", float(len(list(Path(cache).rglob("*.nbc")))))


def full_resolution(speed: Speed) -> None:
    """Engine over the yardstick in grey on one core on the real overhead pair, at half and at full resolution."""
    recording = real_recordings() / "overhead-stereo"
    if not recording.is_dir():
        progress(f"{recording}: not there, so that full resolution is not measured (set PLANVIEW_TEST_DATA)")
        return
    for name, overrides in (("overhead", ()), ("full_resolution", FULL_RESOLUTION)):
        progress(f"real overhead pair: {name.replace('_', ' ')}")
        # Of the real overhead pair, after SETTLED: a person walks through the view in the second half.
        clip = Clip(recording, SETTLED + 200, overrides=overrides)
        with one_core():
            speed.add(name, take_turns(clip, {"grey": Yardstick(clip.rig, grey=True)}).ratios("grey"))


def foreground_to_mog2(clip: Clip, speed: Speed) -> None:
    """Foreground, and OpenCV's MOG2 on the same images, frame by frame."""
    engine = clip.engine
    engine.reset()
    mog2 = cv2.createBackgroundSubtractorMOG2()
    (view,) = engine.views.values()
    ours = Foreground(ForegroundParams(), view.shape, view.geometry.disparity_std_per_px2)
    times: list[tuple[float, float]] = []
    step = view.reduction
    for frame in clip.frames:
        result = engine.step(frame)
        image = result.observation.image
        if image is None or result.disparity is None:
            continue
        disparity = np.ascontiguousarray(result.disparity[::step, ::step])
        theirs = seconds(mog2.apply, image)
        times.append((theirs, seconds(ours.update, image, disparity, result.timestamp_s)))
    theirs_ms, ours_ms = 1e3 * np.array(times[len(times) // 3 :]).T
    speed.detail("mog2_ms", theirs_ms)
    speed.detail("foreground_ms", ours_ms)
    speed.add("foreground_to_mog2", ours_ms / theirs_ms)


def after_disparity_to_sgbm(clip: Clip, speed: Speed) -> None:
    """Foreground, maps and tracker at 320x240 over the yardstick's SGBM, and what one more person adds."""
    size = 320, round(320 * clip.rig.left.size[1] / clip.rig.left.size[0])
    plain = Yardstick(clip.rig.scaled(*size), grey=True)
    clip.engine.reset()
    people, spent, track, sgbm = [], [], [], []
    for frame in clip.frames:
        left, right = (np.asarray(cv2.resize(image, size), np.uint8) for image in (frame.left, frame.right))
        sgbm.append(seconds(plain.match, plain.remap(left, right)))
        result = clip.engine.step(frame)
        spent.append(1e-3 * sum(result.stages_ms[stage] for stage in ("foreground", "maps", "track")))
        track.append(result.stages_ms["track"])
        people.append(people_in(result))
    start = min(SETTLED, len(people) // 2)
    n, after, match = (np.array(values[start:]) for values in (people, spent, sgbm))
    chosen = counted(n)
    speed.detail("sgbm_320_ms", 1e3 * match)
    speed.detail("after_disparity_ms", 1e3 * after[chosen])
    speed.detail("tracker_320_ms", np.array(track[start:])[chosen])
    speed.add("after_disparity_to_sgbm", after[chosen] / match[chosen])
    medians = [(k, float(np.median(after[n == k]))) for k in np.unique(n) if (n == k).sum() >= ENOUGH]
    if len(medians) > 1:
        counts, times = np.array(medians).T
        speed.add("one_more_person", np.asarray(np.polyfit(counts, times, 1)[0] / np.median(after[chosen])))


def one_camera_and_mog2(tracker: ImageTrackerName, people: int, width_px: int, n_frames: int, config: Config) -> F64:
    """Foreground and tracker of one camera in turns with MOG2 on the same painted frames, after SETTLED: (3, N)
    processor times of ours and of MOG2 [ms], and confirmed people."""
    camera = GroundCamera(width_px, width_px * 3 // 4, 260.0 * width_px / 320, 3.5, math.radians(60))
    video: Any = SimpleNamespace(size=camera.size)
    engine = OneCameraEngine(video, image_tracker(tracker, config, camera), config, camera)
    mog2 = cv2.createBackgroundSubtractorMOG2()
    rows: list[tuple[float, float, float]] = []
    for i, image in enumerate(walking_people(camera, people, SETTLED + n_frames)):
        start = time.process_time()
        mog2.apply(image)
        between = time.process_time()
        result = engine.step(VideoFrame(i, i / PAINTED_FPS, image))
        rows.append((1e3 * (time.process_time() - between), 1e3 * (between - start), people_in(result)))
    return np.array(rows[SETTLED:]).T


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


def take_turns(clip: Clip, rivals: Mapping[str, Callable[..., object]]) -> SpeedTurns:
    """The engine over a clip's decoded frames, and after SETTLED of them the rivals on every TURN-th."""
    clip.engine.reset()
    # A clip that short is timed in its second half.
    settled = SETTLED if len(clip.frames) > SETTLED else len(clip.frames) // 2
    spent: list[float] = []
    results: list[tuple[int, dict[str, float]]] = []
    theirs: dict[str, list[float]] = {name: [] for name in rivals}
    for n, frame in enumerate(clip.frames):
        start = time.perf_counter()
        result = clip.engine.step(frame)
        spent.append(1e3 * (time.perf_counter() - start))
        results.append((people_in(result), result.stages_ms))
        for name, rival in rivals.items():
            if n >= settled and (n % TURN == 0 or not theirs[name]):
                theirs[name].append(seconds(rival, frame.left, frame.right) * 1e3)
            elif theirs[name]:
                theirs[name].append(theirs[name][-1])
    timed = len(clip.frames) - settled
    people, stages = zip(*results[-timed:], strict=True)
    rival_ms = {name: np.array(times) for name, times in theirs.items()}
    return SpeedTurns(np.array(spent[-timed:]), np.array(people), rival_ms, list(stages))


def counted(people: I64) -> Bool:
    """Of (N,) people, (N,) bool: the frames that count, with four people; with anyone where those are too few."""
    four, anyone = people == PEOPLE, people > 0
    return four if four.sum() >= ENOUGH else anyone if anyone.sum() >= ENOUGH else people >= 0


def people_in(result: FrameResult) -> int:
    """Confirmed people."""
    return sum(track.state == "confirmed" for track in result.tracks)


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

    recording: Path | None = None
    """A stereo recording; the committed clip by default. Its first frames should show no person."""
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
    found = measure(o.recording, o.frames, o.part or get_args(Part), o.set_)
    report(o.json_output, **vars(found))
