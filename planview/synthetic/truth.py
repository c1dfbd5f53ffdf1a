"""Exact truth of a rendered frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.pose import SE3
from calib.types import F64, Bool
from planview.synthetic.camera import CameraView
from planview.synthetic.layers import Box, Layer
from planview.synthetic.light import Tracer
from planview.synthetic.mesh import Mesh
from planview.synthetic.people import Actor

STEP_PX = 2.0
"""Outside the image, every second pixel of a person is counted."""


@dataclass(frozen=True)
class TruthRow:
    """One person in one frame: a row of ``truth.csv``.

    Attributes:
        x_m, y_m: vertical projection of the head's centre, canonical world frame [m].
        height_m: highest point of head and hair above the floor [m].
        visible: pixels that show the person over pixels of the whole person, hidden ones and ones outside the
            image included; what is carried, pushed or sat in belongs to the person.
        facing_deg: where the chest points on the floor, 0 along X and 90 along Y.
        box_px: left, top, width, height of the visible silhouette (unrectified image).
        full_box_px: the same of the whole silhouette inside the image, as if nothing hid it.
    """

    person: int
    x_m: float
    y_m: float
    height_m: float
    visible: float
    facing_deg: float
    box_px: Box
    full_box_px: Box


def truth_row(actor: Actor, k: int, layer: Layer, view: CameraView, world_SE3_room: SE3) -> TruthRow | None:
    """Truth of the k-th actor of a frame; None for things and for people of whom no pixel shows."""
    mine = layer.owner == k + 1
    shown = int(mine.sum())
    if shown == 0 or actor.body is None:
        return None
    whole = layer.alone[k] + outside_pixels(view, actor.mesh)
    x, y, _ = world_SE3_room @ actor.body.head
    ahead = world_SE3_room.rotation @ actor.body.chest
    facing_deg = math.degrees(math.atan2(ahead[1], ahead[0]))
    rows, cols = np.flatnonzero(mine.any(axis=1)), np.flatnonzero(mine.any(axis=0))
    box = (float(cols[0]), float(rows[0]), float(cols[-1] - cols[0] + 1), float(rows[-1] - rows[0] + 1))
    visible = min(1.0, shown / whole)
    return TruthRow(actor.person, float(x), float(y), actor.body.top_m, visible, facing_deg, box, layer.boxes[k])


def outside_pixels(view: CameraView, mesh: Mesh) -> float:
    """Pixels that a mesh would cover beyond the borders of the image, on the plane of an ideal pinhole."""
    local = view.room_SE3_camera.inverse() @ mesh.vertices.astype(np.float64)
    if _inside(view, view.project(local)).all():
        return 0.0
    border = view.unproject(_border(view))[:, :2]
    # Parts of a body nearer to the camera's plane are not counted.
    front = local[:, 2] > 0.15
    if not front.any():
        return 0.0
    # What reaches next to or behind the camera has no end on the plane: count three images' widths.
    on_plane = local[front, :2] / local[front, 2:]
    low = np.maximum(on_plane.min(axis=0), 3 * border.min(axis=0))
    high = np.minimum(on_plane.max(axis=0), 3 * border.max(axis=0))
    step = STEP_PX / view.focal_px
    x, y = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
    directions = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    # Beyond the corners a lens model may fold back into the image.
    reach = float(np.hypot(border[:, 0], border[:, 1]).max())
    seen = _inside(view, view.project(directions)) & (np.hypot(directions[:, 0], directions[:, 1]) <= reach)
    beyond = directions[~seen] @ view.room_SE3_camera.rotation.T
    origin = np.broadcast_to(view.room_SE3_camera.translation, beyond.shape)
    rays = np.concatenate([origin, beyond], axis=1).astype(np.float32)
    return float(Tracer(mesh).cast(rays).found.sum()) * STEP_PX**2


def _inside(view: CameraView, pixels: F64) -> Bool:
    """(N,) whether pixels (N, 2) are in the image."""
    with np.errstate(invalid="ignore"):
        return np.asarray(((pixels > -0.5) & (pixels < [view.width - 0.5, view.height - 0.5])).all(axis=1))


def _border(view: CameraView) -> F64:
    """Pixels along the outer edges of the image."""
    w, h = view.width - 0.5, view.height - 0.5
    u, v = np.linspace(-0.5, w, 50), np.linspace(-0.5, h, 50)
    sides = [np.column_stack([u, np.full(50, y)]) for y in (-0.5, h)]
    sides += [np.column_stack([np.full(50, x), v]) for x in (-0.5, w)]
    return np.concatenate(sides)
