"""A small exact recording of images with depth: a floor, and a round person in a long coat who walks to the right."""

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from calib.camera import Camera
from calib.pose import SE3
from calib.rig import world_from_plane
from calib.types import F64

CAMERA = Camera(160, 120, 130.0, 130.0, 79.5, 59.5)
HEIGHT_M, TILT_DEG = 2.5, 55.0
EMPTY, FRAMES, FPS = 12, 36, 10.0


def world_SE3_camera() -> SE3:
    """The camera above the floor."""
    tilt = np.radians(TILT_DEG)
    return world_from_plane(np.array([0.0, -np.sin(tilt), -np.cos(tilt)]), HEIGHT_M)


def walker_m(frame: int) -> tuple[float, float]:
    """Where the person stands [m]; from frame EMPTY on."""
    return -1.2 + 0.1 * (frame - EMPTY), 3.0


@cache
def _rays() -> F64:
    """(N, 3) rays of all pixels at unit depth, in world directions."""
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = CAMERA.unproject(np.column_stack([columns.ravel(), rows.ravel()]))
    return rays @ world_SE3_camera().rotation.T


def depth_image(frame: int) -> F64:
    """(H, W) depth [m] of floor and person."""
    pose, rays = world_SE3_camera(), _rays()
    depth = np.where(rays[:, 2] < -1e-3, -HEIGHT_M / rays[:, 2], np.inf)
    if frame >= EMPTY:
        x, y = walker_m(frame)
        at = (y - pose.translation[1]) / rays[:, 1]
        hit = rays * at[:, None] + pose.translation
        half = np.where(hit[:, 2] > 0.85 * 1.75, 0.09, 0.22)
        at -= np.sqrt(np.clip(half**2 - (hit[:, 0] - x) ** 2, 0.0, None)) / rays[:, 1]  # round
        on = (np.abs(hit[:, 0] - x) < half) & (hit[:, 2] > 0) & (hit[:, 2] < 1.75) & (at > 0)
        depth = np.where(on & (at < depth), at, depth)
    return depth.reshape(CAMERA.height, CAMERA.width)


def write_toy_rgbd(folder: Path) -> Path:
    """rgb/ and depth/ in millimetres with noise, timestamps and calibration."""
    rng = np.random.default_rng(5)
    texture = rng.integers(60, 180, (CAMERA.height, CAMERA.width, 3))
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for frame in range(FRAMES):
        depth = depth_image(frame)
        person = np.isfinite(depth) & (depth < depth_image(0) - 0.05)
        image = np.where(person[..., None], (40, 40, 160), texture) + rng.normal(0, 1.5, texture.shape)
        noisy = depth + 1.4e-3 * depth**2 * rng.standard_normal(depth.shape)
        stored = np.where(np.isfinite(depth) & (depth < 9), noisy * 1000, 0).round().astype(np.uint16)
        cv2.imwrite(str(folder / "rgb" / f"{frame:03d}.png"), image.clip(0, 255).astype(np.uint8))
        cv2.imwrite(str(folder / "depth" / f"{frame:03d}.png"), stored)
    fields = ("fx", "fy", "cx", "cy", "width", "height")
    (folder / "camera.json").write_text(json.dumps({name: getattr(CAMERA, name) for name in fields}))
    times = "".join(f"{frame},{frame / FPS:.3f}\n" for frame in range(FRAMES))
    (folder / "timestamps.csv").write_text("frame,timestamp_s\n" + times)
    return folder
