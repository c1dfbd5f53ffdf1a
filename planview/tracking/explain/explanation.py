"""How well people at some places explain every pixel of one frame, and where they explain it best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.types import F32, F64, I64, U8, AnyArray, Bool
from planview.maps.view import CODES, SURFACE, View
from planview.tracking import body
from planview.tracking.explain import _ascent_kernels as ascent
from planview.tracking.explain import _likelihood_kernels as kernels
from planview.tracking.explain import samples as gathering
from planview.tracking.explain.samples import CX, CY, KNOWN, PARTS, Known, Model, SampleArrays, Seen

STEPS_M = np.array([0.12, 0.05])
"""Steps of the ascent: a walker's error of prediction, and half a patch [m]."""
PLACE_STD_MIN_M = 0.02
"""A place is never known better [m]: a body leans and swings."""
SHARED_DISPARITY_PX = 0.06
"""Deviation of the error of disparity that all pixels of a body share: calibration, and matching that prefers whole
pixels [px]."""
BOX_HALF_M = 0.4
"""Half width of the box that a body is in [m]."""
ANYBODY = np.array([body.HEIGHT_MEAN_M, body.HEIGHT_STD_M])
"""Height when upright of an unknown person, and its deviation [m]."""
THING_START = np.array([1.0, 1.0, 0.8, 1.0, 0.0])
"""The best thing is searched from a person's place and shoulders."""
ANY_HEIGHT_M = 1e3


def about(std_m: float, height_std_m: float) -> AnyArray:
    """(1,) of KNOWN: a pose whose place and height are known with these deviations, and nothing of how it faces."""
    return np.array([Known(std_m**-2, 0.0, std_m**-2, height_std_m**-2)], KNOWN)


def upright(pose: Sequence[float]) -> F64:
    """(5,) pose of x, y, height [m] of somebody who faces along x and does not lean."""
    return np.array([*pose, 0.0, 0.0])


class Likelihood(NamedTuple):
    """What kernels need besides the pixels: ``model``, an array of one ``Model``, the body's table, and (A,) float64
    ``areas``, how many of its cells a body covers, a mean over postures, by the depression of the ray."""

    model: Any
    table: body.BodyTable
    areas: F64
    disparity_std_px: float

    @staticmethod
    def of(model: Model, table: body.BodyTable, disparity_std_px: float = 0.0) -> Likelihood:
        """Of these assumptions; an array of one record costs a call less than a tuple."""
        record = np.array([tuple(model)], dtype=[(name, np.float64) for name in model._fields])
        areas = table.cover.sum(axis=(0, 2, 3)) / len(table.cover)
        return Likelihood(record, table, areas, disparity_std_px)

    def colourless(self) -> Likelihood:
        """The same where colours are unknown."""
        model = self.model.copy()
        model["colour"] = 0.0
        return self._replace(model=model)


class Owned(NamedTuple):
    """The owners of M pixels of one camera.

    Attributes:
        pixels: (M,) int64, row * width + column.
        colours: (M,) uint8 codes.
        owner: (M,) int64, index of a person; -1 nobody.
        share: (M,) float32, the owner's responsibility.
        height: (M,) float32, relative to the owner.
        patches: (M,) float32 that a pixel is at its range, without one at the owner's.
        lacking: (M,) float32, what one more person would gain [log-likelihood]: at the pixel's range, times its
            patches, or behind all others.
        near: (M,) bool, whether a person may reach there.
    """

    pixels: I64
    colours: U8
    owner: I64
    share: F32
    height: F32
    patches: F32
    lacking: F32
    near: Bool


class People(NamedTuple):
    """The people of an explanation, as kernels take them: all arrays have one row per person.

    Attributes:
        poses: (N, 5) float64 x, y, height [m], facing [rad], lean [m].
        sure: (N,) float64 probabilities of existence.
        tall: (N, 2) float64 height when upright and its deviation [m].
        ratios: (N, PARTS, CODES) float32 colours over those of anybody.
    """

    poses: F64
    sure: F64
    tall: F64
    ratios: F32

    def with_one(self, pose: F64) -> People:
        """With one more, unknown person."""
        return People(
            np.concatenate([self.poses, pose[None]]),
            np.append(self.sure, 1.0),
            np.concatenate([self.tall, ANYBODY[None]]),
            np.concatenate([self.ratios, np.ones((1, PARTS, CODES), np.float32)]),
        )


class Found(NamedTuple):
    """What is found of N people together (``_ascent_kernels.explain``).

    Attributes:
        evidence: (N,) log-likelihood ratio of with to without each, plus the logarithm of the prior of the pose.
        curvature: (N, 6) of that ratio, see ``Samples.ascend``.
        seen: (N, 3) patches, see ``Samples.visible``.
        turned: (N, FACINGS / 2) the ratios of an upright body by its facing; 0 where a body looks the same from
            everywhere.
    """

    evidence: F64
    curvature: F64
    seen: F64
    turned: F64


class Explanation:
    """One frame of all cameras.

    Args:
        views: what the cameras saw.
        likelihood: of their pixels.
    """

    def __init__(self, views: Sequence[View], likelihood: Likelihood) -> None:
        self.coloured = bool(likelihood.model["colour"][0] > 0) and all(
            v.colour is not None or not (v.kind == SURFACE).any() for v in views
        )
        """Whether colours distinguish people: all that is seen of them has a code."""
        self.views, self.likelihood = views, likelihood if self.coloured else likelihood.colourless()
        self._model = self.likelihood.model[0]
        self.seen = [self._seen(v) for v in views]

    def _seen(self, v: View) -> Seen:
        std_per_m2 = self.likelihood.disparity_std_px / v.rays.disparity_metre
        return Seen(v.rays, std_per_m2, v.kind, v.range_m, v.colour if v.colour is not None else v.kind)

    def around(self, poses: F64, reach_m: float) -> Samples:
        """The samples within reach of each of (N, 5) bodies, or of one (5,), of all cameras."""
        of, room = self.likelihood, gathering.SAMPLES_OF_VIEW * len(self.seen)
        arrays = SampleArrays.of(len(np.atleast_2d(poses)), room)
        for seen in self.seen:
            gathering.gather(np.atleast_2d(poses), reach_m, seen, arrays, of.table, of.model)
        return Samples(of, arrays if poses.ndim == 2 else arrays.person(0))

    def boxes(self, k: int, poses: F64, half_m: float) -> I64:
        """(N, 4) int64 left, top, right, bottom of bodies in view k [px]."""
        boxes = np.empty((len(poses), 4))
        gathering.boxes(poses, half_m, self.seen[k], boxes)
        return boxes.astype(np.int64)

    def in_view(self, point_m: F64) -> bool:
        """Whether a point of the world is inside of an image."""
        for v in self.views:
            u, w, depth = v.rays.projection @ np.append(point_m[:3], 1.0)
            rows, cols = v.kind.shape
            if depth > 0 and 0 <= u <= (cols - 1) * depth and 0 <= w <= (rows - 1) * depth:
                return True
        return False

    def shows_height(self, pose: F64, tall_m: float, std_m: float) -> bool:
        """Whether the head of a pose is in view and, of one much lower than somebody ``tall_m``, that one's too: else
        what is in view may be the legs of anybody."""
        is_low = float(pose[2]) < tall_m - 2.0 * std_m
        return self.in_view(pose) and (not is_low or self.in_view(np.array([*pose[:2], tall_m])))

    def shared_std_m(self, pose: F64) -> float:
        """Deviation of a place by the disparity's error that all pixels share, in the camera that shows it best."""
        away = [(v, math.dist(pose[:2], v.rays.centre_m[:2]), v.rays.centre_m[2] - 0.5 * pose[2]) for v in self.views]
        return min(SHARED_DISPARITY_PX / v.rays.disparity_metre * math.hypot(far, up) * far for v, far, up in away)

    def touching(self, poses: F64) -> Bool:
        """(N, N) whether two people may be on one ray of a camera; nobody with oneself."""
        touch = np.zeros((len(poses), len(poses)), np.bool_)
        for seen in self.seen:
            gathering.mark_touching(poses, BOX_HALF_M, seen, touch)
        np.fill_diagonal(touch, False)
        return touch

    def nearest_first(self, poses: F64) -> I64:
        """(N,) int64 order of people by their distance on the floor from the nearest camera, nearest first."""
        away = poses[:, :2] - np.array([v.rays.centre_m[:2] for v in self.views])[:, None]
        return np.argsort(np.hypot(away[..., 0], away[..., 1]).min(axis=0))

    def whole_patches(self, pose: F64) -> float:
        """Patches of a body that is wholly in view, a mean over the cameras."""
        table, m, total = self.likelihood.table, self._model, 0.0
        for v in self.views:
            away = math.dist(pose[:2], v.rays.centre_m[:2])
            depression = math.atan2(v.rays.centre_m[2] - 0.5 * pose[2], away)
            angle = round((depression - table.angle_min_rad) / table.angle_step_rad)
            area = float(self.likelihood.areas[min(max(angle, 0), table.cover.shape[1] - 1)])
            total += area * (table.cell_m * pose[2] / body.TORSO.height_m / float(m["patch_m"])) ** 2
        return total / len(self.views)

    def assign_pixels(self, people: People, kind: int = SURFACE) -> list[Owned]:
        """The owners of the pixels of a kind in each view."""
        return [self.owned(k, people, np.flatnonzero(v.kind == kind)) for k, v in enumerate(self.views)]

    def owned(self, k: int, people: People, pixels: I64) -> Owned:
        """The owners of some pixels of view k, all of one kind."""
        of, samples = self.likelihood, SampleArrays.of(1, len(pixels)).person(0)
        owner, found = np.empty(len(pixels), np.int64), np.empty((4, len(pixels)), np.float32)
        gathering.take_pixels(pixels, self.seen[k], samples, of.table, of.model)
        everybody = np.arange(len(people.poses))
        kernels.lay_others(samples, people, everybody, everybody, of.table, of.model)
        kernels.assign_pixels(samples, people.poses, of.model, owner, found)
        near = samples.pixels["near"].view(np.bool_)
        colours, (share, height, patches, lacking) = self.seen[k].colour.reshape(-1)[pixels], found
        return Owned(pixels, colours, owner, share, height, patches, lacking, near)


class Samples:
    """The samples around one person, or around each of several, and the layers of others on their rays."""

    def __init__(self, likelihood: Likelihood, arrays: SampleArrays) -> None:
        self._of, self.arrays = likelihood, arrays
        self._people: People
        self._others: I64

    def person(self, k: int) -> Samples:
        """Those of one of several people."""
        return Samples(self._of, self.arrays.person(k))

    def explain(self, people: People, prior: tuple[AnyArray, ...], order: I64, touch: Bool) -> Found:
        """Move several people, in an order, to where they explain best together."""
        n = len(people.poses)
        found = Found(np.empty(n), np.zeros((n, 6)), np.empty((n, 3)), np.zeros((n, body.FACINGS // 2)))
        ascent.explain(people, prior, order, touch, self.arrays, self._of.table, self._of.model, found)
        return found

    def layer(self, people: People, others: I64, reaching: I64 | None = None) -> None:
        """Take these people for the others on the rays, whose bodies cannot be entered; ``reaching``: those whose arms
        and shadows may be on the ground, the others unless given."""
        self._people, self._others, of = people, others, self._of
        near = others if reaching is None else reaching
        kernels.lay_others(self.arrays, people, others, near, of.table, of.model)

    def log_ratio(self, pose: F64, tall: F64, ratios: F32) -> float:
        """Log-likelihood ratio of one more person at a pose to the others alone."""
        of = self._of
        return float(kernels.log_ratio(tuple(pose.tolist()), float(tall[0]), ratios, self.arrays, of.table, of.model))

    def log_prior(self, pose: F64, tall: F64, others: I64 | None = None) -> float:
        """Logarithm of the prior of a pose; ``others`` are those of the layers unless given."""
        near = self._people, self._others if others is None else others
        return float(ascent.log_prior(tuple(pose.tolist()), tuple(tall.tolist()), near, self._of.model))

    def evidence(self, pose: F64, tall: F64, ratios: F32) -> float:
        """For a person: both together."""
        return self.log_ratio(pose, tall, ratios) + self.log_prior(pose, tall)

    def ascend(
        self, pose: F64, predicted: F64, known: AnyArray, tall: F64, ratios: F32, steps: F64 = STEPS_M
    ) -> tuple[float, F64]:
        """Move a pose to where it explains best.

        Args:
            known: (1,) of KNOWN, of the pose before the frame, see ``about``.

        Returns:
            The evidence there; (6,) curvature of the log-likelihood ratio there: along the ray, across it, in height
            [1/m^2], in facing [1/rad^2], in lean and, in masks, along the head's ray [1/m^2].
        """
        curvature, of = np.zeros(6), self._of
        evidence = ascent.ascend(
            pose, curvature, (predicted, known, steps), (*tall.tolist(), ratios), (self._people, self._others),
            self.arrays, of.table, of.model,
        )  # fmt: skip
        return float(evidence), curvature

    def against_thing(self, pose: F64, tall: F64) -> float:
        """Log-likelihood ratio of a person at a pose to the thing that explains the same pixels best."""
        nobody = np.ones((PARTS, CODES), np.float32)
        things, others = [], (self._people, self._others)
        for table in body.thing_tables():
            start = pose * THING_START
            at, prior = start.copy(), (start, about(body.TORSO.torso_radius_m, math.inf), STEPS_M)
            size = float(start[2]), ANY_HEIGHT_M, nobody
            ascent.ascend(at, np.zeros(6), prior, size, others, self.arrays, table, self._of.model)
            at_end = tuple(at.tolist())
            things.append(float(kernels.log_ratio(at_end, at_end[2], nobody, self.arrays, table, self._of.model)))
        return self.log_ratio(pose, tall, nobody) - max(things)

    def visible(self, pose: F64, tall: F64, ratios: F32) -> F64:
        """(3,) patches of a body that it explains better than all else, that show something, and that are in view."""
        seen, of = np.empty(3), self._of
        kernels.visible(tuple(pose.tolist()), (*tall.tolist(), ratios), self.arrays, of.table, of.model, seen)
        return seen

    def noise(self, pose: F64, curvature: F64) -> tuple[F64, float]:
        """Covariance (2, 2) of the place [m^2] and information on the height [1/m^2], from a curvature."""
        s, (x, y), (n, main, _) = self.arrays, pose[:2].tolist(), self.arrays.size.tolist()
        ax, ay = (x - float(s.rays[CX, main]), y - float(s.rays[CY, main])) if n else (1.0, 0.0)
        norm = max(math.hypot(ax, ay), 1e-6)
        ax, ay = ax / norm, ay / norm
        va, vc = (max(1.0 / max(b, 5.0), PLACE_STD_MIN_M**2) for b in curvature[:2].tolist())
        xy = (va - vc) * ax * ay
        return np.array([[va * ax * ax + vc * ay * ay, xy], [xy, va * ay * ay + vc * ax * ax]]), max(
            float(curvature[2]), 0.0
        )
