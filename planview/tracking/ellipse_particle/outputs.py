"""Objects as rows of ``tracks.csv``."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F64
from planview.maps.builder import PlanViewMaps
from planview.tracking.body_axis import BodyAxis
from planview.tracking.ellipse_particle.fit.ellipses import extent
from planview.tracking.ellipse_particle.life import Life
from planview.tracking.ellipse_particle.planes import PlaneView
from planview.trajectories.state import TrackState

HEIGHTS_M = np.linspace(0.3, 2.5, 45)
"""Heights at which a vertical line is tried against an image row [m]."""
HIGHEST_M = 2.5
"""No person reaches higher [m]."""
KEPT = 0.5
"""Share of the last offset and height kept per frame: averages the noise of two or three frames. Our choice."""


def image_state(life: Life, view: PlaneView, ellipse: F64, velocity: F64, camera: GroundCamera | None) -> TrackState:
    """Box around the whole ellipse, hidden parts and parts outside the image included; floor position with a camera.

    Args:
        ellipse: (5,) x, y, a, b, angle [cells].
        velocity: (2,) [px/s].
    """
    half_width, half_height = (v * view.scale for v in extent(ellipse))
    x, y = view.to_plane(ellipse[:2])
    # A box of n pixels from pixel p ends at p + n - 1; edges are half a pixel beyond the centres.
    box = (float(x - half_width), float(y - half_height), 2 * half_width, 2 * half_height)
    if camera is None:
        return TrackState(life.track_id, life.state, box_px=box)
    foot = np.array([x, y + half_height])
    here = camera.back_project(foot)
    ahead = camera.back_project(foot + velocity)
    v = ahead - here
    height = height_of(camera, here, float(y - half_height))
    return TrackState(life.track_id, life.state, float(here[0]), float(here[1]), float(v[0]), float(v[1]), height, box)


def height_of(camera: GroundCamera, floor: F64, top_row: float) -> float:
    """Height [m] above a floor position at which a vertical line meets an image row; NaN where there is none."""
    if not np.isfinite(floor).all():
        return math.nan
    points = np.column_stack([np.broadcast_to(floor, (len(HEIGHTS_M), 2)), HEIGHTS_M])
    rows = camera.project(points)[:, 1]
    ok = np.isfinite(rows)
    if ok.sum() < 2:
        return math.nan
    order = np.argsort(rows[ok])
    return float(np.interp(top_row, rows[ok][order], HEIGHTS_M[ok][order]))


def floor_state(life: Life, view: PlaneView, ellipse: F64, velocity: F64) -> TrackState:
    """Floor position [m] of the body's axis, and its height as last measured."""
    x, y = (float(v) for v in view.to_plane(ellipse[:2]))
    dx, dy = life.offset_m
    return TrackState(life.track_id, life.state, x + dx, y + dy, float(velocity[0]), float(velocity[1]), life.height_m)


def measure_axes(lives: Sequence[Life], view: PlaneView, ellipses: F64, maps: PlanViewMaps, reach_m: float) -> None:
    """Find the axis and height of every body that is seen, as the template tracker does (see ``body_axis``).

    The camera sees the near side of a body, so ellipses lie nearer than the axis. Offset and height are smoothed, and
    kept while a body is hidden.

    Args:
        reach_m: how far from its ellipse's centre a body's points are taken [m].
    """
    seen = [n for n, life in enumerate(lives) if life.seen and not life.hidden]
    if not seen:
        return
    where = view.to_plane(ellipses[seen, :2])
    axes = BodyAxis(maps.view.camera_m, HIGHEST_M)(maps.points, where, reach_m)
    for n, (x, y), axis in zip(seen, where, axes, strict=True):
        life = lives[n]
        if not math.isnan(axis.x_m):
            keep = 0.0 if math.isnan(life.height_m) else KEPT
            dx, dy = life.offset_m
            life.offset_m = (keep * dx + (1 - keep) * (axis.x_m - x), keep * dy + (1 - keep) * (axis.y_m - y))
        if not math.isnan(axis.height_m):
            old = axis.height_m if math.isnan(life.height_m) else life.height_m
            life.height_m = KEPT * old + (1 - KEPT) * axis.height_m
