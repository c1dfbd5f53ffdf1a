"""Objects as rows of ``tracks.csv``."""

from __future__ import annotations

import math

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F64
from planview.ellipses import extent
from planview.maps import PlanViewMaps
from planview.tracking.base import TrackState
from planview.tracking.ellipse_particle.life import Life
from planview.tracking.ellipse_particle.planes import PlaneView

HEIGHTS_M = np.linspace(0.3, 2.5, 45)


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


def floor_state(life: Life, view: PlaneView, ellipse: F64, velocity: F64, maps: PlanViewMaps | None) -> TrackState:
    """Floor position [m] of the ellipse and the highest point of the map within it."""
    x, y = (float(v) for v in view.to_plane(ellipse[:2]))
    height = math.nan if maps is None else highest_within(maps, ellipse)
    return TrackState(life.track_id, life.state, x, y, float(velocity[0]), float(velocity[1]), height)


def highest_within(maps: PlanViewMaps, ellipse: F64) -> float:
    """Highest point [m] of the raw height map inside an ellipse; NaN where the map is empty there."""
    x, y, a, b, angle = (float(v) for v in ellipse)
    half_width, half_height = extent(ellipse)
    rows = np.arange(max(0, math.ceil(y - half_height)), min(maps.grid.n_rows, math.floor(y + half_height) + 1))
    cols = np.arange(max(0, math.ceil(x - half_width)), min(maps.grid.n_cols, math.floor(x + half_width) + 1))
    if not len(rows) or not len(cols):
        return math.nan
    dx, dy = cols[None] - x, rows[:, None] - y
    u = (dx * math.sin(angle) + dy * math.cos(angle)) / a
    v = (dx * math.cos(angle) - dy * math.sin(angle)) / b
    heights = maps.height_raw[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1][u * u + v * v <= 1.0]
    top = float(heights.max()) if heights.size else 0.0
    return top if top > 0 else math.nan
