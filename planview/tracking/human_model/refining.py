"""Laying a model on the ends of a body, and learning how tall the person is (the paper's "refine target")."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.types import F64, U8
from planview.tracking.human_model.measurement import Extent
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import SEARCH_SIGMAS, ModelScene
from planview.tracking.human_model.target import Build, Target

END = 0.25
"""Part of a model that tells where its end is (our choice): head and shoulders, or feet and shins."""
MAX_COVERED = 0.1
"""Part of an end that others may cover or the scene hide while it tells where the body ends (our choice)."""
SHORTER = 0.05
"""By how much a body may differ from its person's height while both ends show, as a fraction of it. Our choice: a
step, and a bin of the extent."""
FEET = 0.15
"""How far a body may end from its feet, as a fraction of the height (our choice): half a step."""
MAX_DEVIATION = 0.12
"""Largest deviation of a measured height from the average, as a fraction of it: two standard deviations of adults."""

BOB = 0.03
"""Standard deviation of the head's height, as a fraction of the person's (our choice): 2 to 5 cm of a step."""

TILT_RAD = math.radians(0.5)
"""Standard deviation of the camera's tilt [rad] (our choice): what calibrations from different people differ by."""


STEP = 0.05
"""Standard deviation of where the feet of a walker end, as a fraction of the height. Our choice: a third of half a
step; with twice as much or half of it no figure changes."""
HEIGHT = 0.06
"""Standard deviation of people's heights, as a fraction of the average: adults."""
NEAREST = 0.9
"""Largest difference of the distances of foot and head over the foot's that is reckoned with (our choice)."""


class Ends(NamedTuple):
    """What the ends of a body tell, as fractions of the height of its model.

    With the foot a way up the axis, the head is (1 - h / H) (Z_foot / Z_head)^2 times as far up, and a height larger by
    a share raises it by Z_foot / Z_head times that: h and H the heights of person and camera, Z distances from the
    camera's plane. So a camera that hangs no higher than heads tells distances by the feet alone: a model that ends
    too low and too high is too near there, and not only too tall.

    Attributes:
        shift: how far up the axis the foot is.
        height: the person's, where the feet are.
    """

    shift: float
    height: float


class Refiner:
    """Moves measured foot pixels so that head and feet of the models lie where the bodies end.

    A person's height is constant, and what hides a part of a body only shortens it: a body shorter than its person has
    an end that does not show. As the camera looks down, that is mostly the feet: then the head places the person.
    """

    def __init__(self, params: HumanModelParams, camera: GroundCamera, scene: ModelScene) -> None:
        self.params, self.camera, self.scene = params, camera, scene
        self._height_m = HumanModel().scaled(params.height_m).height_m

    def __call__(self, target: Target, position: F64, evidence: U8, dt_s: float) -> bool:
        """Refine a (2,) foot pixel in place after ``ModelScene.measure``; a length that is clear is learned.

        Args:
            dt_s: time since the last frame [s].
        Returns:
            whether the distance from the camera is known.
        """
        build, reach = target.build, self.params.match.refine_reach
        found = self.scene.extent(evidence, position, build.scale)
        known = build.measured_s >= self.params.match.learning_s
        if found is None:
            return True
        head, feet = self._clear(position, build.scale, 1.0 - END), self._clear(position, build.scale, 0.0)
        ends = self._ends(position, found, build)
        # A model that has left its body may be far from the feet of one that is as long as the person.
        off = abs(found.low) > reach
        as_long = abs(ends.height - 1.0) <= (SHORTER if known or off else reach)
        if head and feet and as_long and abs(found.high) <= reach:
            position += ends.shift * found.axis_px
            if target.stability == "stable":
                self._learn(target, ends.height, dt_s)
            return True
        if known and head and abs(found.head) <= reach:
            foot = self._by_head(position, found, build.scale)
            off_m = float(np.hypot(*(self.camera.back_project(foot) - self.camera.back_project(position))))
            if off_m <= SEARCH_SIGMAS * self.head_std_m(target.xy_m, build.scale) and found.error <= reach:
                position += ends.shift * found.axis_px
                return True
            if self._reachable(target, foot):
                position[:] = foot
                return True
        return not known

    def _ends(self, position: F64, found: Extent, build: Build) -> Ends:
        """The likeliest place and height for both ends of a body and what is known of the person's height."""
        height_m = build.scale * self._height_m
        nearer = self._nearer(position, height_m)
        lift = (1.0 - height_m / self.camera.height_m) / (1.0 - nearer) ** 2
        height_std = HEIGHT / math.hypot(1.0, build.measured_s / self.params.match.learning_s)
        feet, head = 1.0 / STEP**2, 1.0 / (BOB**2 + (height_std / (1.0 - nearer)) ** 2)
        shift = (feet * found.low + head * lift * found.high) / (feet + head * lift**2)
        longer = found.high - lift * found.low
        return Ends(shift, 1.0 + longer * (1.0 - nearer) / (1.0 + longer * nearer))

    def _nearer(self, position: F64, height_m: float) -> float:
        """How much nearer to the camera's plane the head is than a (2,) foot pixel, over the foot's distance."""
        ahead, down = math.sin(self.camera.tilt_rad), math.cos(self.camera.tilt_rad)
        away_m = float(self.camera.back_project(position)[1]) * ahead + self.camera.height_m * down
        return min(height_m * down / away_m, NEAREST)

    def head(self, target: Target, position: F64, evidence: U8) -> F64 | None:
        """(2,) top of the head [px] of a person of known height at a foot pixel; None if hidden."""
        build = target.build
        if build.measured_s < self.params.match.learning_s:
            return None
        found = self.scene.extent(evidence, position, build.scale)
        if found is None:
            return None
        if math.isnan(found.height) and target.shared == 0.0:
            return None  # what hides the middle of the body may hide the head
        clear = self._clear(position, build.scale, 1.0 - END) and not math.isnan(found.head)
        return self._head(position, found, build.scale) if clear else None

    def has_feet(self, target: Target, position: F64, evidence: U8) -> bool:
        """Whether a body reaches down to where a standing person with the foot at a pixel has the feet."""
        found = self.scene.extent(evidence, position, target.build.scale)
        return found is not None and found.low <= FEET

    def _head(self, position: F64, found: Extent, scale: float) -> F64:
        foot_m = np.append(self.camera.back_project(position), scale * self._height_m)
        return np.asarray(self.camera.project(foot_m) + found.head * found.axis_px, np.float64)

    def head_std_m(self, xy_m: F64, scale: float) -> float:
        """Standard deviation of where a person is [m], told by the head: large where the camera hangs as high."""
        height_m, away_m = scale * self._height_m, float(np.hypot(*xy_m))
        above_m = max(self.camera.height_m - height_m, BOB * height_m)
        return math.hypot(BOB * height_m * away_m, TILT_RAD * (away_m**2 + above_m**2)) / above_m

    def _reachable(self, target: Target, foot_px: F64) -> bool:
        """Whether a head that tells a place as well as its height is known agrees with the prediction."""
        off, k = self.camera.back_project(foot_px) - target.xy_m, target.kalman
        spread = np.array([[k.c_xx, k.c_xy], [k.c_xy, k.c_yy]]) + self.head_std_m(
            target.xy_m, target.build.scale
        ) ** 2 * np.eye(2)
        return bool(off @ np.linalg.solve(spread, off) <= SEARCH_SIGMAS**2)

    def _by_head(self, position: F64, found: Extent, scale: float) -> F64:
        """Foot pixel of a person of known height whose head is where the body ends."""
        height_m = scale * self._height_m
        floor = self.camera.back_project(self._head(position, found, scale), height_m)
        return np.asarray(self.camera.project(np.append(floor, 0.0)), np.float64)

    def _clear(self, position: F64, scale: float, from_foot: float) -> bool:
        """Whether nobody and nothing hides an end of a model."""
        return self.scene.covered(position, scale, from_foot, END) <= MAX_COVERED

    def _learn(self, target: Target, height: float, dt_s: float) -> None:
        """The mean of what was measured and of one ``learning_s`` of the average person.

        What is shorter or taller than people are is no whole person: legs like the floor, a shadow below the feet.
        """
        build, before_s = target.build, self.params.match.learning_s
        length = build.scale * height
        if abs(length - 1.0) > MAX_DEVIATION:
            return
        build.scale = build.scale if build.measured_s > 0.0 else 1.0
        build.measured_s += dt_s
        build.scale += (length - build.scale) * dt_s / (before_s + build.measured_s)
