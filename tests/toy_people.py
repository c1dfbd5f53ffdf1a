"""People as the body table sees them, in front of an empty floor, as pixels for the joint tracker."""

from collections.abc import Sequence

import numpy as np

from calib.pose import SE3
from calib.types import F64
from planview.maps.view import SURFACE, PixelRays, View
from planview.tracking.base import Observation
from planview.tracking.body import FACINGS, LEAN_M, TORSO, BodyTable, body_table
from planview.trajectories.state import TrackState
from stereo.depth import RectifiedGeometry

GEOMETRY = RectifiedGeometry(160, 120, 130.0, 130.0, 79.5, 59.5, 0.12)


def oblique_camera(
    height_m: float = 2.5,
    tilt_deg: float = 65.0,
    at_m: tuple[float, float] = (0.0, 0.0),
    turn_deg: float = 0.0,
    geometry: RectifiedGeometry = GEOMETRY,
) -> PixelRays:
    """A camera above a place; its axis is ``tilt_deg`` from straight down, towards y or turned counterclockwise."""
    a, turn = np.deg2rad([tilt_deg, turn_deg])
    forward = np.array([-np.sin(turn) * np.sin(a), np.cos(turn) * np.sin(a), -np.cos(a)])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    return PixelRays.of(geometry.above(SE3(rotation, np.array([*at_m, height_m]))), geometry)


def look_at(
    rays: PixelRays, people: Sequence[tuple[float, ...]], codes: Sequence[int] = (), table: BodyTable | None = None
) -> View:
    """People (x, y, height and, unless 0, facing and lean), or what else a table shows, before a floor without texture,
    each of one colour code."""
    kind = np.zeros(rays.shape, np.uint8)
    nearest = np.full(rays.shape, np.inf, np.float32)
    colour = np.zeros(rays.shape, np.uint8)
    for k, person in enumerate(people):
        cover, at = seen_body(rays, person, table)
        front = (cover > 0.5) & (at < nearest)
        nearest[front], kind[front] = at[front], SURFACE
        colour[front] = codes[k] if codes else 0
    sin = rays.level[..., 3]
    floor = np.divide(rays.centre_m[2], sin, out=np.zeros(rays.shape), where=sin > 1e-3)
    return View(rays, kind, np.where(kind == SURFACE, nearest, floor).astype(np.float32), colour)


def seen_body(rays: PixelRays, person: tuple[float, ...], table: BodyTable | None = None) -> tuple[F64, F64]:
    """Cover and range of one body on every ray, from the table, in plain numpy."""
    table, (x, y, h, facing, lean) = table or body_table(), (*person, 0.0, 0.0)[:5]
    ex, ey, cos, sin = np.moveaxis(rays.level[..., :4].astype(np.float64), -1, 0)
    dx, dy, dz = x - rays.centre_m[0], y - rays.centre_m[1], 0.5 * h - rays.centre_m[2]
    along, scale = dx * ex + dy * ey, TORSO.height_m / h
    angle = np.arctan2(sin, cos)
    a = np.clip(((angle - table.angle_min_rad) / table.angle_step_rad + 0.5).astype(int), 0, table.cover.shape[1] - 1)
    # From the left edge of the table on.
    u = np.floor((dx * ey - dy * ex) * scale / table.cell_m + table.cover.shape[2] // 2).astype(int)
    w = ((-(along * sin + dz * cos) * scale - table.w_min_m) / table.cell_m).astype(int)
    inside = (u >= 0) & (u < table.cover.shape[2]) & (w >= 0) & (w < table.cover.shape[3])
    u, w = np.where(inside, u, 0), np.where(inside, w, 0)
    way = np.rint((facing - np.arctan2(ey, ex)) * FACINGS / (2 * np.pi)).astype(int) % FACINGS
    p = (way + FACINGS * (lean > 0.5 * LEAN_M)) % len(table.cover)
    cover = np.where(inside, table.cover[p, a, u, w], 0.0)
    return cover, along * cos - dz * sin - table.front[p, a, u, w] / scale


def towards(rays: PixelRays) -> F64:
    """(H, W, 3) unit vectors away from the camera."""
    ex, ey, cos, sin = np.moveaxis(rays.level[..., :4].astype(np.float64), -1, 0)
    return np.stack([ex * cos, ey * cos, -sin], axis=-1)


def observed(frame: int, timestamp_s: float, *views: View) -> Observation:
    """An observation of what cameras saw."""
    return Observation(frame, timestamp_s, views=views)


def confirmed(states: Sequence[TrackState]) -> list[TrackState]:
    """Those of a frame who are confirmed."""
    return [state for state in states if state.state == "confirmed"]
