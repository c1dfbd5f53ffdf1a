"""How the engine's time grows: with pixels, disparities, time between frames, and people."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.clip import Clip
from benchmarks.crowd import EMPTY, SIZE, Crowd, crowd_pipeline, crowd_rig
from benchmarks.one_core import one_core
from benchmarks.scaled import ScaledFrames, ScaledRecording
from benchmarks.side_by_side import SETTLED, TURN, people_in, seconds, take_turns
from benchmarks.yardstick import Yardstick
from calib.types import F64

SIZES = ((320, 240), (480, 360), (640, 480), (1280, 960))
"""Of the images [px]; the last has a fifth more pixels than 1280x800."""
VGA = (640, 480)
DISPARITIES = (32, 64, 128)
USUAL_STEP = 2
"""Of pixels and disparities: every second frame, for the time that the bench takes."""
STEPS = (1, 2, 3, 5)
"""Every n-th frame: 15, 7.5, 5 and 3 Hz."""
PEOPLE = (0, 2, 4, 10, 25, 50)
FRAMES = 240
"""Of the committed clip: the first 100 settle, in the last four people walk."""
CROWD_SETTLED, CROWD_FRAMES = EMPTY + 40, EMPTY + 80
"""Frames of a crowd before anything is timed, and in all."""


CURVES = ("pixels", "disparities", "rate", "people")
"""By the names of their parts of the bench."""


class Point(NamedTuple):
    """A figure of a curve: its name, and the ratios measured frame by frame."""

    name: str
    ratios: F64


Progress = Callable[[str], None]


def engine_curve(name: str, clip: Clip, progress: Progress) -> Iterator[Point]:
    """A curve of the whole engine on one core, point by point.

    Args:
        name: of CURVES, but not people.
        clip: the committed one, with FRAMES frames.
    """
    curves = {"pixels": pixels_curve, "disparities": disparities_curve, "rate": rate_curve}
    with one_core():
        yield from curves[name](clip, progress)


def pixels_curve(clip: Clip, progress: Progress) -> Iterator[Point]:
    """Whole engine over the yardstick in grey at several sizes, with the usual working size and with none."""
    for size in SIZES:
        progress("pixels: {}x{}".format(*size))
        yield Point("pixels_{}x{}".format(*size), _engine_over_yardstick(clip, size))
        if size[0] > VGA[0]:
            full = ("rectify.working_px=0",)
            yield Point("full_pixels_{}x{}".format(*size), _engine_over_yardstick(clip, size, full))


def disparities_curve(clip: Clip, progress: Progress) -> Iterator[Point]:
    """Whole engine over the yardstick in grey, by the disparities that are searched at most."""
    for count in DISPARITIES:
        progress(f"disparities: {count}")
        nearest = clip.setup.rectifier.geometry.disparity_metre / (count - 2)
        overrides = (f"range.nearest_m={nearest:.3f}", "range.reach_m=5.0")
        yield Point(f"disparities_{count}", _engine_over_yardstick(clip, VGA, overrides))


def rate_curve(clip: Clip, progress: Progress) -> Iterator[Point]:
    """Whole engine over the yardstick in grey, by frame rate."""
    for step in STEPS:
        progress(f"frame rate: every {step}. frame")
        yield Point(f"rate_{clip.recording.fps / step:g}_hz", _engine_over_yardstick(clip, VGA, every=step))


def _engine_over_yardstick(
    clip: Clip, size: tuple[int, int], overrides: Sequence[str] = (), every: int = USUAL_STEP
) -> F64:
    world = clip.setup.floor.world_SE3_left
    frames = ScaledFrames(clip.frames[:FRAMES], size, every)
    recording = ScaledRecording(clip.recording, frames, size, world)
    scaled = Clip(recording, 0, width_px=min(640, size[0]), frames=frames, overrides=overrides)
    turns = take_turns(scaled, {"yardstick": Yardstick(recording.rig, grey=True)}, SETTLED // every)
    return turns.ratios("yardstick")


def people_curve(progress: Progress) -> Iterator[Point]:
    """Foreground, maps and tracker over the yardstick's SGBM at 320x240 on one core, by people in view."""
    with one_core():
        yield from _people_curve(progress)


def _people_curve(progress: Progress) -> Iterator[Point]:
    pipeline = crowd_pipeline()
    yardstick = Yardstick(crowd_rig(), grey=True)
    noise = np.random.default_rng(0).integers(0, 255, (SIZE[1], SIZE[0] + 16), dtype=np.uint8)
    texture = np.asarray(cv2.GaussianBlur(noise, (0, 0), 2.0))
    pair = [np.ascontiguousarray(texture[:, shift : shift + SIZE[0]]) for shift in (0, 10)]
    for people in PEOPLE:
        pipeline.reset()
        ours, theirs, tracked = [], [], []
        for frame in Crowd(pipeline, people).frames(CROWD_FRAMES):
            result = pipeline.track(frame)
            ours.append(1e-3 * sum(result.stages_ms[stage] for stage in ("foreground", "maps", "track")))
            if frame.frame % TURN == 0:
                theirs.append(seconds(yardstick.match, pair))
            tracked.append(people_in(result))
        progress(f"people: {people}, of whom {np.median(tracked[CROWD_SETTLED:]):.0f} are tracked")
        ratios = np.array(ours[CROWD_SETTLED:]) / float(np.median(theirs))
        yield Point(f"people_{people}", ratios)
