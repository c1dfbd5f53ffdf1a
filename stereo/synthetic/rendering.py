"""A scene rendered frame by frame, with calibration and exact truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from calib.camera import Camera
from calib.ground_camera import GroundCamera
from calib.pose import SE3
from calib.rig import StereoRig, world_from_plane
from calib.types import F32, U8
from stereo.synthetic.actors import Actor, Cast, furniture_at, place_mesh
from stereo.synthetic.furniture import furniture_mesh
from stereo.synthetic.layers import Layer, ViewRenderer
from stereo.synthetic.room import room_mesh
from stereo.synthetic.scene import Mount, Rig, Scene, SingleCamera
from stereo.synthetic.sensor import SensorModel
from stereo.synthetic.shapes import Mesh, join
from stereo.synthetic.texture import Palette
from stereo.synthetic.view import View, camera_view, ground_view

RENDERER_VERSION = 1
"""Raised whenever the pixels or the truth of any scene change: rendered recordings are cached by it."""


@dataclass(frozen=True)
class TruthRow:
    """One person in one frame: a row of ``truth.csv``.

    Attributes:
        x_m, y_m: vertical projection of the head's centre, canonical world frame [m].
        height_m: highest point of head and hair above the floor [m].
        visible: pixels that show the person over pixels of the whole person, hidden ones and ones outside the
            image included.
        box_px: left, top, width, height of the visible silhouette (unrectified image).
        full_box_px: the same of the whole silhouette inside the image, as if nothing hid it.
    """

    person: int
    x_m: float
    y_m: float
    height_m: float
    visible: float
    box_px: tuple[float, float, float, float]
    full_box_px: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class RenderedFrame:
    """Images and truth of one frame; ``right`` is None for a single camera.

    Attributes:
        depth: (H, W) float32 [m], exact, of the (left) image's pixel centres.
        owner: (H, W) int32: 0 the room, person ids, -1 moving things.
    """

    index: int
    timestamp_s: float
    left: U8
    right: U8 | None
    depth: F32
    owner: np.ndarray[tuple[int, ...], np.dtype[np.int32]]
    truth: tuple[TruthRow, ...]


class SceneRenderer:
    """Renders a scene; the same scene gives the same pixels.

    Attributes:
        rig: the true stereo rig, None for a single camera.
        ground_camera: the true single camera, None for a rig.
        world_SE3_room: canonical world of the rectified left camera (or of the single camera).
        world_SE3_left: placement of the rectified left camera in that world, None for a single camera.
    """

    def __init__(self, scene: Scene, scale: float = 1.0) -> None:
        self.scene = scene
        palette = Palette()
        room = room_mesh(scene.room, palette)
        self._cast = Cast(scene, palette)
        standing = [
            place_mesh(furniture_mesh(f, palette), *furniture_at(f, 0.0))
            for f, moving in zip(scene.furniture, self._cast.is_moving, strict=True)
            if not moving
        ]
        views = self._views(scale)
        static = join([room, *standing])
        shades = join(standing) if standing else None
        self._views_of = views
        self._renderers = [ViewRenderer(scene, v, static, shades, palette) for v in views]
        gain = scene.sensor.brightness / max(self._renderers[0].room_mean(), 1e-6)
        self._sensors = [
            SensorModel(scene.sensor, (v.height, v.width), gain, scene.seed, i) for i, v in enumerate(views)
        ]

    @property
    def n_frames(self) -> int:
        return self.scene.n_frames

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the images [px]."""
        return self._views_of[0].width, self._views_of[0].height

    @property
    def room_SE3_left(self) -> SE3:
        """The unrectified left (or single) camera in the room."""
        return self._views_of[0].room_SE3_camera

    def _views(self, scale: float) -> list[View]:
        mount = self.scene.mount
        width, height = max(8, round(mount.width * scale)), max(8, round(mount.height * scale))
        room_SE3_left = mount_pose(mount)
        if isinstance(mount, Rig):
            rig = stereo_rig(mount).scaled(width, height)
            self.rig: StereoRig | None = rig
            self.ground_camera: GroundCamera | None = None
            self.world_SE3_left: SE3 | None = rectified_world(rig, room_SE3_left)
            self.world_SE3_room = self.world_SE3_left @ rectifying(rig) @ room_SE3_left.inverse()
            right = room_SE3_left @ rig.right_SE3_left.inverse()
            return [camera_view(rig.left, room_SE3_left), camera_view(rig.right, right)]
        self.rig, self.world_SE3_left = None, None
        camera = ground_camera(mount).scaled(width, height)
        self.ground_camera = camera
        heading = math.radians(mount.heading_deg) - math.pi / 2
        turn = SE3.from_rotvec([0.0, 0.0, heading], [mount.at_m[0], mount.at_m[1], 0.0])
        self.world_SE3_room = turn.inverse()
        return [ground_view(camera, turn)]

    def __iter__(self) -> Iterator[RenderedFrame]:
        for index in range(self.n_frames):
            yield self.frame(index)

    def frame(self, index: int) -> RenderedFrame:
        """Frame ``index``, from 0; frames may be rendered in any order."""
        t = index / self.scene.fps
        actors = self._cast.at(t)
        layers = [r.render(actors, t) for r in self._renderers]
        images = [s(layer.linear, index, t) for s, layer in zip(self._sensors, layers, strict=True)]
        people = np.array([0, *(a.person or -1 for a in actors)], np.int32)
        truth = tuple(
            row for k, a in enumerate(actors) if a.person and (row := self._truth(a, k, layers[0])) is not None
        )
        right = images[1] if len(images) > 1 else None
        return RenderedFrame(index, t, images[0], right, layers[0].depth, people[layers[0].owner], truth)

    def _truth(self, actor: Actor, k: int, layer: Layer) -> TruthRow | None:
        mine = layer.owner == k + 1
        shown = int(mine.sum())
        if shown == 0 or actor.body is None:
            return None
        whole = layer.alone[k] + outside_pixels(self._views_of[0], actor.mesh)
        x, y, _ = self.world_SE3_room @ actor.body.head
        rows, cols = np.flatnonzero(mine.any(axis=1)), np.flatnonzero(mine.any(axis=0))
        box = (float(cols[0]), float(rows[0]), float(cols[-1] - cols[0] + 1), float(rows[-1] - rows[0] + 1))
        return TruthRow(
            actor.person, float(x), float(y), actor.body.top_m, min(1.0, shown / whole), box, layer.boxes[k]
        )


def outside_pixels(view: View, mesh: Mesh) -> float:
    """Pixels that a mesh would cover beyond the borders of the image."""
    from stereo.synthetic.tracing import Tracer

    local = view.room_SE3_camera.inverse() @ mesh.vertices.astype(np.float64)
    front = local[:, 2] > 0.15
    uv = np.full((len(local), 2), np.inf)
    uv[front] = local[front, :2] / local[front, 2:] * view.focal_px
    border = view.unproject(_border(view))[:, :2] * view.focal_px
    inner_low, inner_high = border.min(axis=0), border.max(axis=0)
    low = np.maximum(uv[front].min(axis=0), 3 * inner_low) if front.any() else inner_low
    high = np.minimum(uv[front].max(axis=0), 3 * inner_high) if front.any() else inner_high
    if (low >= inner_low).all() and (high <= inner_high).all():
        inside = view.project(local)
        size = [view.width - 0.5, view.height - 0.5]
        if np.isfinite(inside).all() and (inside > -0.5).all() and (inside < size).all():
            return 0.0
    step = 2.0
    u, v = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
    directions = np.column_stack([u.ravel(), v.ravel(), np.full(u.size, view.focal_px)]) / view.focal_px
    pixels = view.project(directions)
    radius = np.hypot(directions[:, 0], directions[:, 1])
    reach = float(np.hypot(border[:, 0], border[:, 1]).max()) / view.focal_px
    seen = ((pixels > -0.5) & (pixels < [view.width - 0.5, view.height - 0.5])).all(axis=1) & (radius <= reach)
    origin = np.broadcast_to(view.room_SE3_camera.translation, directions[~seen].shape)
    rays = np.concatenate([origin, directions[~seen] @ view.room_SE3_camera.rotation.T], axis=1).astype(np.float32)
    return float(Tracer(mesh).cast(rays).found.sum()) * step * step


def _border(view: View) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    w, h = view.width - 0.5, view.height - 0.5
    u, v = np.linspace(-0.5, w, 50), np.linspace(-0.5, h, 50)
    sides = [np.column_stack([u, np.full(50, y)]) for y in (-0.5, h)]
    sides += [np.column_stack([np.full(50, x), v]) for x in (-0.5, w)]
    return np.concatenate(sides)


def mount_pose(mount: Mount) -> SE3:
    """room_SE3_camera of a mount: x right, y down, z forward."""
    a, b = math.radians(mount.heading_deg), math.radians(mount.tilt_deg)
    ahead = np.array([math.cos(a), math.sin(a), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    forward = math.sin(b) * ahead - math.cos(b) * up
    right = np.cross(ahead, up)
    down = np.cross(forward, right)
    rotation = np.column_stack([right, down, forward])
    roll, _ = cv2.Rodrigues(np.array([0.0, 0.0, math.radians(mount.roll_deg)]))
    return SE3(rotation @ roll, np.array(mount.at_m))


def stereo_rig(mount: Rig) -> StereoRig:
    """The rig's true calibration."""
    cx, cy = (mount.width - 1) / 2, (mount.height - 1) / 2
    ox, oy = mount.centre_offset_px
    k = tuple(mount.distortion)
    fx, fy = mount.focal_px, mount.focal_px * mount.aspect
    left = Camera(mount.width, mount.height, fx, fy, cx + ox, cy + oy, "brown", k)
    right = Camera(mount.width, mount.height, fx, fy, cx - ox, cy - oy, "brown", tuple(0.97 * c for c in k))
    left_SE3_right = SE3.from_rotvec(np.deg2rad(mount.right_rotation_deg), [mount.baseline_m, *mount.right_offset_m])
    return StereoRig(left, right, left_SE3_right.inverse(), "rendered")


def ground_camera(mount: SingleCamera) -> GroundCamera:
    """The single camera's true calibration."""
    return GroundCamera(
        mount.width, mount.height, mount.focal_px, mount.at_m[2], math.radians(mount.tilt_deg), mount.lens
    )


def rectifying(rig: StereoRig) -> SE3:
    """rectified_SE3_left: the rotation of the left camera that cv2.stereoRectify chooses."""
    r1 = cv2.stereoRectify(
        rig.left.matrix, rig.left.coefficients, rig.right.matrix, rig.right.coefficients, rig.left.size,
        rig.right_SE3_left.rotation, rig.right_SE3_left.translation.reshape(3, 1),
    )[0]  # fmt: skip
    return SE3(np.asarray(r1, np.float64), np.zeros(3))


def rectified_world(rig: StereoRig, room_SE3_left: SE3) -> SE3:
    """world_SE3_left of the rectified left camera."""
    rectified_SE3_room = rectifying(rig) @ room_SE3_left.inverse()
    normal = rectified_SE3_room.rotation @ np.array([0.0, 0.0, 1.0])
    return world_from_plane(normal, float(room_SE3_left.translation[2]))
