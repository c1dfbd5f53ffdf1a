"""How well the floor is found, on rendered rooms at many tilts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from benchmarks.rows import Row
from calib.errors import WorkError
from calib.rig import Floor, StereoRig
from planview.synthetic.assets import SCENES, real_recordings
from planview.synthetic.render import SceneRenderer
from planview.synthetic.scene import Scene, load_scene
from stereo.floor import FloorEstimator, setup_frames
from stereo.readers.open import open_recording
from stereo.recording import StereoFrame
from stereo.rectify import aligned_rectifier

TILTS_DEG = (0, 15, 30, 45, 60, 75)
SCENE = SCENES / "demo.toml"
HIGH, LOW = (3.5, 2.0, 2.9), (3.5, 0.2, 2.6)
"""Where the cameras hang [m]: steep ones above the middle of the room, flat ones at its wall."""
FRAMES = 6
"""Rendered frames per tilt, fewer than a run looks at: rendering is most of the time."""
HEIGHT_LIMIT_CM, ANGLE_LIMIT_DEG = 2.0, 0.3
REAL_HEIGHT_M, REAL_LIMIT_CM = 2.74, 5.0
"""The overhead pair of the shared recordings, by its disparity (see its README)."""


def measure(progress: Callable[[str], None] = lambda _: None) -> tuple[Row, ...]:
    """Render the committed lobby from cameras at several tilts and compare the floor found with the truth.

    The real overhead pair is measured too where the shared recordings are ($PLANVIEW_TEST_DATA).

    Args:
        progress: told what is going on.
    """
    rows: list[Row] = []
    for tilt_deg in TILTS_DEG:
        progress(f"floor at {tilt_deg} degrees")
        rows += _rendered(load_scene(SCENE), tilt_deg)
    real = real_recordings() / "overhead-stereo"
    if real.is_dir():
        progress("floor of the real overhead pair")
        recording = open_recording(real)
        found = _found(recording.rig, setup_frames(recording))
        off = 100 * abs(found.height_m - REAL_HEIGHT_M)
        rows.append(Row("floor, real overhead pair: height", off, "cm", REAL_LIMIT_CM, off <= REAL_LIMIT_CM))
    return tuple(rows)


def _rendered(description: Scene, tilt_deg: float) -> list[Row]:
    mount = description.mount.model_copy(update={"tilt_deg": float(tilt_deg), "at_m": HIGH if tilt_deg < 50 else LOW})
    renderer = SceneRenderer(description.model_copy(update={"rig": mount}))
    chosen = np.linspace(0, renderer.n_frames - 1, FRAMES).astype(int)
    frames = [_frame(renderer, int(i)) for i in chosen]
    if renderer.rig is None or renderer.world_SE3_left is None:
        raise WorkError(f"{SCENE}: expected a stereo scene")
    truth = Floor(renderer.world_SE3_left)
    name = f"floor, rendered at {tilt_deg:g} degrees"
    try:
        found = _found(renderer.rig, frames)
    except WorkError:
        return [Row(f"{name}: height", math.inf, "cm", HEIGHT_LIMIT_CM, False)]
    height = 100 * abs(found.height_m - truth.height_m)
    tilt, roll = (math.degrees(abs(getattr(found, key) - getattr(truth, key))) for key in ("tilt_rad", "roll_rad"))
    return [
        Row(f"{name}: height", height, "cm", HEIGHT_LIMIT_CM, height <= HEIGHT_LIMIT_CM),
        Row(f"{name}: tilt", tilt, "deg", ANGLE_LIMIT_DEG, tilt <= ANGLE_LIMIT_DEG),
        Row(f"{name}: roll", roll, "deg", ANGLE_LIMIT_DEG, roll <= ANGLE_LIMIT_DEG),
    ]


def _frame(renderer: SceneRenderer, index: int) -> StereoFrame:
    frame = renderer.frame(index)
    if frame.right is None:
        raise WorkError(f"{SCENE}: expected a stereo scene")
    return StereoFrame(index, frame.timestamp_s, frame.left, frame.right)


def _found(rig: StereoRig, frames: list[StereoFrame]) -> Floor:
    rectifier, _ = aligned_rectifier(rig, frames)
    return FloorEstimator(rectifier)(frames)
