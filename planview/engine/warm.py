"""Compiled kernels made ready before frames come in real time: loaded from numba's cache, or compiled.

Most kernels are first called when a person is in view. Loading them then costs the frames of that time.
"""

from __future__ import annotations

from importlib import import_module

import numpy as np

from calib.types import F32, U8
from planview.engine.boxes import BodyBoxes
from planview.engine.engine import Engine
from planview.engine.feedback import Feedback
from planview.engine.pipeline import Pipeline
from planview.foreground.mixture import Foreground
from planview.maps.builder import FloorPoints
from planview.tracking.base import Observation
from planview.tracking.harville import HarvilleTracker as TemplateTracker
from stereo.gate import SAMPLE

N_FRAMES, FRAME_S = 24, 0.1
"""Frames that two people walk: as many as it takes to confirm, lose, find and recognise them."""
AWAY = range(14, 18)
"""Frames in which one of them is away, as a track is that is looked for again."""
N_POINTS = 600
"""Points of a person: enough for a head."""


def warm_up(engine: Engine) -> None:
    """Run the kernels of foreground, maps, template tracker and feedback once, on people made up.

    Works on objects of its own: the engine's memory stays as it is. Another engine or tracker is left as it is.
    """
    if not isinstance(engine, Pipeline):
        return
    import_module("scipy.optimize")  # half a second when people first meet
    _separate(engine)
    if isinstance(engine.tracker, TemplateTracker):
        _follow(engine)


def _separate(engine: Pipeline) -> None:
    """Foreground and points of a scene in which something comes into view, grey and in colour."""
    shape, step = engine.maps.shape, SAMPLE
    disparity: F32 = np.full(shape, engine.setup.disparities.first_px + 1, np.float32)
    known: U8 = np.zeros(shape, np.uint8)
    for channels in ((), (3,)):
        foreground = Foreground(engine.config.foreground, shape, engine.maps.geometry.disparity_std_per_px2)
        for n in range(4):
            image: U8 = np.full((*shape, *channels), 100, np.uint8)
            image[: shape[0] // 2] += np.uint8(60 * (n > 1))
            measured = np.full(shape, 255, np.uint8) if n else None
            if measured is not None:
                foreground.changed(image, step)
            mask = foreground.update(image, disparity, n * FRAME_S, known, measured)
            engine.maps.points(disparity, mask | np.uint8(1), image)


def _follow(engine: Pipeline) -> None:
    """Two people who walk past each other."""
    tracker = TemplateTracker(engine.config.template, engine.config.maps.height_max_m)
    feedback = Feedback(engine.config.feedback)
    boxes = BodyBoxes(engine.maps.geometry, engine.maps.world_SE3_left)
    grid = engine.maps.grid
    x, y = grid.centre_of(grid.n_rows / 2, grid.n_cols / 2)
    rng = np.random.default_rng(0)
    for n in range(N_FRAMES):
        bodies = [_body(rng, x + 0.05 * n - 0.6, y)]
        if n not in AWAY:
            bodies.append(_body(rng, x - 0.05 * n + 0.6, y + 0.1))
        xyz = np.concatenate(bodies)
        points = FloorPoints(
            xyz,
            np.full(len(xyz), 1e-3, np.float32),
            np.arange(len(xyz), dtype=np.int32),
            np.zeros(len(xyz), np.uint8),
        )
        maps = engine.maps.of(points)
        tracks = tracker.update(Observation(n, n * FRAME_S, maps=maps))
        feedback(points, tracks, engine.maps.shape)
        for track in tracks:
            boxes(track)


def _body(rng: np.random.Generator, x_m: float, y_m: float) -> F32:
    """(N_POINTS, 3) float32 points of an upright body 1.7 m tall."""
    across = rng.normal((x_m, y_m), 0.06, (N_POINTS, 2))
    return np.column_stack([across, rng.uniform(0.2, 1.7, N_POINTS)]).astype(np.float32)
