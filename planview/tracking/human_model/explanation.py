"""How well people at some places explain every pixel of a mask, and where they explain it best."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F32, F64, I32, I64, U8, Bool
from planview.foreground.gain import Exposure
from planview.maps.colour import colour_codes
from planview.maps.pixels import PixelRays, SeenPixels
from planview.tracking import body
from planview.tracking.base import Observation
from planview.tracking.human_model import _kernels as kernels
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.silhouette import silhouette
from planview.tracking.kalman import PositionNoise
from planview.tracking.template.explanation import People

STEPS_M = np.array([0.12, 0.06, 0.03])
"""Steps of the pattern search: a walker's error of prediction, down to half of a patch's blur [m]."""
SPACING_M = 0.07
"""Distance of samples on a body [m]."""
PATCH_PX = 3.0
"""Errors of pixels nearer than this in the image are one error, however far away people are [px]."""
NEAR_M = 0.6
"""From the body's axis to hands and feet that the silhouette does not expect, and to shadows [m]."""
RIVAL = 0.3
"""Share of the smaller of two boxes that they have in common when two people are rivals for the same foreground."""
MAX_SAMPLES = 2000


ANYBODY = np.array([body.HEIGHT_MEAN_M, body.HEIGHT_STD_M])
"""Height of somebody of whom nothing is known, and its deviation [m]."""


class MaskView:
    """What stays the same in every frame of a camera: the ray of each pixel."""

    def __init__(self, camera: GroundCamera, params: HumanModelParams) -> None:
        self.camera, self.params, self.table = camera, params, silhouette()
        rows, cols = np.mgrid[: camera.height, : camera.width]
        rays = camera.rays(np.stack([cols, rows], axis=-1)) / camera.focal_px
        length = np.linalg.norm(rays, axis=-1)
        unit = rays / length[..., None]
        cos = np.hypot(unit[..., 0], unit[..., 1])
        ahead = np.maximum(cos, 1e-6)
        # The depth along the optical axis is the range over this.
        axis = np.array([0.0, math.sin(camera.tilt_rad), -math.cos(camera.tilt_rad)])
        stretch = 1.0 / np.maximum(unit @ axis, 0.05)
        self.rays: F32 = np.stack(
            [unit[..., 0] / ahead, unit[..., 1] / ahead, cos, -unit[..., 2], stretch], axis=-1
        ).astype(np.float32)
        steps = (np.arctan2(-unit[..., 2], cos) - self.table.angle_min_rad) / self.table.angle_step_rad
        self.angle: I32 = np.clip(np.rint(np.nan_to_num(steps)), 0, len(self.table.cover) - 1).astype(np.int32)
        self.seen_rays = PixelRays(
            np.array([0.0, 0.0, camera.height_m]), unit.astype(np.float32), stretch.astype(np.float32),
            np.zeros(stretch.shape, np.float32), np.zeros((3, 4)), 1.0 / camera.focal_px**2, 0.0, 1.0,
        )  # fmt: skip
        p, t = params, self.table
        self.beliefs = kernels.OutlineBeliefs(
            body=p.seen_on_body,
            background=p.seen_on_background,
            near_people=p.seen_near_people,
            hidden=p.hidden,
            hidden_sitting=p.hidden_sitting,
            hidden_to=0.6,
            sitting_from=0.5 * (1.0 + p.sitting),
            colour=p.colour_weight,
            sits=p.sits,
            sitting=p.sitting,
            reach_m=NEAR_M,
            apart_m=body.APART_M,
            camera_m=camera.height_m,
            focal_px=camera.focal_px,
            patch_m=p.patch_m,
            patch_px=PATCH_PX,
            body_m=body.TORSO.height_m,
            angle_min=t.angle_min_rad,
            angle_step=t.angle_step_rad,
            cell_m=t.cell_m,
            w_min=t.w_min_m,
        )

    def boxes(self, poses: F64, reach_m: float) -> I64:
        """(N, 4) int64 left, top, right, bottom of bodies and what is within a reach of them [px]."""
        corners = np.array([(dx, dy, z) for dx in (-1.0, 1.0) for dy in (-1.0, 1.0) for z in (0.0, 1.05)])
        points = np.empty((len(poses), 8, 3))
        points[..., :2] = poses[:, None, :2] + reach_m * corners[:, :2]
        points[..., 2] = np.minimum(corners[:, 2] * poses[:, 2:3], self.camera.height_m - 0.05)
        image = self.camera.project(points)
        low, high = np.where(np.isnan(image), -1e4, image).min(1), np.where(np.isnan(image), 1e4, image).max(1)
        return np.asarray(np.clip(np.concatenate([low, high], axis=1), -1e4, 1e4), dtype=np.int64)


class Pair(NamedTuple):
    """Two people against one.

    Attributes:
        evidence: for two.
        alone: (3,) pose of one alone.
        gain: how much that gains on the second's present pose.
        first: whether the one alone is where the first is: the second is too many.
    """

    evidence: float
    alone: F64
    gain: float
    first: bool


TOGETHER = 4.0
"""Price of a second person in a first one's outline [log-odds]: that one walks half hidden by another all the time is
seldom (section 4: merging)."""


class MaskExplanation:
    """One frame.

    Args:
        view: of the camera.
        observation: with foreground.

    Attributes:
        kind: (H, W) uint8 of the kernels' SEEN, SHADOW and SURFACE.
        code: (H, W) uint8 colour codes of the foreground.
        coloured: whether clothes tell people apart.
    """

    def __init__(self, view: MaskView, observation: Observation) -> None:
        assert observation.foreground is not None
        self.view, image = view, observation.image
        self.kind: U8 = np.where(observation.foreground > 0, np.uint8(kernels.SURFACE), np.uint8(kernels.SEEN))
        if observation.shadow is not None:
            self.kind[(observation.shadow > 0) & (self.kind == kernels.SEEN)] = kernels.SHADOW
        self.code: U8 = np.zeros(self.kind.shape, np.uint8)
        self.coloured = image is not None and image.ndim == 3 and view.params.colour_weight > 0
        if image is not None and self.coloured:
            pixels = np.flatnonzero(self.kind == kernels.SURFACE).astype(np.int32)
            self.code.reshape(-1)[pixels] = colour_codes(image, pixels, Exposure())

    def around(self, pose: F64, reach_m: float) -> OutlineSamples:
        """The samples within reach of a body."""
        return OutlineSamples(self, pose, reach_m)

    def touching(self, poses: F64) -> Bool:
        """(N, N) whether two people may be on one ray."""
        low, high = np.split(self.view.boxes(poses, 0.4), 2, axis=1)
        return np.asarray((low[:, None] <= high[None]).all(-1) & (low[None] <= high[:, None]).all(-1))

    def rival(self, i: int, people: People, standing: F64) -> int:
        """The person of better (N,) standing who may account for the foreground of another; -1 for none."""
        boxes = self.view.boxes(people.poses, body.TORSO.torso_radius_m).astype(np.float64)
        sides = np.minimum(boxes[:, 2:], boxes[i, 2:]) - np.maximum(boxes[:, :2], boxes[i, :2])
        area = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
        common = np.maximum(sides, 0.0).prod(axis=1) / np.maximum(np.minimum(area, area[i]), 1.0)
        common[standing <= standing[i]] = 0.0
        j = int(np.argmax(common))
        return j if common[j] > RIVAL else -1

    def beside(self, i: int, j: int, people: People, refit: bool = False) -> Pair:
        """Evidence for two people against the second alone, who may be anywhere near.

        Args:
            refit: move both to where they explain most together.
        """
        poses, tall, ratios = people.poses, people.tall.copy(), people.ratios
        if refit:
            tall[j] = ANYBODY
        rest = np.array([k for k in range(len(poses)) if k not in (i, j)], dtype=np.int64)
        rest = rest[self.touching(poses)[[i, j]][:, rest].any(axis=0)]
        mine, other = self.around(poses[i], 0.4), self.around(poses[j], 0.4)
        near = 1.0 / NEAR_M**2
        information = np.array([near, 0.0, near, 1.0 / body.HEIGHT_STD_M**2])
        apart = people.apart(rest)
        other.layer(people, rest, poses[j])
        here = other.lam(poses[j], tall[j], ratios[j]) + other.believed(poses[j], tall[j], apart)
        mine.layer(people, rest, poses[i])
        alone, pose, first_alone = -math.inf, poses[j], False
        for start, s in ((poses[j], other), (np.array([*poses[i, :2], poses[j, 2]]), mine)):
            moved = start.copy()
            # How tall the one is may have been learned without what the other covers.
            value = s.ascend(moved, start, information, ANYBODY, apart, ratios[j])
            if value > alone:
                alone, pose, first_alone = value, moved, s is mine
        if refit:
            for a, b, s in ((j, i, other), (i, j, mine)):
                s.layer(people, np.append(rest, b), poses[a])
                s.ascend(
                    poses[a], poses[a].copy(), information, tall[a], people.apart(np.append(rest, b)), ratios[a]
                )  # fmt: skip
            mine.layer(people, rest, poses[i])
        first = mine.lam(poses[i], tall[i], ratios[i])
        other.layer(people, np.append(rest, i), poses[j])
        both = first + other.lam(poses[j], tall[j], ratios[j])
        both += other.believed(poses[i], tall[i], people.apart(np.append(rest, j)))
        both += other.believed(poses[j], tall[j], apart)
        return Pair(both - alone - TOGETHER, pose, alone - here, first_alone)

    def share_out(self, people: People) -> Shares:
        """Who owns each pixel of foreground."""
        v, shape = self.view, self.kind.shape
        share, height, range_m, residual = np.zeros((4, *shape), np.float32)
        s = Shares(np.empty(shape, np.int64), share, height, range_m, residual, np.empty(shape, np.bool_))
        kernels.share_out(
            people.poses, people.sure, people.tall, people.ratios, np.argsort(people.away()),
            v.boxes(people.poses, NEAR_M), v.rays, v.angle, self.kind, self.code, v.table.cover, v.beliefs,
            s.owner, s.share, s.height, s.range_m, s.residual, s.near,
        )  # fmt: skip
        return s


class Shares:
    """Who owns each pixel of a frame; see ``_kernels.share_out``."""

    def __init__(self, owner: I64, share: F32, height: F32, range_m: F32, residual: F32, near: Bool) -> None:
        self.owner, self.share, self.height = owner, share, height
        self.range_m, self.residual, self.near = range_m, residual, near

    def seen(self, of: MaskExplanation) -> SeenPixels:
        """The frame as if every pixel were as far away as its owner."""
        return SeenPixels(of.view.seen_rays, of.kind, self.range_m, of.code if of.coloured else None)


class OutlineSamples:
    """The samples around one person and the layers of others on their rays."""

    def __init__(self, of: MaskExplanation, pose: F64, reach_m: float) -> None:
        self._of, v = of, of.view
        self._values = np.empty((MAX_SAMPLES, kernels.SAMPLE_FIELDS), np.float32)
        self._kinds, self._codes = np.empty((2, MAX_SAMPLES), np.uint8)
        self._angles = np.empty(MAX_SAMPLES, np.int64)
        half_m = reach_m + kernels.AROUND_M
        self._n = kernels.gather(
            pose, half_m, SPACING_M, v.boxes(pose[None], half_m)[0], v.rays, v.angle, of.kind,
            of.code, self._values, self._kinds, self._codes, self._angles, v.beliefs,
        )  # fmt: skip

    def layer(self, people: People, others: I64, pose: F64) -> None:
        """Take these people for the others on the rays of a person at a pose."""
        v, away = self._of.view, people.away()
        order = others[np.argsort(away[others])]
        before = int((away[order] < math.hypot(pose[0], pose[1])).sum())
        kernels.layer(
            self._values, self._kinds, self._codes, self._angles, self._n, people.poses, people.sure, people.tall,
            people.ratios, order, before, v.table.cover, v.beliefs,
        )  # fmt: skip

    def lam(self, pose: F64, tall: F64, ratio: F32) -> float:
        """Lam with one more person at a pose, less Lam with the others alone."""
        return self._lam(float(pose[0]), float(pose[1]), float(pose[2]), float(tall[0]), ratio)

    def _lam(self, x: float, y: float, h: float, tall: float, ratio: F32) -> float:
        v = self._of.view
        return float(
            kernels.evaluate(
                x, y, h, tall, self._values, self._kinds, self._codes, self._angles, self._n, ratio, v.table.cover,
                v.beliefs,
            )
        )  # fmt: skip

    def ascend(
        self, pose: F64, predicted: F64, information: F64, tall: F64, apart: F64, ratio: F32, steps: F64 = STEPS_M
    ) -> float:
        """Move a pose to where it explains best; Lam there plus what is believed of such a pose.

        Args:
            information: (4,) xx, xy, yy of the place's and of the height's inverse covariance.
        """
        v = self._of.view
        return float(
            kernels.ascend(
                pose, predicted, information, float(tall[0]), float(tall[1]), apart, steps, body.HEIGHT_MIN_M,
                body.HEIGHT_MAX_M, self._values, self._kinds, self._codes, self._angles, self._n, ratio,
                v.table.cover, v.beliefs,
            )
        )  # fmt: skip

    def believed(self, pose: F64, tall: F64, apart: F64) -> float:
        """What is believed of a pose before any pixel is seen."""
        x, y, h = map(float, pose)
        return float(kernels.believed(x, y, h, float(tall[0]), float(tall[1]), apart, self._of.view.beliefs))

    def visible(self, pose: F64, tall: F64) -> tuple[float, float, float]:
        """Patches of a body that it explains better than all else, those on foreground, and those in view."""
        v = self._of.view
        mine, seen, total = kernels.visible(
            pose, float(tall[0]), self._values, self._kinds, self._angles, self._n, v.table.cover, v.beliefs
        )
        return float(mine), float(seen), float(total)

    def noise(self, pose: F64, tall: F64, ratio: F32) -> tuple[PositionNoise, float]:
        """Covariance of the place and information on the height [1/m^2], from the second differences of Lam."""
        x, y, h = map(float, pose)
        t, d = float(tall[0]), float(STEPS_M[1])
        away = max(math.hypot(x, y), 1e-6)
        ax, ay = x / away, y / away
        far = d * min(math.hypot(away, self._of.view.camera.height_m) / self._of.view.camera.height_m, 4.0)
        here = 2 * self._lam(x, y, h, t, ratio)
        along = here - self._lam(x + far * ax, y + far * ay, h, t, ratio)
        along -= self._lam(x - far * ax, y - far * ay, h, t, ratio)
        across = here - self._lam(x - d * ay, y + d * ax, h, t, ratio) - self._lam(x + d * ay, y - d * ax, h, t, ratio)
        up = here - self._lam(x, y, h + d, t, ratio) - self._lam(x, y, h - d, t, ratio)
        va, vc = (max(s * s / max(bent, 0.02), (s / 3) ** 2) for bent, s in ((along, far), (across, d)))
        place = PositionNoise(va * ax * ax + vc * ay * ay, (va - vc) * ax * ay, va * ay * ay + vc * ax * ax)
        return place, max(up, 0.0) / (d * d)
