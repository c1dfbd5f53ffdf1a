"""How well people at some places explain every pixel of one frame, and where they explain it best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from calib.types import F32, F64, I64, U8, Bool
from planview.maps.colour import CODES
from planview.maps.pixels import SURFACE, SeenPixels
from planview.tracking import body
from planview.tracking.joint import _kernels as kernels
from planview.tracking.joint.params import JointParams
from planview.tracking.kalman import PositionNoise

OUTLIERS = 0.08
"""Share of a body's disparities that are wrong."""
SEEN_ON_BODY = 0.93
"""pF, share of a body's pixels that are foreground."""
SEEN_ON_BACKGROUND = 0.03
"""pB, share of the background's pixels that are foreground."""
NO_DEPTH = 0.15
"""Share of a body's foreground without disparity."""
RANGE_M = 6.0
"""Depth over which wrong disparities spread [m]."""
UNKNOWN = 0.02
"""kappa, share of the pixels before which something unknown stands."""
SURFACE_STD_M = 0.10
"""Deviation of a body's surface from its template [m]."""
STEPS_M = np.array([0.12, 0.05])
"""Steps of the ascent: a walker's error of prediction, and half a patch [m]."""
PLACE_STD_MIN_M = 0.02
"""A place is never known better [m]: a body leans and swings."""
MAX_SAMPLES = 4000
GAP_PX = 6
"""People whose boxes are nearer than this in an image are explained together [px]."""


def beliefs_of(p: JointParams, table: body.BodyTable) -> Sequence[kernels.Beliefs]:
    """The parameters as kernels take them: an array of one record, which costs a call less than a tuple."""
    beliefs = kernels.Beliefs(
        outliers=OUTLIERS,
        body=SEEN_ON_BODY,
        background=SEEN_ON_BACKGROUND,
        near_people=p.seen_near_people,
        no_depth=NO_DEPTH,
        range_m=RANGE_M,
        unknown=UNKNOWN,
        surface_var=SURFACE_STD_M**2,
        colour=p.colour_weight,
        body_m=body.TORSO.height_m,
        reach_m=body.REACH_M,
        apart_m=body.APART_M,
        low_share=p.low_share,
        angle_min=table.angle_min_rad,
        angle_step=table.angle_step_rad,
        cell_m=table.cell_m,
        w_min=table.w_min_m,
    )
    record = np.array([tuple(beliefs)], dtype=[(name, np.float64) for name in beliefs._fields])
    return cast(Sequence[kernels.Beliefs], record)


class Owned(NamedTuple):
    """Who owns the M pixels of one camera that show a surface.

    Attributes:
        pixels: (M,) int64, row * width + column.
        colours: (M,) uint8 codes.
        owner: (M,) int64, index of a person; -1 nobody.
        share: (M,) float32, the owner's responsibility.
        height: (M,) float32, relative to the owner.
        patches: (M,) float32 that a pixel is.
    """

    pixels: I64
    colours: U8
    owner: I64
    share: F32
    height: F32
    patches: F32


class People:
    """What an explanation knows of people, side by side: all arrays have one row a person.

    Attributes:
        poses: (N, 3) float64 x, y, height [m].
        sure: (N,) float64 probabilities of existence.
        tall: (N, 2) float64 height when upright and its deviation [m].
        ratios: (N, PARTS, CODES) float32 colours over those of anybody.
    """

    def __init__(self, poses: F64, sure: F64, tall: F64, ratios: F32) -> None:
        self.poses, self.sure, self.tall, self.ratios = poses, sure, tall, ratios

    def with_one(self, pose: F64) -> People:
        """With one more, of whom nothing is known."""
        return People(
            np.concatenate([self.poses, pose[None]]),
            np.append(self.sure, 1.0),
            np.concatenate([self.tall, [[body.HEIGHT_MEAN_M, body.HEIGHT_STD_M]]]),
            np.concatenate([self.ratios, np.ones((1, kernels.PARTS, CODES), np.float32)]),
        )

    def away(self) -> F64:
        """(N,) distances from below the camera [m]: who is nearer is in front."""
        return np.asarray(np.hypot(self.poses[:, 0], self.poses[:, 1]), dtype=np.float64)


class Explanation:
    """One frame of all cameras.

    Args:
        views: what the cameras saw.
    """

    def __init__(self, views: Sequence[SeenPixels], params: JointParams, table: body.BodyTable) -> None:
        self.views, self.params, self.table = views, params, table
        self.beliefs, self._areas = beliefs_of(params, table), table.cover.sum(axis=(1, 2)).tolist()

    def around(self, pose: F64, reach_m: float) -> Samples:
        """The samples within reach of a body, of all cameras."""
        samples = Samples(self)
        for v in self.views:
            r = v.rays
            colour = v.colour if v.colour is not None else v.kind
            std = self.params.disparity_std_px / r.disparity_metre
            samples.n = kernels.gather(
                pose, reach_m, kernels.SPACING * self.params.patch_m, self.params.patch_m, r.centre_m, r.direction,
                r.level, r.stretch, r.matched_m, r.projection, r.pixel_sr, v.kind, v.range_m, colour, std,
                samples.values, samples.marks, samples.n, self.beliefs,
            )  # fmt: skip
        return samples

    def boxes(self, view: SeenPixels, poses: F64) -> I64:
        """(N, 4) int64 left, top, right, bottom of bodies in a view [px]."""
        boxes = np.empty((len(poses), 4))
        kernels.boxes(poses, view.rays.projection, 0.4, 0.1, boxes)
        return boxes.astype(np.int64)

    def in_view(self, point_m: F64) -> bool:
        """Whether a point (3,) of the world is inside of an image."""
        for v in self.views:
            u, w, depth = v.rays.projection @ np.append(point_m, 1.0)
            rows, cols = v.kind.shape
            if depth > 0 and 0 <= u <= (cols - 1) * depth and 0 <= w <= (rows - 1) * depth:
                return True
        return False

    def touching(self, poses: F64) -> Bool:
        """(N, N) whether two people may be on one ray of a camera."""
        touch = np.zeros((len(poses), len(poses)), np.bool_)
        for v in self.views:
            low, high = np.split(self.boxes(v, poses), 2, axis=1)
            touch |= (low[:, None] - GAP_PX <= high[None]).all(-1) & (low[None] - GAP_PX <= high[:, None]).all(-1)
        return np.asarray(touch, dtype=np.bool_)

    def whole_patches(self, pose: F64) -> float:
        """Patches of a body that is wholly in view, a mean over the cameras."""
        total, scale = 0.0, (pose[2] / body.TORSO.height_m) ** 2
        for v in self.views:
            away = math.dist(pose[:2], v.rays.centre_m[:2])
            depression = math.atan2(v.rays.centre_m[2] - 0.5 * pose[2], away)
            angle = round((depression - self.table.angle_min_rad) / self.table.angle_step_rad)
            area = self._areas[min(max(angle, 0), len(self._areas) - 1)]
            total += 2.0 * area * self.table.cell_m**2 * scale / self.params.patch_m**2
        return total / len(self.views)

    def share_out(self, people: People) -> tuple[list[Owned], F32]:
        """Who owns the surface in each view; and of all its pixels (5, N) float32 x, y, z [m], the expected
        log-likelihood of a body's surface there less that of the explanation [patches], and the colour code."""
        every, lacking = [], []
        for v in self.views:
            r, pixels = v.rays, np.flatnonzero(v.kind == SURFACE)
            n, colour = len(pixels), v.colour if v.colour is not None else v.kind
            owned = Owned(pixels, colour.reshape(-1)[pixels], np.empty(n, np.int64), *np.empty((3, n), np.float32))
            points = np.empty((5, n), np.float32)
            kernels.share_out(
                people.poses, people.sure, people.ratios, self.boxes(v, people.poses), r.centre_m, r.direction, r.level,
                r.stretch, self.params.disparity_std_px / r.disparity_metre, r.pixel_sr / self.params.patch_m**2,
                v.range_m, self.table.cover, self.table.front, self.beliefs, *owned, points,
            )  # fmt: skip
            every.append(owned)
            lacking.append(points)
        return every, np.concatenate(lacking, axis=1)


class Samples:
    """The samples around one person and the layers of others on their rays."""

    def __init__(self, of: Explanation) -> None:
        self._of = of
        self.values = np.empty((kernels.SAMPLE_FIELDS, MAX_SAMPLES), np.float32)
        self.marks = np.empty((3, MAX_SAMPLES), np.uint8)
        self.n = 0
        self._layers = (
            np.empty((MAX_SAMPLES, 4, kernels.LAYERS + 1), np.float32),
            np.empty(MAX_SAMPLES, np.int64),
            np.empty((3, MAX_SAMPLES), np.float32),
            np.empty(MAX_SAMPLES, np.int64),
        )

    def layer(self, people: People, others: I64) -> None:
        """Take these people for the others on the rays."""
        t = self._of.table
        kernels.layer(
            self.values, self.marks, self.n, people.poses, people.sure, people.ratios, others, t.cover, t.front,
            self._of.beliefs, *self._layers,
        )  # fmt: skip

    def lam(self, pose: F64, ratio: F32) -> float:
        """Lam with one more person at a pose, less Lam with the others alone."""
        t, (x, y, h) = self._of.table, map(float, pose)
        return float(
            kernels.evaluate(
                x, y, h, self.values, self.marks, self.n, ratio, t.cover, t.front, self._of.beliefs, *self._layers
            )
        )  # fmt: skip

    def ascend(
        self, pose: F64, predicted: F64, information: F64, tall: F64, people: People, others: I64, ratio: F32,
        steps: F64 = STEPS_M,
    ) -> tuple[float, F64]:  # fmt: skip
        """Move a pose to where it explains best.

        Args:
            information: (4,) xx, xy, yy of the place's and of the height's inverse covariance.
            others: of the people, whose bodies cannot be entered.

        Returns:
            Lam there plus what is believed of such a pose; (3,) how sharply Lam bends there along the ray, across it
            and in height [1/m^2].
        """
        t, bent = self._of.table, np.zeros(3)
        worth = kernels.ascend(
            pose, bent, predicted, information, float(tall[0]), float(tall[1]), people.poses, people.sure, others,
            steps, body.HEIGHT_MIN_M, body.HEIGHT_MAX_M, self.values, self.marks, self.n, ratio, t.cover, t.front,
            self._of.beliefs, *self._layers,
        )  # fmt: skip
        return float(worth), bent

    def believed(self, pose: F64, tall: F64, people: People, others: I64) -> float:
        """What is believed of a pose before any pixel is seen."""
        x, y, h = map(float, pose)
        tall_m, std = map(float, tall)
        return float(kernels.believed(x, y, h, tall_m, std, people.poses, people.sure, others, self._of.beliefs))

    def visible(self, pose: F64) -> tuple[float, float]:
        """Patches of a body that it explains better than all else, and those in view."""
        t = self._of.table
        mine, total = kernels.visible(
            pose, self.values, self.marks, self.n, t.cover, t.front, self._of.beliefs, *self._layers
        )
        return float(mine), float(total)

    def noise(self, pose: F64, bent: F64) -> tuple[PositionNoise, float]:
        """Covariance of the place and information on the height [1/m^2], from how Lam bends."""
        ax, ay = (
            (pose[0] - float(self.values[kernels.CX, 0]), pose[1] - float(self.values[kernels.CY, 0]))
            if self.n
            else (1.0, 0.0)
        )
        norm = max(math.hypot(ax, ay), 1e-6)
        ax, ay = ax / norm, ay / norm
        va, vc = (max(1.0 / max(b, 5.0), PLACE_STD_MIN_M**2) for b in bent[:2])
        place = PositionNoise(va * ax * ax + vc * ay * ay, (va - vc) * ax * ay, va * ay * ay + vc * ax * ax)
        return place, max(float(bent[2]), 0.0)
