"""Crowds of any size before a camera above a hall, as images and disparities, to time what comes after these."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from calib.camera import Camera
from calib.pose import SE3
from calib.rig import Floor, StereoRig, world_from_plane
from calib.types import F64, U8
from planview.engine.config import Config
from planview.engine.frames import MatchedFrame
from planview.engine.pipeline import Pipeline
from planview.engine.setup import Setup
from stereo.depth import RectifiedGeometry
from stereo.matcher import disparity_range
from stereo.recording import Skipped, StereoFrame
from stereo.rectify import Rectifier
from stereo.row_offset import VerticalFit

SIZE = (320, 240)
FPS = 15.0
FOCAL_PX, BASELINE_M = 200.0, 0.5
HEIGHT_M, TILT_DEG = 9.0, 20.0
"""The camera hangs so high that 50 people fit into its view, and leans so little that they hide one another little."""
EMPTY = 30
"""Frames before anyone is there: the background is learned."""
ROWS, SPACING_M = 5, 1.5
"""People keep to places of a grid, so that all stay tracked (our choice)."""
REACH_M = 0.35
"""Half the way that each walks to and fro around the place."""
NOISE_PX = 0.1
"""Deviation of the disparity."""


class Person(NamedTuple):
    """An upright ellipsoid on the floor, (x, y, z) of its centre and its half axes [m], and a colour."""

    centre: F64
    axes: F64
    colour: F64


class EmptyRecording:
    """A ``Recording`` without frames, for a pipeline that is given its frames."""

    path = Path("crowd")
    fps = FPS
    n_frames = 0

    def __init__(self, rig: StereoRig) -> None:
        self.rig, self.skipped = rig, list[Skipped]()
        self.world_SE3_left: SE3 | None = None

    def __iter__(self) -> Iterator[StereoFrame]:
        return iter(())

    def sample(self, count: int) -> list[StereoFrame]:
        """None."""
        return []


def crowd_rig() -> StereoRig:
    """Two cameras without distortion."""
    camera = Camera(*SIZE, FOCAL_PX, FOCAL_PX, (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)
    return StereoRig(camera, camera, SE3(np.eye(3), np.array([-BASELINE_M, 0.0, 0.0])), "crowd")


def crowd_pipeline() -> Pipeline:
    """An engine at 320x240 whose camera is known."""
    rig = crowd_rig()
    config = Config.model_validate({"rectify": {"working_px": SIZE[0]}, "analysis": {"width_px": SIZE[0]}})
    rectifier = Rectifier(rig, config.rectify)
    tilt = math.radians(TILT_DEG)
    floor = Floor(world_from_plane(np.array([0.0, -math.sin(tilt), -math.cos(tilt)]), HEIGHT_M))
    disparities = disparity_range(rectifier.geometry, config.range, floor)
    return Pipeline(EmptyRecording(rig), Setup(rectifier, floor, disparities, "crowd", VerticalFit()), config)


class Crowd:
    """So many people who walk to and fro, as matched frames.

    Args:
        pipeline: of ``crowd_pipeline``.
    """

    def __init__(self, pipeline: Pipeline, people: int, seed: int = 0) -> None:
        view = pipeline.stereo
        self._geometry, self._pose = view.geometry, view.floor.world_SE3_left
        self._rng = np.random.default_rng(seed)
        self._rays = _rays(self._geometry) @ self._pose.rotation.T
        depth = -self._pose.translation[2] / self._rays[..., 2]  # of the floor
        self._floor: F64 = self._geometry.disparity_metre / depth
        height, width = self._floor.shape
        texture = cv2.GaussianBlur(self._rng.uniform(60, 190, (height, width, 3)), (5, 5), 1.5)
        self._image = np.asarray(texture, dtype=np.float64)
        centre = self._pose @ (depth[height // 2, width // 2] * np.array([0.0, 0.0, 1.0]))
        columns = -(-max(people, 1) // ROWS)
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(ROWS)), -1).transpose(1, 0, 2).reshape(-1, 2)
        middle = (np.array([columns, ROWS]) - 1) / 2
        self._places = centre[:2] + SPACING_M * (grid - middle)[:people]
        self._phases, self._headings = self._rng.uniform(0, 2 * np.pi, (2, people))
        self._heights = self._rng.uniform(1.55, 1.9, people)
        self._colours = self._rng.uniform(20, 235, (people, 3))

    def frames(self, count: int) -> Iterator[MatchedFrame]:
        """So many frames, the first EMPTY of them without anyone."""
        for i in range(count):
            image, disparity = self._image.copy(), self._floor.astype(np.float64)
            for person in self._people(i / FPS) if i >= EMPTY else ():
                self._paint(person, image, disparity)
            image += self._rng.normal(0, 2.5, image.shape)
            disparity += self._rng.normal(0, NOISE_PX, disparity.shape)
            grey: U8 = np.clip(image, 0, 255).astype(np.uint8)
            yield MatchedFrame(i, i / FPS, grey, disparity.astype(np.float32), {}, None)

    def _people(self, time_s: float) -> Iterator[Person]:
        for place, phase, heading, height, colour in zip(
            self._places, self._phases, self._headings, self._heights, self._colours, strict=True
        ):
            shift = REACH_M * math.sin(time_s * 1.5 + phase)
            x, y = place + shift * np.array([math.cos(heading), math.sin(heading)])
            yield Person(np.array([x, y, height / 2]), np.array([0.25, 0.25, height / 2]), colour)

    def _paint(self, person: Person, image: F64, disparity: F64) -> None:
        """Where rays meet the ellipsoid, in place: (o + t r - c) / a has length 1, and t is the depth."""
        top, bottom, left, right = self._box(person)
        rays = self._rays[top:bottom, left:right] / person.axes
        offset = (self._pose.translation - person.centre) / person.axes
        a, b, c = (rays**2).sum(-1), (rays * offset).sum(-1), float(offset @ offset) - 1.0
        root = b * b - a * c
        hit = root > 0
        depth = (-b - np.sqrt(np.where(hit, root, 0.0))) / a
        nearer = self._geometry.disparity_metre / np.maximum(depth, 0.1)
        part = disparity[top:bottom, left:right]
        hit &= nearer > part
        part[hit] = nearer[hit]
        image[top:bottom, left:right][hit] = person.colour

    def _box(self, person: Person) -> tuple[int, int, int, int]:
        """Rows and columns that the ellipsoid may cover."""
        corners = person.centre + person.axes * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        p = self._pose.inverse() @ corners
        u = self._geometry.focal_u_px * p[:, 0] / p[:, 2] + self._geometry.cu_px
        v = self._geometry.focal_v_px * p[:, 1] / p[:, 2] + self._geometry.cv_px
        height, width = self._floor.shape
        top, bottom = np.clip([math.floor(v.min()), math.ceil(v.max()) + 1], 0, height)
        left, right = np.clip([math.floor(u.min()), math.ceil(u.max()) + 1], 0, width)
        return int(top), int(bottom), int(left), int(right)


def _rays(geometry: RectifiedGeometry) -> F64:
    """(H, W, 3) of depth 1, camera frame."""
    u, v = np.meshgrid(np.arange(geometry.width), np.arange(geometry.height))
    x, y = (u - geometry.cu_px) / geometry.focal_u_px, (v - geometry.cv_px) / geometry.focal_v_px
    return np.stack([x, y, np.ones_like(x)], axis=-1)
