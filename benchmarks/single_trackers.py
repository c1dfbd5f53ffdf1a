"""The trackers of one camera beside MOG2 on painted people."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from benchmarks.beside_mog2 import TimesBesideMog2
from benchmarks.curves import Progress
from benchmarks.ellipse_speed import LARGE as LARGE_FRAMES
from benchmarks.ellipse_speed import SMALL, ellipse_beside_mog2
from benchmarks.one_core import one_core
from benchmarks.single_speed import CAMERA, LARGE, human_model_beside_mog2

CLIPS: dict[str, Callable[[int], TimesBesideMog2]] = {
    "human_model": partial(human_model_beside_mog2, CAMERA, 5),
    "human_model_eight": partial(human_model_beside_mog2, LARGE, 8),
    "human_model_thirty": partial(human_model_beside_mog2, LARGE, 30),
    "ellipse_particle": partial(ellipse_beside_mog2, 8, SMALL, None),
    "ellipse_particle_thirty": partial(ellipse_beside_mog2, 30, LARGE_FRAMES, 60.0),
}
"""Five people at 320x240, eight and thirty at 640x480; eight at 480x360, thirty at 640x480; of so many timed frames."""


def single_trackers(n_frames: int, progress: Progress) -> Iterator[tuple[str, TimesBesideMog2]]:
    """Times of every one of CLIPS on one core, by name.

    Args:
        n_frames: timed of each.
        progress: told what is being measured.
    """
    for name, timed in CLIPS.items():
        progress(f"{name.replace('_', '-')} tracker beside MOG2 on one core")
        with one_core():
            times = timed(n_frames)
        yield name, times
