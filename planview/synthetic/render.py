"""A scene rendered frame by frame, with sensor, calibration and exact truth."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from calib.pose import SE3
from calib.types import F32, F64, I32, U8, Bool
from planview.synthetic.camera import CameraView, placed_cameras
from planview.synthetic.layers import Box, Layer, ViewRenderer
from planview.synthetic.light import Tracer, level_at
from planview.synthetic.mesh import Mesh, join
from planview.synthetic.people import Actor, Cast, furniture_at, place_mesh
from planview.synthetic.room import furniture_mesh, room_mesh
from planview.synthetic.scene import Capture, ImageSensor, Scene
from planview.synthetic.texture import Palette

_BANK = 1 << 21
"""Normal numbers of a sensor; a frame takes them from another place each."""
RENDERER_VERSION = 2
"""Raised whenever the pixels or the truth of any scene change: rendered recordings are cached by it."""
STEP_PX = 2.0
"""Outside the image, every second pixel of a person is counted."""


class SensorModel:
    """One camera's sensor; its noise depends only on the seed, the camera and the frame."""

    def __init__(
        self,
        sensor: ImageSensor,
        shape: tuple[int, int],
        gain: float,
        seed: tuple[int, int],
        capture: Capture | None = None,
    ) -> None:
        """``gain`` scales linear light to 1 at full scale; ``shape`` is (H, W); the last of ``seed`` is the camera."""
        self._capture = capture or Capture()
        self._sensor = sensor
        self._empty_level = sensor.brightness
        self._gain = gain * (1.0 + seed[1] * sensor.mismatch)
        self._seed = seed
        self._bank = np.random.default_rng([*seed, 17]).standard_normal(_BANK, np.float32)
        height, width = shape
        v, u = np.mgrid[:height, :width]
        off_centre = (u - (width - 1) / 2) ** 2 + (v - (height - 1) / 2) ** 2
        share = off_centre / ((width / 2) ** 2 + (height / 2) ** 2)
        self._vignette = (1.0 - sensor.vignetting * share).astype(np.float32)[:, :, None]
        level = np.linspace(0, 1, 4096)
        srgb = np.where(level <= 0.0031308, 12.92 * level, 1.055 * level ** (1 / 2.4) - 0.055)
        self._curve = np.round(255 * srgb).astype(np.uint8)

    def __call__(self, linear: F32, frame: int, t: float) -> U8:
        """(H, W, 3) uint8, or (H, W) for a grey sensor."""
        sensor = self._sensor
        gain = np.float32(self._gain * level_at(sensor.exposure, t))
        light = self._automatic(linear * (self._vignette * gain))
        if sensor.blur_px > 0:
            light = np.asarray(cv2.GaussianBlur(light, (0, 0), sensor.blur_px), np.float32)
        if sensor.grey:
            light = (light @ np.array([0.114, 0.587, 0.299], np.float32))[:, :, None]
        # A longer exposure counts more electrons, gain steps are rare in practice: noise is of the full well.
        variance = np.maximum(light, 0) * sensor.full_well_e + sensor.read_noise_e**2
        sigma = np.sqrt(variance) / np.float32(sensor.full_well_e)
        noisy = light + sigma * self._noise(light.shape, frame)
        level = np.clip(noisy * 4095 + 0.5, 0, 4095).astype(np.int32)
        image = self._curve[level]
        if sensor.grey:
            image = image[:, :, 0]
        return self._compress(np.ascontiguousarray(image))

    def _noise(self, shape: tuple[int, ...], frame: int) -> F32:
        """Normal numbers from the bank, from other places in each frame."""
        rng = np.random.default_rng([*self._seed, frame])
        numbers = np.empty(math.prod(shape), np.float32)
        filled = 0
        while filled < len(numbers):
            start = int(rng.integers(0, _BANK))
            count = min(len(numbers) - filled, _BANK - start)
            numbers[filled : filled + count] = self._bank[start : start + count]
            filled += count
        return numbers.reshape(shape)

    def _automatic(self, light: F32) -> F32:
        """Exposure and colours as the camera's automatics set them for this frame."""
        capture = self._capture
        if capture.auto_exposure > 0:
            level = max(float(light.mean()), 1e-4)
            gain = (self._empty_level / level) ** capture.auto_exposure
            light = light * np.float32(gain)
        if capture.auto_white_balance > 0:
            means = np.maximum(light.mean(axis=(0, 1)), 1e-4)
            gains = (means.mean() / means) ** capture.auto_white_balance
            light = light * gains.astype(np.float32)
        return light

    def _compress(self, image: U8) -> U8:
        quality = self._capture.jpeg_quality
        if not quality:
            return image
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), dtype=np.uint8)


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
    owner: I32
    truth: tuple[TruthRow, ...]


class SceneRenderer:
    """Renders a scene; the same scene gives the same pixels.

    Attributes:
        rig: the true stereo rig, None for a single camera.
        ground_camera: the true single camera, None for a rig.
        world_SE3_room: canonical world of the rectified left camera (or of the single camera).
        world_SE3_left: placement of the rectified left camera in that world, None for a single camera.
    """

    def __init__(self, scene: Scene, scale: float = 1.0, start_s: float = 0.0) -> None:
        """Args: scale is a factor on the image size, start_s the time in the scene of the first frame [s]."""
        self.scene = scene
        self._start_s = start_s
        palette = Palette()
        room = room_mesh(scene.room, palette)
        self._cast = Cast(scene, palette)
        standing = []
        for item, moves in zip(scene.furniture, self._cast.is_moving, strict=True):
            if not moves:
                standing.append(place_mesh(furniture_mesh(item, palette), *furniture_at(item, 0.0)))
        static = join([room, *standing])
        shades = join(standing) if standing else None
        placed = placed_cameras(scene.mount, scale)
        self._views = placed.views
        self.rig = placed.rig
        self.ground_camera = placed.ground_camera
        self.world_SE3_room = placed.world_SE3_room
        self.world_SE3_left = placed.world_SE3_left
        self._renderers = [ViewRenderer(scene, view, static, shades, palette) for view in self._views]
        gain = scene.sensor.brightness / max(self._renderers[0].room_mean(), 1e-6)
        self._sensors = []
        for i, view in enumerate(self._views):
            shape = view.height, view.width
            self._sensors.append(SensorModel(scene.sensor, shape, gain, (scene.seed, i), scene.capture))

    @property
    def n_frames(self) -> int:
        return max(1, self.scene.n_frames - round(self._start_s * self.scene.fps))

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the images [px]."""
        return self._views[0].width, self._views[0].height

    @property
    def room_SE3_left(self) -> SE3:
        """The unrectified left (or single) camera in the room."""
        return self._views[0].room_SE3_camera

    def frame(self, index: int) -> RenderedFrame:
        """Frame ``index``, from 0; frames may be rendered in any order."""
        time_s = index / self.scene.fps
        t = self._start_s + time_s
        actors = self._cast.at(t)
        layers = [renderer.render(actors, t) for renderer in self._renderers]
        linear = self._expose([layer.linear for layer in layers], t)
        images = [sensor(light, index, t) for sensor, light in zip(self._sensors, linear, strict=True)]
        first = layers[0]
        truth = []
        for k, actor in enumerate(actors):
            row = truth_row(actor, k, first, self._views[0], self.world_SE3_room)
            if row is not None:
                truth.append(row)
        right = images[1] if len(images) > 1 else None
        owner = _owners(actors)[first.owner]
        return RenderedFrame(index, time_s, images[0], right, first.depth, owner, tuple(truth))

    def owner(self, index: int) -> I32:
        """(H, W) int32, ``RenderedFrame.owner`` of frame ``index`` without rendering its light."""
        actors = self._cast.at(self._start_s + index / self.scene.fps)
        return _owners(actors)[self._renderers[0].owner(actors)]

    def _expose(self, middle: list[F32], t: float) -> list[F32]:
        """Light over the time of the exposure: the mean of its beginning, middle and end."""
        shutter = self.scene.capture.shutter_s if self.scene.capture else 0.0
        if shutter == 0:
            return middle
        before = self._cast.at(max(0.0, t - 0.5 * shutter))
        after = self._cast.at(max(0.0, t + 0.5 * shutter))
        means = []
        for renderer, light in zip(self._renderers, middle, strict=True):
            first = renderer.render(before, t).linear
            last = renderer.render(after, t).linear
            means.append(np.asarray((light + first + last) / np.float32(3)))
        return means


def _owners(actors: list[Actor]) -> I32:
    """(A + 1,) owner of the pixels of the room and of each actor."""
    return np.array([0, *(a.person or -1 for a in actors)], np.int32)


def truth_row(actor: Actor, k: int, layer: Layer, view: CameraView, world_SE3_room: SE3) -> TruthRow | None:
    """Truth of the k-th actor of a frame; None for things and for people of whom no pixel shows."""
    is_shown = layer.owner == k + 1
    shown = int(is_shown.sum())
    if shown == 0 or actor.body is None:
        return None
    whole = layer.alone[k] + outside_pixels(view, actor.mesh)
    x, y, _ = (world_SE3_room @ actor.body.head).tolist()
    ahead = world_SE3_room.rotation @ actor.body.chest
    left, top, width, height = map(float, cv2.boundingRect(is_shown.astype(np.uint8)))
    return TruthRow(
        person=actor.person,
        x_m=x,
        y_m=y,
        height_m=actor.body.top_m,
        visible=min(1.0, shown / whole),
        facing_deg=math.degrees(math.atan2(ahead[1], ahead[0])),
        box_px=(left, top, width, height),
        full_box_px=layer.boxes[k],
    )


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
    columns = np.arange(low[0], high[0], step)
    rows = np.arange(low[1], high[1], step)
    x, y = (grid.ravel() for grid in np.meshgrid(columns, rows))
    directions = np.column_stack([x, y, np.ones(x.size)])
    # Beyond the corners a lens model may fold back into the image.
    reach = float(np.hypot(border[:, 0], border[:, 1]).max())
    is_seen = _inside(view, view.project(directions)) & (np.hypot(x, y) <= reach)
    beyond = directions[~is_seen] @ view.room_SE3_camera.rotation.T
    origin = np.broadcast_to(view.room_SE3_camera.translation, beyond.shape)
    rays = np.concatenate([origin, beyond], axis=1).astype(np.float32)
    n_hits = int(Tracer(mesh).cast(rays).is_hit.sum())
    return float(n_hits) * STEP_PX**2


def _inside(view: CameraView, pixels: F64) -> Bool:
    """(N,) mask of the pixels (N, 2) that are in the image."""
    with np.errstate(invalid="ignore"):
        is_inside = (pixels > -0.5) & (pixels < [view.width - 0.5, view.height - 0.5])
    return np.asarray(is_inside.all(axis=1))


def _border(view: CameraView) -> F64:
    """Pixels along the outer edges of the image."""
    right = view.width - 0.5
    bottom = view.height - 0.5
    corners = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom], [-0.5, -0.5]])
    edges = [np.linspace(first, last, 50) for first, last in itertools.pairwise(corners)]
    return np.concatenate(edges)
