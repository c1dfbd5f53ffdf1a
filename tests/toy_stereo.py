"""A tiny exact stereo world for tests: a textured floor, a wall and upright cards for people, ray by ray."""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from calib.camera import Camera
from calib.pose import SE3
from calib.rig import StereoRig, save_rig
from calib.types import F64, U8

SIZE = (320, 240)


def toy_rig(
    size: tuple[int, int] = SIZE,
    focal_px: float = 230.0,
    baseline_m: float = 0.12,
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    distortion: tuple[float, ...] = (),
) -> StereoRig:
    """A pair whose right camera is turned by some degrees about x, y and z."""
    width, height = size
    model = "rational" if len(distortion) > 5 else "brown"
    camera = Camera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, model, distortion)
    turn = SE3.from_rotvec(np.radians(rotation_deg))
    return StereoRig(camera, camera, SE3(turn.rotation, turn.rotation @ np.array([-baseline_m, 0.0, 0.0])), "toy")


NECK, HEAD = 0.85, 0.4
"""Where a card's head begins, of its height, and how wide it is, of the card's width."""


@dataclass(frozen=True)
class Card:
    """An upright body cut out of card, facing the camera: x to the right, y ahead of the camera's foot point [m]."""

    x_m: float
    y_m: float
    height_m: float = 1.75
    width_m: float = 0.5


@dataclass
class ToyWorld:
    """What there is to see.

    Attributes:
        contrast: standard deviation of the textures [grey levels]; floor_contrast the floor's own.
    """

    camera_height_m: float = 2.5
    tilt_deg: float = 50.0
    wall_y_m: float = 7.0
    contrast: float = 35.0
    floor_contrast: float = 35.0
    noise: float = 1.0
    seed: int = 0
    texture: F64 = field(init=False)

    def __post_init__(self) -> None:
        noise = np.random.default_rng(self.seed).normal(size=(1024, 1024))
        tiled = np.tile(noise, (2, 2)).astype(np.float32)
        smooth = cv2.GaussianBlur(tiled, (0, 0), 2.0) + 2.0 * cv2.GaussianBlur(tiled, (0, 0), 8.0)
        smooth = smooth[512:1536, 512:1536]
        self.texture = np.asarray((smooth - smooth.mean()) / smooth.std(), dtype=np.float32)

    @property
    def world_SE3_left(self) -> SE3:
        """The unrectified left camera above the floor: x right, y ahead, z up."""
        t = np.radians(self.tilt_deg)
        rotation = np.array([[1, 0, 0], [0, -np.cos(t), np.sin(t)], [0, -np.sin(t), -np.cos(t)]])
        return SE3(rotation, np.array([0.0, 0.0, self.camera_height_m]))

    def pair(self, rig: StereoRig, cards: tuple[Card, ...] = (), frame: int = 0) -> tuple[U8, U8]:
        """Left and right grey images."""
        right = self.world_SE3_left @ rig.right_SE3_left.inverse()
        rng = np.random.default_rng((self.seed, frame))
        return (self._image(rig.left, self.world_SE3_left, cards, rng), self._image(rig.right, right, cards, rng))

    def _image(self, camera: Camera, world_SE3_camera: SE3, cards: tuple[Card, ...], rng: np.random.Generator) -> U8:
        rays = _rays(camera) @ world_SE3_camera.rotation.T
        origin = world_SE3_camera.translation
        with np.errstate(divide="ignore", invalid="ignore"):
            floor = np.where(rays[:, 2] < 0, -origin[2] / rays[:, 2], np.inf)
            wall = np.where(rays[:, 1] > 0, (self.wall_y_m - origin[1]) / rays[:, 1], np.inf)
        depth, layer = np.minimum(floor, wall), np.where(floor < wall, 0, 1)
        for number, card in enumerate(cards):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (card.y_m - origin[1]) / rays[:, 1]
            hit = origin + rays * t[:, None]
            half = np.where(hit[:, 2] > NECK * card.height_m, HEAD * card.width_m, card.width_m) / 2
            inside = (t > 0) & (t < depth) & (np.abs(hit[:, 0] - card.x_m) < half)
            inside &= (hit[:, 2] > 0) & (hit[:, 2] < card.height_m)
            depth, layer = np.where(inside, t, depth), np.where(inside, 2 + number, layer)
        points = origin + rays * depth[:, None]
        for number, card in enumerate(cards):
            points[layer == 2 + number, 0] -= card.x_m
        return self._shade(points, layer, rng).reshape(camera.height, camera.width)

    def _shade(self, points: F64, layer: F64, rng: np.random.Generator) -> U8:
        along = np.where(layer == 0, points[:, 1], points[:, 2])
        column = ((points[:, 0] * 100.0 + 137.0 * layer) % 1024).astype(np.float32)
        row = ((along * 100.0 + 59.0 * layer) % 1024).astype(np.float32)
        rows = [a.reshape(-1, 64) for a in (column, row)]  # remap takes at most 32767 rows
        value = cv2.remap(self.texture, *rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP).reshape(-1)
        contrast = np.where(layer == 0, self.floor_contrast, self.contrast)
        shade = 120.0 + contrast * value + 25.0 * (layer >= 2)
        return np.clip(shade + rng.normal(size=shade.shape) * self.noise, 0, 255).astype(np.uint8)


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> F64:
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return camera.unproject(np.column_stack([u.ravel(), v.ravel()]))


def walking(frame: int, fps: float = 15.0) -> tuple[Card, ...]:
    """One person of 1.75 m who crosses the view at 1.2 m/s, unevenly as people walk, swaying to and from the camera."""
    t = frame / fps
    return (Card(-1.2 + 1.2 * t + 0.06 * np.sin(12.0 * t), 3.0 + 0.15 * np.sin(7.0 * t)),)


def write_toy_recording(
    folder: Path, rig: StereoRig, pairs: list[tuple[U8, U8]], fps: float = 15.0, claimed: StereoRig | None = None
) -> Path:
    """A recording folder of PNG images; ``claimed`` is the calibration written next to them instead of the true one."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    for index, (left, right) in enumerate(pairs):
        cv2.imwrite(str(folder / "left" / f"{index:06d}.png"), left)
        cv2.imwrite(str(folder / "right" / f"{index:06d}.png"), right)
    rows = [f"{index},{index / fps:.6f}" for index in range(len(pairs))]
    (folder / "timestamps.csv").write_text("\n".join(["frame,timestamp_s", *rows]) + "\n")
    save_rig(claimed or rig, folder / "rig.toml")
    return folder
