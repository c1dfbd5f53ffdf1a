"""How fast the engine is beside plain OpenCV on the same frames, in one run.

Both sides take turns, frame by frame or in blocks, so that whatever else the machine does slows both. Every ratio is a
function of its own; ``measure`` collects them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from calib.images import as_grey
from planview.bench.clip import Clip, PlainOpenCV
from planview.bench.ellipse_speed import ellipse_to_mog2
from planview.bench.one_core import one_core
from planview.bench.single_speed import human_model_to_mog2
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams
from planview.pipeline.engine import STAGES

BLOCK = 10
"""Frames per block where whole runs take turns."""
SETTLED = 100
"""Frames before anything is timed: the background is learned, buffers are warm, kernels compiled."""
LIMITS = {
    "engine_to_opencv_grey": 1.25,
    "engine_to_opencv_colour": 1.25,
    "foreground_to_mog2": 1.0,
    "after_disparity_to_sgbm": 0.5,
    "one_more_person": 0.05,
    "human_model_to_mog2": 6.0,
    "ellipse_particle_to_mog2": 6.0,
}
"""What each ratio must not exceed."""


@dataclass
class Speed:
    """Figures of ``planview bench speed``.

    Attributes:
        stages_ms: median time per stage; matching and reading overlap with the rest, so total is less than their sum.
        ratios: ours over OpenCV's, by name.
        details: the times behind the ratios [ms] and what was measured on.
    """

    stages_ms: dict[str, float] = field(default_factory=dict)
    ratios: dict[str, float] = field(default_factory=dict)
    details: dict[str, float | str] = field(default_factory=dict)


def measure(recording: Path | None, n_frames: int, progress: Callable[[str], None] = lambda _: None) -> Speed:
    """Measure everything on one recording.

    Args:
        recording: the committed clip when None.
        n_frames: medians over so many frames.
        progress: told what is being measured.
    Raises:
        InputError: no such recording.
    """
    speed = Speed()
    progress("opening the recording")
    clip = Clip(recording, SETTLED + n_frames)
    speed.details["recording"] = str(clip.recording.path)
    speed.details["image"] = "{}x{}".format(*clip.pipeline.setup.rectifier.geometry.size)
    progress("whole engine beside remap and SGBM")
    engine_to_opencv(clip, n_frames, speed)
    progress("foreground beside MOG2")
    foreground_to_mog2(clip, n_frames, speed)
    progress("everything after disparity at 320x240 beside SGBM")
    after_disparity_to_sgbm(Clip(recording, 0, width_px=320, frames=clip.frames), speed)
    for name, ratio in (("human_model", human_model_to_mog2), ("ellipse_particle", ellipse_to_mog2)):
        progress(f"{name.replace('_', '-')} tracker beside MOG2 on one core")
        with one_core():
            speed.ratios[f"{name}_to_mog2"], details = ratio(n_frames)
        speed.details |= {key: round(value, 3) for key, value in details.items()}
    return speed


def engine_to_opencv(clip: Clip, n_frames: int, speed: Speed) -> None:
    """Engine from reading to tracks beside bare remap and SGBM of decoded frames, in turns of BLOCK frames.

    OpenCV matches grey images, as the engine does, and the colour images themselves.
    """
    plain = PlainOpenCV(clip)
    engine = clip.looped()
    for _ in islice(engine, SETTLED):
        pass
    intervals: list[float] = []
    bare: dict[bool, list[float]] = {True: [], False: []}
    stages: list[dict[str, float]] = []
    turn = 0
    while len(intervals) < n_frames:
        # The first results were made ahead, during the other side's turn or the pause after it.
        for _ in islice(engine, 4):
            pass
        start = time.perf_counter()
        for result in islice(engine, BLOCK):
            stages.append(result.stages_ms)
        intervals += [(time.perf_counter() - start) / BLOCK] * BLOCK
        time.sleep(4 * intervals[-1])  # lets the reader fill its queue and rest
        for k in range(2 * BLOCK):
            pair = clip.frames[turn % len(clip.frames)]
            turn += 1
            bare[k % 2 == 0].append(_seconds(plain, pair.left, pair.right, k % 2 == 0))
    engine.close()
    speed.stages_ms = {name: _ms([s[name] for s in stages], 1.0) for name in STAGES}
    speed.stages_ms["total"] = _ms(intervals)
    for name, grey in (("grey", True), ("colour", False)):
        speed.details[f"opencv_{name}_ms"] = _ms(bare[grey])
        speed.ratios[f"engine_to_opencv_{name}"] = _ms(intervals) / _ms(bare[grey])


def foreground_to_mog2(clip: Clip, n_frames: int, speed: Speed) -> None:
    """Foreground in colour and depth beside OpenCV's MOG2 on the rectified colour frames, frame by frame."""
    mog2 = cv2.createBackgroundSubtractorMOG2()
    ours = Foreground(ForegroundParams(), clip.pipeline.size[::-1])
    times: tuple[list[float], list[float]] = [], []
    for frame in clip.frames[: SETTLED + n_frames]:
        matched = clip.pipeline.match(frame)
        times[0].append(_seconds(mog2.apply, matched.image))
        times[1].append(_seconds(ours.update, matched.image, matched.disparity, matched.timestamp_s))
    mog2_ms, ours_ms = _ms(times[0][SETTLED:]), _ms(times[1][SETTLED:])
    speed.details |= {"mog2_ms": mog2_ms, "foreground_ms": ours_ms}
    speed.ratios["foreground_to_mog2"] = ours_ms / mog2_ms


def after_disparity_to_sgbm(clip: Clip, speed: Speed) -> None:
    """Foreground, maps and tracker at 320x240 beside SGBM alone, frame by frame, and what one more person adds.

    Frames with four people count; where there are none, those with most people.
    """
    plain, pipeline = PlainOpenCV(clip), clip.pipeline
    pipeline.reset()
    people, spent, sgbm = [], [], []
    for frame, matched in zip(clip.frames, clip.matched(), strict=True):
        grey = [as_grey(image) for image in plain.remap(frame.left, frame.right)]
        sgbm.append(_seconds(plain.sgbm.compute, *grey))
        start = time.perf_counter()
        result = pipeline.track(matched)
        spent.append(time.perf_counter() - start)
        people.append(sum(track.state != "lost" for track in result.tracks))
    n = np.array(people[SETTLED:])
    after, match = np.array(spent[SETTLED:]), _ms(sgbm[SETTLED:])
    counted = n == 4 if (n == 4).sum() >= 10 else n == n.max()
    after_ms = _ms(list(after[counted]))
    speed.details |= {"sgbm_320_ms": match, "after_disparity_ms": after_ms, "people": float(n[counted][0])}
    speed.ratios["after_disparity_to_sgbm"] = after_ms / match
    medians = [(count, float(np.median(after[n == count]))) for count in np.unique(n) if (n == count).sum() >= 10]
    if len(medians) > 1:
        counts, times = np.array(medians).T
        speed.ratios["one_more_person"] = float(np.polyfit(counts, times, 1)[0] * 1e3 / after_ms)


def _seconds(run: Callable[..., object], *args: object) -> float:
    start = time.perf_counter()
    run(*args)
    return time.perf_counter() - start


def _ms(seconds: list[float], scale: float = 1e3) -> float:
    return round(float(np.median(seconds)) * scale, 3)
