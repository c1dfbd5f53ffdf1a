"""The frame rate of images with depth that hold no times, from how far people move between frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from calib.camera import Camera
from calib.types import F32, F64
from stereo.depth import median_image
from stereo.recording import RgbdFrame

WALKING_MPS = 1.3
"""Comfortable walking speed of adults (Bohannon 1997, Age and Ageing 26: 1.27 to 1.46 m/s), less a little indoors."""
PAIRS = 24
"""Places in the recording at which two consecutive frames are compared (our choice)."""
MIN_PAIRS = 4
"""With movement in fewer of them nothing is said (our choice)."""
STEP_PX = 8
"""Every n-th row and column is looked at."""
NEARER_M = 0.3
"""What stands this far in front of the background is a person or a thing that was moved (our choice)."""
BODY_M2 = (0.1, 1.5)
"""Surface that a person shows [m^2]."""
STEP_M = (0.03, 1.5)
"""Steps between frames: shorter ones are noise and people who stand, longer ones are not of one person [m]."""


def rate_by_movement(at: Callable[[Sequence[int]], list[RgbdFrame]], n_frames: int, camera: Camera) -> float | None:
    """Frames per second at which what moves is as fast as a walker.

    Args:
        at: decodes frames of these ascending indices.
        camera: of the images.
    Returns:
        None where too little moves.
    """
    firsts = np.unique(np.linspace(0, max(0, n_frames - 2), PAIRS).astype(int))
    indices = np.unique(np.concatenate([firsts, firsts + 1]))
    depths = {f.index: f.depth_m[::STEP_PX, ::STEP_PX] for f in at([int(i) for i in indices if i < n_frames])}
    if len(depths) < MIN_PAIRS:
        return None
    background = median_image(list(depths.values()))
    rays = _rays(camera)
    places = {index: _place(depth, background, rays, camera) for index, depth in depths.items()}
    steps = np.array([_step(places.get(int(i)), places.get(int(i) + 1)) for i in firsts])
    steps = steps[(steps > STEP_M[0]) & (steps < STEP_M[1])]
    return float(WALKING_MPS / np.median(steps)) if len(steps) >= MIN_PAIRS else None


def _rays(camera: Camera) -> F64:
    """(h, w, 3) rays at unit depth of the pixels looked at."""
    columns, rows = np.meshgrid(np.arange(0, camera.width, STEP_PX), np.arange(0, camera.height, STEP_PX))
    return camera.unproject(np.column_stack([columns.ravel(), rows.ravel()])).reshape(*columns.shape, 3)


def _place(depth: F32, background: F32, rays: F64, camera: Camera) -> F64 | None:
    """Middle [m] of the largest thing in front of the background; None without one of a person's size."""
    with np.errstate(invalid="ignore"):
        nearer = (background - depth > NEARER_M).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(nearer)
    if count < 2:
        return None
    of_it = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    area = depth[of_it] ** 2 * (STEP_PX**2 / (camera.fx * camera.fy))
    if not BODY_M2[0] <= float(area.sum()) <= BODY_M2[1]:
        return None
    return np.asarray(np.median(rays[of_it] * depth[of_it][:, None], axis=0), dtype=np.float64)


def _step(one: F64 | None, other: F64 | None) -> float:
    return float("nan") if one is None or other is None else float(np.linalg.norm(other - one))
