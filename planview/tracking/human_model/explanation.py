"""How well people at some places explain every pixel of a mask, and where they explain it best."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F32, F64, I64, U8, Bool
from planview.foreground.gain import Exposure
from planview.maps.colour import colour_codes
from planview.tracking import body
from planview.tracking.base import Observation
from planview.tracking.human_model import _kernels as kernels
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.silhouette import silhouette
from planview.tracking.joint.explanation import Owned, People
from planview.tracking.kalman import PositionNoise

STEPS_M = np.array([0.12, 0.06])
"""Steps of the ascent: a walker's error of prediction, and the blur of a patch [m]."""
SPACING_M = 0.05
"""Distance of samples on a body [m]."""
PATCH_PX = 3.0
"""Errors of pixels nearer than this in the image are one error, however far away people are [px]."""
NEAR_M = 0.6
"""From the body's axis to hands and feet that the silhouette does not expect, and to shadows [m]."""
RIVAL = 0.3
"""Share of the smaller of two boxes that they have in common when two people are rivals for the same foreground."""


ANYBODY = np.array([body.HEIGHT_MEAN_M, body.HEIGHT_STD_M])
"""Height of somebody of whom nothing is known, and its deviation [m]."""


class Shares:
    """Who owns each pixel of a frame's foreground, one after the other; see ``_kernels.share_out``.

    Attributes:
        fill: fills ``residual`` when called with SEEN and those pixels: few frames need it there.
    """

    fill: Callable[[int, I64], None]

    def __init__(self, of: MaskExplanation) -> None:
        (rows, cols), n = of.kind.shape, len(of.pixels)
        self.owner: I64 = np.empty(n, np.int64)
        self.share, self.height, self.range_m = np.zeros((3, n), np.float32)
        self.near: Bool = np.empty(n, np.bool_)
        self.residual: F32 = np.zeros((rows, cols), np.float32)
        self.tiles: F64 = np.zeros((-(-rows // kernels.TILE_PX), -(-cols // kernels.TILE_PX)))

    def owned(self, of: MaskExplanation) -> Owned:
        """The foreground, as if its pixels were as far away as their owners."""
        view, pixels = of.view, of.pixels
        depth = self.range_m / view.rays.reshape(-1, view.rays.shape[-1])[pixels, 4]
        patches = (depth / np.float32(view.camera.focal_px * view.params.patch_m)) ** 2
        return Owned(pixels, of.code.reshape(-1)[pixels], self.owner, self.share, self.height, patches)


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
        self.angle: U8 = np.clip(np.rint(np.nan_to_num(steps)), 0, len(self.table.cover) - 1).astype(np.uint8)
        tilt, roll = camera.tilt_rad, camera.roll_rad
        self._lens = np.array([
            camera.focal_px, camera.distortion_k, camera.height_m, math.sin(tilt), math.cos(tilt), math.sin(roll),
            math.cos(roll), 0.5 * (camera.width - 1), 0.5 * (camera.height - 1),
        ])  # fmt: skip
        p, t = params, self.table
        self.beliefs = kernels.OutlineBeliefs(
            body=p.seen_on_body, background=p.seen_on_background, near_people=p.seen_near_people, hidden=p.hidden,
            hidden_sitting=p.hidden_sitting, hidden_to=0.6, sitting_from=0.5 * (1.0 + p.sitting),
            colour=p.colour_weight, sits=p.sits, sitting=p.sitting, reach_m=NEAR_M, apart_m=body.APART_M,
            camera_m=camera.height_m, focal_px=camera.focal_px, patch_m=p.patch_m, patch_px=PATCH_PX,
            body_cells=body.TORSO.height_m / t.cell_m, w_first=t.w_min_m / t.cell_m,
        )  # fmt: skip

    def boxes(self, poses: F64, reach_m: float) -> I64:
        """(N, 4) int64 left, top, right, bottom of bodies and what is within a reach of them [px]."""
        boxes = np.empty((len(poses), 4), np.int64)
        kernels.boxes(poses, reach_m, self._lens, boxes)
        return boxes


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
        pixels: (K,) int64, those of SURFACE.
        code: (H, W) uint8 colour codes of the foreground.
        coloured: whether clothes tell people apart.
    """

    def __init__(self, view: MaskView, observation: Observation) -> None:
        assert observation.foreground is not None
        self.view, image = view, observation.image
        self.kind: U8 = kernels.SURFACE * (observation.foreground > 0).view(np.uint8)
        if observation.shadow is not None:
            np.maximum(self.kind, kernels.SHADOW * (observation.shadow > 0).view(np.uint8), out=self.kind)
        self.pixels: I64 = np.flatnonzero(self.kind == kernels.SURFACE)
        self.code: U8 = np.zeros(self.kind.shape, np.uint8)
        self.coloured = image is not None and image.ndim == 3 and view.params.colour_weight > 0
        if image is not None and self.coloured:
            self.code.reshape(-1)[self.pixels] = colour_codes(image, self.pixels.astype(np.int32), Exposure())

    def around(self, poses: F64, reach_m: float) -> list[OutlineSamples]:
        """The samples within reach of each of (N, 3) bodies."""
        half_m = reach_m + kernels.AROUND_M
        return [OutlineSamples(self, p, half_m, b) for p, b in zip(poses, self.view.boxes(poses, half_m), strict=True)]

    def touching(self, poses: F64) -> Bool:
        """(N, N) whether two people may be on one ray."""
        boxes = self.view.boxes(poses, 0.4)
        before = (boxes[:, None, :2] <= boxes[:, 2:]).all(axis=2)
        return np.asarray(before & before.T)

    def rivals(self, people: People, standing: F64) -> I64:
        """(N,) the person of better (N,) standing who may account for the foreground of each; -1 for none."""
        boxes = self.view.boxes(people.poses, body.TORSO.torso_radius_m).astype(np.float64)
        low, high = boxes[:, :2], boxes[:, 2:]
        sides = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
        area = (high - low).prod(axis=1)
        common = np.maximum(sides, 0.0).prod(axis=2) / np.maximum(np.minimum(area[:, None], area), 1.0)
        common[standing <= standing[:, None]] = 0.0
        return np.where(common.max(axis=1, initial=0.0) > RIVAL, common.argmax(axis=1), -1)

    def beside(self, i: int, j: int, people: People, refit: bool = False) -> Pair:
        """Evidence for two people against the second alone, who may be anywhere near.

        Args:
            refit: move both to where they explain most together.
        """
        poses, tall = people.poses, people.tall.copy()
        if refit:
            tall[j] = ANYBODY
        touch = self.touching(poses)
        touch[:, [i, j]] = False
        rest = np.flatnonzero(touch[i] | touch[j])
        mine, other = self.around(poses[[i, j]], 0.4)
        near = 1.0 / NEAR_M**2
        information = np.array([near, 0.0, near, 1.0 / body.HEIGHT_STD_M**2])
        other.layer(people, rest, j)
        here = other.evidence(poses[j], tall[j])
        alone, pose, first_alone = -math.inf, poses[j], False
        for start, s in ((poses[j], other), (np.array([*poses[i, :2], poses[j, 2]]), mine)):
            if s is mine:
                s.layer(people, rest, j, poses[i])
            moved = start.copy()
            # How tall the one is may have been learned without what the other covers.
            value = s.ascend(moved, start, information, ANYBODY)
            if value > alone:
                alone, pose, first_alone = value, moved, s is mine
        if refit:
            for a, b, s in ((j, i, other), (i, j, mine)):
                s.layer(people, np.append(rest, b), a)
                s.ascend(poses[a], poses[a].copy(), information, tall[a])
        mine.layer(people, rest, i)
        first = mine.lam(poses[i], tall[i])
        other.layer(people, np.append(rest, i), j)
        both = first + other.lam(poses[j], tall[j])
        both += mine.believed(poses[i], tall[i], np.append(rest, j)) + other.believed(poses[j], tall[j], rest)
        return Pair(both - alone - TOGETHER, pose, alone - here, first_alone)

    def share_out(self, people: People) -> Shares:
        """Who owns each pixel of foreground."""
        v, s = self.view, Shares(self)
        s.fill = lambda kind, pixels: kernels.share_out(
            kind, pixels, people.poses, people.sure, people.tall, people.ratios, np.argsort(people.away()),
            v.boxes(people.poses, NEAR_M), v.rays, v.angle, self.code, v.table.cover, v.beliefs,
            s.owner, s.share, s.height, s.range_m, s.residual, s.near, s.tiles,
        )  # fmt: skip
        s.fill(kernels.SURFACE, self.pixels)
        return s


class OutlineSamples:
    """The samples around one person and the layers of others on their rays."""

    def __init__(self, of: MaskExplanation, pose: F64, half_m: float, box: I64) -> None:
        self._of, v = of, of.view
        self._values = np.empty((2000, kernels.GAINS + 6), np.float32)
        self._kinds, self._codes, self._angles = np.empty((3, len(self._values)), np.uint8)
        self._n = kernels.gather(
            pose, half_m, SPACING_M, box, v.rays, v.angle, of.kind, of.code, self._values, self._kinds, self._codes,
            self._angles, v.beliefs,
        )  # fmt: skip

    def layer(self, people: People, others: I64, i: int, pose: F64 | None = None) -> None:
        """Take these people for the others on the rays of person ``i``, who is at its pose, or at another one."""
        v, self._people, self._others = self._of.view, people, others
        kernels.layer(
            self._values, self._kinds, self._codes, self._angles, self._n, people.poses, people.sure, people.tall,
            people.ratios, others, i, people.poses[i] if pose is None else pose, v.table.cover, v.beliefs,
        )  # fmt: skip

    def lam(self, pose: F64, tall: F64) -> float:
        """Lam with one more person at a pose, less Lam with the others alone."""
        (x, y, h), v = pose.tolist(), self._of.view
        return kernels.evaluate(x, y, h, tall[0], self._values, self._angles, self._n, v.table.cover, v.beliefs)

    def evidence(self, pose: F64, tall: F64) -> float:
        """The same, and what is believed of the pose."""
        return self.lam(pose, tall) + self.believed(pose, tall, self._others)

    def ascend(self, pose: F64, predicted: F64, information: F64, tall: F64, steps: F64 = STEPS_M) -> float:
        """Move a pose to where it explains best; Lam there plus what is believed of such a pose.

        Args:
            information: (4,) xx, xy, yy of the place's and of the height's inverse covariance.
        """
        v, people = self._of.view, self._people
        return kernels.ascend(
            pose, predicted, information, tall, people.poses, people.sure, self._others, steps, body.HEIGHT_MIN_M,
            body.HEIGHT_MAX_M, self._values, self._angles, self._n, v.table.cover, v.beliefs,
        )  # fmt: skip

    def believed(self, pose: F64, tall: F64, others: I64) -> float:
        """What is believed of a pose beside others before any pixel is seen."""
        (x, y, h), people = pose.tolist(), self._people
        return kernels.believed(x, y, h, tall, people.poses, people.sure, others, self._of.view.beliefs)

    def visible(self, pose: F64, tall: F64) -> tuple[float, float, float]:
        """Patches of a body that it explains better than all else, those on foreground, and those in view."""
        v = self._of.view
        mine, seen, total = kernels.visible(
            pose, tall[0], self._values, self._kinds, self._angles, self._n, v.table.cover, v.beliefs
        )  # fmt: skip
        return mine, seen, total

    def noise(self, pose: F64, tall: F64) -> tuple[PositionNoise, float]:
        """Covariance of the place and information on the height [1/m^2], from the second differences of Lam."""
        (x, y, _), d, camera_m = pose.tolist(), float(STEPS_M[1]), self._of.view.camera.height_m
        away = max(math.hypot(x, y), 1e-6)
        ax, ay, far = x / away, y / away, d * min(math.hypot(away, camera_m) / camera_m, 4.0)
        ways, here = np.array([(far * ax, far * ay, 0.0), (-d * ay, d * ax, 0.0), (0.0, 0.0, d)]), self.lam(pose, tall)
        along, across, up = (2.0 * here - self.lam(pose + way, tall) - self.lam(pose - way, tall) for way in ways)
        va, vc = (max(s * s / max(bent, 0.02), (s / 3) ** 2) for bent, s in ((along, far), (across, d)))
        place = PositionNoise(va * ax * ax + vc * ay * ay, (va - vc) * ax * ay, va * ay * ay + vc * ax * ax)
        return place, max(up, 0.0) / (d * d)
