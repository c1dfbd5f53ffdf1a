"""How fast the engine is beside plain OpenCV on the same frames, in one run.

Both sides take turns, frame by frame, so that whatever else the machine does slows both. Every ratio is a function of
its own; ``measure`` collects them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from benchmarks.clip import Clip
from benchmarks.curves import CURVES, Progress, engine_curve, people_curve
from benchmarks.curves import FRAMES as CURVE_FRAMES
from benchmarks.near_people import FRAMES as NEAR_FRAMES
from benchmarks.near_people import near_recording
from benchmarks.one_core import one_core
from benchmarks.side_by_side import (
    PEOPLE,
    SETTLED,
    Figure,
    Turns,
    counted,
    people_in,
    rivals_of,
    seconds,
    take_turns,
)
from benchmarks.single_trackers import single_trackers
from benchmarks.start import start_to_first_frame
from benchmarks.yardstick import Yardstick
from calib.types import F64
from planview.engine.engine import STAGES
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams
from planview.synthetic.assets import DEMO, real_recordings
from stereo.gating import SAMPLE

PARTS = ("engine", "foreground", "after-disparity", "single", "start", "worst-case", "full-resolution", *CURVES)
"""What is measured, in order."""
USUAL = tuple(part for part in PARTS if part not in CURVES)
"""What is measured when nothing is named: the curves take some minutes more."""
OVERHEAD_FRAMES = 200
"""Of the real overhead pair, after SETTLED: a person walks through the view in the second half."""
FULL = ("rectify.working_px=0", "analysis.width_px=1280")
LIMITS = {
    "engine_to_yardstick_grey": 0.5,
    "engine_to_yardstick_colour": 0.5,
    "overhead": 0.08,
    "foreground_to_mog2": 0.7,
    "after_disparity_to_sgbm": 0.3,
    "one_more_person": 0.04,
    "human_model_to_mog2": 4.0,
    "ellipse_particle_to_mog2": 4.0,
    "human_model_eight_ms": 15.0,
    "human_model_thirty_ms": 100.0,
    "ellipse_particle_thirty_ms": 100.0,
    "start_second": 0.4,
    "worst_case": 1.05,
    "full_resolution": 0.35,
    "fifty_over_four_people": 3.0,
}
"""What each ratio and time must not exceed; those of the engine for four people at 640x480."""


@dataclass
class Speed:
    """Figures of ``python -m benchmarks speed``.

    Attributes:
        stages_ms: median time per stage of the frames that count, on one core.
        ratios: ours over OpenCV's, by name: medians.
        times_ms: of one frame of the trackers of one camera, by name: medians of processor time.
        quartiles: of those ratios and times that are measured frame by frame.
        details: the times behind the ratios [ms] and what was measured on.
    """

    stages_ms: dict[str, float] = field(default_factory=dict)
    ratios: dict[str, float] = field(default_factory=dict)
    times_ms: dict[str, float] = field(default_factory=dict)
    quartiles: dict[str, tuple[float, float]] = field(default_factory=dict)
    details: dict[str, float | str] = field(default_factory=dict)

    def add(self, name: str, values: F64, time: bool = False) -> None:
        """A ratio, or a time [ms], measured frame by frame."""
        figure = Figure.of(values)
        (self.times_ms if time else self.ratios)[name] = figure.median
        self.quartiles[name] = figure.low, figure.high


class Bench:
    """One measurement: what is measured on, and the figures so far.

    Attributes:
        speed: the figures.
        clip: the recording and the engine on it, made when a part first needs it.
    """

    def __init__(
        self, recording: Path | None, n_frames: int, progress: Progress, needed: int, overrides: Sequence[str]
    ) -> None:
        self._recording, self.n_frames, self.progress = recording, n_frames, progress
        self._needed, self._overrides = needed, overrides
        self.speed = Speed(details={"recording": str(recording or DEMO)})

    @cached_property
    def clip(self) -> Clip:
        """See the class."""
        self.progress("opening the recording")
        clip = Clip(self._recording, self._needed, overrides=self._overrides)
        self.speed.details["image"] = "{}x{}".format(*clip.recording.rig.left.size)
        return clip

    def engine(self) -> None:
        """Whole engine."""
        for cores in ("one_core", "all_cores"):
            self.progress(f"whole engine beside remap and SGBM on {cores.replace('_', ' ')}")
            engine_to_yardstick(self.clip, cores, self.speed)

    def foreground(self) -> None:
        """Foreground alone."""
        self.progress("foreground beside MOG2")
        foreground_to_mog2(self.clip, self.speed)

    def after_disparity(self) -> None:
        """What comes after the disparity."""
        self.progress("everything after disparity at 320x240 beside SGBM")
        small = Clip(self._recording, 0, width_px=320, frames=self.clip.frames)
        after_disparity_to_sgbm(small, self.speed)

    def single(self) -> None:
        """Trackers of one camera."""
        for name, times in single_trackers(self.n_frames, self.progress):
            self.speed.add(f"{name}_to_mog2", times.ratios)
            self.speed.add(f"{name}_ms", times.engine_ms, time=True)
            details = {"longest_ms": times.engine_ms.max(), "mog2_ms": _median(times.mog2_ms)}
            details["people"] = _median(times.people)
            self.speed.details |= {f"{name}_{key}": round(float(value), 3) for key, value in details.items()}

    def start(self) -> None:
        """Start of a run."""
        clip = self.clip
        self.progress("start of planview run to its first frame beside 100 frames of the yardstick")
        for kind, values in start_to_first_frame(clip.recording, clip.frames).items():
            self.speed.add(f"start_{kind}", values)

    def worst_case(self) -> None:
        """A view full of people."""
        self.progress("eight people near the camera beside the yardstick")
        worst_case(self.speed, self.progress)

    def full_resolution(self) -> None:
        """A large image at half and at full size."""
        full_resolution(self.speed, self.progress)

    def curve(self, name: str) -> None:
        """One curve."""
        points = people_curve(self.progress) if name == "people" else engine_curve(name, self.clip, self.progress)
        for point, values in points:
            self.speed.add(point, values)
        if name == "people":
            ratios = self.speed.ratios
            ratios["fifty_over_four_people"] = round(ratios["people_50"] / ratios["people_4"], 3)


def measure(
    recording: Path | None,
    n_frames: int,
    progress: Progress = lambda _: None,
    parts: Sequence[str] = USUAL,
    overrides: Sequence[str] = (),
) -> Speed:
    """Measure everything on one recording.

    Args:
        recording: the committed clip when None.
        n_frames: medians over so many frames, after SETTLED.
        progress: told what is being measured.
        parts: of PARTS.
        overrides: parameters of the engine, as of ``--set``.
    Raises:
        InputError: no such recording.
    """
    needed = max(SETTLED + n_frames, CURVE_FRAMES if set(CURVES) & set(parts) else 0)
    bench = Bench(recording, n_frames, progress, needed, overrides)
    for part in PARTS:
        if part in parts and part in CURVES:
            bench.curve(part)
        elif part in parts:
            getattr(bench, part.replace("-", "_"))()
    return bench.speed


def worst_case(speed: Speed, progress: Progress) -> None:
    """Engine over the yardstick in grey on one core, with eight people who fill the view (a rendered scene)."""
    clip = Clip(near_recording(progress), NEAR_FRAMES)
    with one_core():
        turns = take_turns(clip, {"yardstick": Yardstick(clip.recording.rig, grey=True)}, NEAR_FRAMES - 60)
    ratios, near = turns.engine_ms / turns.rivals_ms["yardstick"], turns.people >= np.quantile(turns.people, 0.5)
    speed.add("worst_case", np.asarray(ratios[near]))
    speed.details["worst_case_people"] = _median(turns.people[near])
    speed.details["worst_case_matched_share"] = _median(turns.matched[near])


def full_resolution(speed: Speed, progress: Progress) -> None:
    """Engine over the yardstick in grey on one core on the real overhead pair, at half and at full resolution."""
    recording = real_recordings() / "overhead-stereo"
    if not recording.is_dir():
        progress(f"{recording}: not there, so that full resolution is not measured (set PLANVIEW_TEST_DATA)")
        return
    for name, overrides in (("overhead", ()), ("full_resolution", FULL)):
        progress(f"real overhead pair: {name.replace('_', ' ')}")
        clip = Clip(recording, SETTLED + OVERHEAD_FRAMES, overrides=overrides)
        with one_core():
            turns = take_turns(clip, {"yardstick": Yardstick(clip.recording.rig, grey=True)})
        speed.add(name, turns.ratios("yardstick"))


def engine_to_yardstick(clip: Clip, cores: str, speed: Speed) -> None:
    """Engine from decoded frames to tracks beside the yardstick, and beside OpenCV over the engine's disparities."""
    with one_core() if cores == "one_core" else nullcontext():
        turns = take_turns(clip, rivals_of(clip))
    suffix = "" if cores == "one_core" else "_all_cores"
    for name in turns.rivals_ms:
        speed.add(f"engine_to_{name}{suffix}", turns.ratios(name))
        speed.details[f"{name}_ms{suffix}"] = _median(turns.rivals_ms[name])
    speed.details[f"engine_ms{suffix}"] = _median(turns.engine_ms[turns.counted])
    if not suffix:
        _describe(turns, speed)


def _describe(turns: Turns, speed: Speed) -> None:
    """Times by stage and by people."""
    chosen = [stages for stages, counts in zip(turns.stages_ms, turns.counted, strict=True) if counts]
    speed.stages_ms = {name: _median([s[name] for s in chosen]) for name in STAGES if name in chosen[0]}
    speed.stages_ms["total"] = _median(turns.engine_ms[turns.counted])
    speed.details["matched_share"] = _median(turns.matched[turns.counted])
    speed.details["frames_counted"] = float(turns.counted.sum())
    for count in np.unique(turns.people):
        speed.details[f"engine_ms_{count}_people"] = _median(turns.engine_ms[turns.people == count])


def foreground_to_mog2(clip: Clip, speed: Speed) -> None:
    """Foreground beside OpenCV's MOG2 on the images that it gets, frame by frame, gated as in the engine."""
    engine = clip.pipeline
    engine.reset()
    mog2 = cv2.createBackgroundSubtractorMOG2()
    ours = Foreground(ForegroundParams(), engine.maps.shape, engine.stereo.geometry.disparity_std_per_px2)
    times: list[tuple[float, float]] = []
    step = engine.stereo.reduction
    for frame in clip.frames:
        result = engine.step(frame)
        if result.observation.image is None or result.disparity is None:
            continue
        image = result.observation.image
        disparity = np.ascontiguousarray(result.disparity[::step, ::step])
        now, measured = result.timestamp_s, result.measured if ours.settled else None
        theirs = seconds(mog2.apply, image)
        if measured is not None:
            disparity[measured == 0] = np.nan
        spent = seconds(ours.changed, image, SAMPLE) if measured is not None else 0.0
        times.append((theirs, spent + seconds(ours.update, image, disparity, now, None, measured)))
    theirs_ms, ours_ms = 1e3 * np.array(times[len(times) // 3 :]).T
    speed.details |= {"mog2_ms": _median(theirs_ms), "foreground_ms": _median(ours_ms)}
    speed.add("foreground_to_mog2", ours_ms / theirs_ms)


def after_disparity_to_sgbm(clip: Clip, speed: Speed) -> None:
    """Foreground, maps and tracker at 320x240 beside the yardstick's SGBM, and what one more person adds."""
    rig, pipeline = clip.recording.rig, clip.pipeline
    size = 320, round(320 * rig.left.size[1] / rig.left.size[0])
    plain = Yardstick(rig.scaled(*size), grey=True)
    pipeline.reset()
    people, spent, sgbm = [], [], []
    for frame in clip.frames:
        left, right = (np.asarray(cv2.resize(image, size), np.uint8) for image in (frame.left, frame.right))
        sgbm.append(seconds(plain.match, plain.remap(left, right)))
        result = pipeline.step(frame)
        spent.append(1e-3 * sum(result.stages_ms[stage] for stage in ("foreground", "maps", "track")))
        people.append(people_in(result))
    start = min(SETTLED, len(people) // 2)
    n, after, match = (np.array(values[start:]) for values in (people, spent, sgbm))
    chosen = counted(n)
    speed.details |= {"sgbm_320_ms": _median(1e3 * match), "after_disparity_ms": _median(1e3 * after[chosen])}
    speed.add("after_disparity_to_sgbm", after[chosen] / match[chosen])
    medians = [(k, float(np.median(after[n == k]))) for k in np.unique(n) if (n == k).sum() >= 10]
    if len(medians) > 1:
        counts, times = np.array(medians).T
        speed.ratios["one_more_person"] = round(float(np.polyfit(counts, times, 1)[0] / np.median(after[chosen])), 4)
        speed.details["people"] = float(PEOPLE)


def _median(values: Sequence[float] | F64) -> float:
    return round(float(np.median(values)), 3)
