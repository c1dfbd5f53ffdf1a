"""One frame explained by people at some places, and the search for the places that explain it best."""

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
from planview.tracking.explain.samples import (
    CX,
    CY,
    PARTS,
    POSE_PRIOR,
    Appearance,
    Model,
    Others,
    PosePrior,
    SampleArrays,
    Search,
    Searches,
    ViewArrays,
)

STEPS_M = np.array([0.12, 0.05])
"""Steps of the ascent: a walker's error of prediction, and half a patch [m]."""
PLACE_STD_MIN_M = 0.02
"""A place is never known better [m]: a body leans and swings."""
SHARED_DISPARITY_PX = 0.06
"""Deviation of the error of disparity that all pixels of a body share: calibration, and matching that prefers whole
pixels [px]."""
PLACE_SHARE = 0.02
"""Deviation of a real person's place for each metre from the sensor to the head: heads lead trunks, bodies are not
their table, colour and depth are registered to a degree (four real recordings, heads 1 to 4.5 m away)."""
BOX_HALF_M = 0.4
"""Half width of the box that a body is in [m]."""
ANYBODY = np.array([body.HEIGHT_MEAN_M, body.HEIGHT_STD_M])
"""Height when upright of an unknown person, and its deviation [m]."""
THING_START = np.array([1.0, 1.0, 0.8, 1.0, 0.0])
"""The best thing is searched from a person's place and shoulders."""
ANY_HEIGHT_M = 1e3
NO_COLOURS = np.ones((PARTS, CODES), np.float32)
"""Ratios of colours of somebody whose clothes are not known."""


def loose_prior(std_m: float, height_std_m: float) -> AnyArray:
    """(1,) of POSE_PRIOR: place and height are predicted with these deviations, and any facing is as likely."""
    return np.array([PosePrior(std_m**-2, 0.0, std_m**-2, height_std_m**-2)], POSE_PRIOR)


def upright_pose(place: Sequence[float]) -> F64:
    """(5,) pose of somebody of x, y, height [m] who faces along x and does not lean."""
    return np.array([*place, 0.0, 0.0])


class Likelihood(NamedTuple):
    """Assumptions that kernels need besides the pixels.

    Attributes:
        model: (1,) array of one ``Model``.
        table: of the body.
        areas: (A,) float64 number of cells of the table that a body covers, a mean over postures, by the depression of
            the ray.
        disparity_std_px: deviation of a disparity.
    """

    model: Any
    table: body.BodyTable
    areas: F64
    disparity_std_px: float

    @staticmethod
    def of(model: Model, table: body.BodyTable, disparity_std_px: float = 0.0) -> Likelihood:
        """Likelihood under these assumptions; an array of one record costs a call less than a tuple."""
        record = np.array([tuple(model)], dtype=[(name, np.float64) for name in model._fields])
        areas = table.cover.sum(axis=(0, 2, 3)) / len(table.cover)
        return Likelihood(record, table, areas, disparity_std_px)

    def colourless(self) -> Likelihood:
        """The same where colours are unknown."""
        model = self.model.copy()
        model["colour"] = 0.0
        return self._replace(model=model)


class Owners(NamedTuple):
    """Owners of M pixels of one camera.

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
        existence: (N,) float64 probabilities.
        statures: (N, 2) float64 height when upright and its deviation [m].
        ratios: (N, PARTS, CODES) float32 colours over those of anybody.
    """

    poses: F64
    existence: F64
    statures: F64
    ratios: F32

    def person(self, i: int) -> tuple[F64, F64, F32]:
        """Pose, stature and colours of one of them."""
        return self.poses[i], self.statures[i], self.ratios[i]

    def with_one(self, pose: F64) -> People:
        """These people and one more, unknown person."""
        return People(
            np.concatenate([self.poses, pose[None]]),
            np.append(self.existence, 1.0),
            np.concatenate([self.statures, ANYBODY[None]]),
            np.concatenate([self.ratios, NO_COLOURS[None]]),
        )


class Fits(NamedTuple):
    """Result of explaining N people together (``_ascent_kernels.explain``).

    Attributes:
        evidence: (N,) log-likelihood ratio of with to without each, plus the logarithm of the prior of the pose.
        curvature: (N, 6) of that ratio, see ``Samples.ascend``.
        patches: (N, 3) see ``Samples.visible_patches``.
        by_facing: (N, FACINGS / 2) the ratios of an upright body by its facing; 0 where a body looks the same from
            everywhere.
    """

    evidence: F64
    curvature: F64
    patches: F64
    by_facing: F64

    @staticmethod
    def empty(n: int) -> Fits:
        """Room for n people."""
        return Fits(np.empty(n), np.zeros((n, 6)), np.empty((n, 3)), np.zeros((n, body.FACINGS // 2)))


class Explanation:
    """One frame of all cameras.

    Args:
        views: what the cameras saw.
        likelihood: of their pixels.

    Attributes:
        coloured: colours distinguish people: all that is seen of them has a code.
        arrays: the views as kernels take them.
    """

    def __init__(self, views: Sequence[View], likelihood: Likelihood) -> None:
        self.views = views
        no_colours = [view for view in views if view.colour is None and (view.kind == SURFACE).any()]
        self.coloured = bool(likelihood.model["colour"][0] > 0) and not no_colours
        self.likelihood = likelihood if self.coloured else likelihood.colourless()
        self.arrays = [self._arrays_of(view) for view in views]

    def _arrays_of(self, view: View) -> ViewArrays:
        std_per_m2 = self.likelihood.disparity_std_px / view.rays.disparity_metre
        colour = view.colour if view.colour is not None else view.kind
        return ViewArrays(view.rays, std_per_m2, view.kind, view.range_m, colour)

    def samples_around(self, poses: F64, reach_m: float) -> Samples:
        """Samples of all cameras within reach of each of (N, 5) bodies, or of one (5,)."""
        bodies = np.atleast_2d(poses)
        arrays = SampleArrays.empty(len(bodies), gathering.SAMPLES_OF_VIEW * len(self.arrays))
        for view in self.arrays:
            gathering.gather(bodies, reach_m, view, arrays, self.likelihood.table, self.likelihood.model)
        return Samples(self.likelihood, arrays if poses.ndim == 2 else arrays.person(0))

    def boxes(self, k: int, poses: F64, half_m: float) -> I64:
        """(N, 4) int64 left, top, right, bottom of bodies in view k [px]."""
        boxes = np.empty((len(poses), 4))
        gathering.boxes(poses, half_m, self.arrays[k], boxes)
        return boxes.astype(np.int64)

    def in_view(self, point_m: F64) -> bool:
        """True if a point of the world is inside of an image."""
        for view in self.views:
            u, v, depth = view.rays.projection @ np.append(point_m[:3], 1.0)
            rows, cols = view.kind.shape
            if depth > 0 and 0 <= u <= (cols - 1) * depth and 0 <= v <= (rows - 1) * depth:
                return True
        return False

    def shows_height(self, pose: F64, tall_m: float, std_m: float) -> bool:
        """True if the head of a pose is in view and, of one much lower than somebody ``tall_m``, that one's too: else
        what is in view may be the legs of anybody."""
        if not self.in_view(pose):
            return False
        is_low = float(pose[2]) < tall_m - 2.0 * std_m
        return not is_low or self.in_view(np.array([*pose[:2], tall_m]))

    def shared_std_m(self, pose: F64) -> float:
        """Deviation of a place by the errors that all pixels share, in the camera that shows it best."""
        stds_m = []
        for view in self.views:
            far_m = math.dist(pose[:2], view.rays.centre_m[:2])
            away_m = math.dist(pose[:3], view.rays.centre_m)
            disparity_share = SHARED_DISPARITY_PX / view.rays.disparity_metre * far_m
            stds_m.append(math.hypot(disparity_share, PLACE_SHARE) * away_m)
        return min(stds_m)

    def share_rays(self, poses: F64) -> Bool:
        """(N, N) pairs of people who may be on one ray of a camera; nobody with oneself."""
        shared = np.zeros((len(poses), len(poses)), np.bool_)
        for view in self.arrays:
            gathering.mark_shared_rays(poses, BOX_HALF_M, view, shared)
        np.fill_diagonal(shared, False)
        return shared

    def order_by_distance(self, poses: F64) -> I64:
        """(N,) int64 order of people by their distance on the floor from the nearest camera, nearest first."""
        cameras_m = np.array([view.rays.centre_m[:2] for view in self.views])
        away = poses[:, :2] - cameras_m[:, None]
        return np.argsort(np.hypot(away[..., 0], away[..., 1]).min(axis=0))

    def whole_patches(self, pose: F64) -> float:
        """Patches of a body that is wholly in view, a mean over the cameras."""
        table = self.likelihood.table
        patch_m = float(self.likelihood.model["patch_m"][0])
        cell_patches = (table.cell_m * pose[2] / body.TORSO.height_m / patch_m) ** 2
        total = 0.0
        for view in self.views:
            away_m = math.dist(pose[:2], view.rays.centre_m[:2])
            depression = math.atan2(view.rays.centre_m[2] - 0.5 * pose[2], away_m)
            angle = round((depression - table.angle_min_rad) / table.angle_step_rad)
            area = float(self.likelihood.areas[min(max(angle, 0), table.cover.shape[1] - 1)])
            total += area * cell_patches
        return total / len(self.views)

    def assign_pixels(self, people: People, kind: int = SURFACE) -> list[Owners]:
        """Owners of the pixels of a kind in each view."""
        return [self.owners(k, people, np.flatnonzero(view.kind == kind)) for k, view in enumerate(self.views)]

    def owners(self, k: int, people: People, pixels: I64) -> Owners:
        """Owners of some pixels of view k, all of one kind."""
        model = self.likelihood.model
        table = self.likelihood.table
        samples = SampleArrays.empty(1, len(pixels)).person(0)
        gathering.take_pixels(pixels, self.arrays[k], samples, table, model)
        everybody = np.arange(len(people.poses))
        kernels.lay_others(samples, people, everybody, everybody, table, model)
        owner = np.empty(len(pixels), np.int64)
        each = np.empty((4, len(pixels)), np.float32)
        kernels.assign_pixels(samples, people.poses, model, owner, each)
        share, height, patches, lacking = each
        colours = self.arrays[k].colour.reshape(-1)[pixels]
        return Owners(pixels, colours, owner, share, height, patches, lacking, samples.pixels["near"].view(np.bool_))


class Samples:
    """The samples around one person, or around each of several, and the layers of others on their rays."""

    def __init__(self, likelihood: Likelihood, arrays: SampleArrays) -> None:
        self._table = likelihood.table
        self._model = likelihood.model
        self._likelihood = likelihood
        self.arrays = arrays
        self._others: Others

    def person(self, k: int) -> Samples:
        """Samples of one of several people."""
        return Samples(self._likelihood, self.arrays.person(k))

    def explain(self, people: People, searches: Searches, order: I64, shared: Bool) -> Fits:
        """Move several people, in an order, to where they explain best together."""
        fits = Fits.empty(len(people.poses))
        ascent.explain(people, searches, order, shared, self.arrays, self._table, self._model, fits)
        return fits

    def lay_others(self, people: People, others: I64, reaching: I64 | None = None) -> None:
        """Lay these people on the rays, whose bodies cannot be entered; ``reaching``: those whose arms and shadows may
        be on the ground, the others unless given."""
        self._others = Others(people, others)
        near = others if reaching is None else reaching
        kernels.lay_others(self.arrays, people, others, near, self._table, self._model)

    def log_ratio(self, pose: F64, stature: F64, ratios: F32) -> float:
        """Log-likelihood ratio of one more person at a pose to the others alone."""
        at = tuple(pose.tolist())
        return float(kernels.log_ratio(at, float(stature[0]), ratios, self.arrays, self._table, self._model))

    def log_prior(self, pose: F64, stature: F64, others: I64 | None = None) -> float:
        """Logarithm of the prior of a pose; ``others`` are those of the layers unless given."""
        near = self._others if others is None else self._others._replace(which=others)
        person = Appearance(float(stature[0]), float(stature[1]), NO_COLOURS)
        return float(ascent.log_prior(tuple(pose.tolist()), person, near, self._model))

    def evidence(self, pose: F64, stature: F64, ratios: F32) -> float:
        """Evidence for a person: both together."""
        return self.log_ratio(pose, stature, ratios) + self.log_prior(pose, stature)

    def ascend(
        self, pose: F64, predicted: F64, prior: AnyArray, stature: F64, ratios: F32, steps: F64 = STEPS_M
    ) -> tuple[float, F64]:
        """Move a pose to where it explains best.

        Args:
            prior: (1,) of POSE_PRIOR, see ``loose_prior``.

        Returns:
            The evidence there; (6,) curvature of the log-likelihood ratio there: along the ray, across it, in height
            [1/m^2], in facing [1/rad^2], in lean and, in masks, along the head's ray [1/m^2].
        """
        curvature = np.zeros(6)
        search = Search(predicted, prior, steps)
        person = Appearance(float(stature[0]), float(stature[1]), ratios)
        evidence = ascent.ascend(pose, curvature, search, person, self._others, self.arrays, self._table, self._model)
        return float(evidence), curvature

    def against_things(self, pose: F64, stature: F64) -> F64:
        """(K,) log-likelihood ratios of a person at a pose to a thing of each shape where it explains best."""
        in_a_coat = self._best_near(pose, body.coat_table()) + math.log(body.COAT_SHARE)
        person = max(self.log_ratio(pose, stature, NO_COLOURS), in_a_coat)
        return person - np.array([self._best_near(pose, table) for table in body.thing_tables()])

    def _best_near(self, pose: F64, table: body.BodyTable) -> float:
        """Log-likelihood ratio of what a table shows, where it explains best near a person's pose."""
        start = pose * THING_START
        search = Search(start, loose_prior(body.TORSO.torso_radius_m, math.inf), STEPS_M)
        at = start.copy()
        look = Appearance(float(start[2]), ANY_HEIGHT_M, NO_COLOURS)
        ascent.ascend(at, np.zeros(6), search, look, self._others, self.arrays, table, self._model)
        end = tuple(at.tolist())
        return float(kernels.log_ratio(end, end[2], NO_COLOURS, self.arrays, table, self._model))

    def visible_patches(self, pose: F64, stature: F64, ratios: F32) -> F64:
        """(3,) patches of a body that it explains better than all else, that show something, and that are in view."""
        patches = np.empty(3)
        at = tuple(pose.tolist())
        kernels.visible_patches(at, float(stature[0]), ratios, self.arrays, self._table, self._model, patches)
        return patches

    def precision(self, pose: F64, curvature: F64) -> tuple[F64, float]:
        """Covariance (2, 2) of the place [m^2] and information on the height [1/m^2], from a curvature."""
        n, main, _ = self.arrays.size.tolist()
        along_x = 1.0
        along_y = 0.0
        if n:
            along_x = float(pose[0]) - float(self.arrays.rays[CX, main])
            along_y = float(pose[1]) - float(self.arrays.rays[CY, main])
        norm = max(math.hypot(along_x, along_y), 1e-6)
        along_x /= norm
        along_y /= norm
        along_var = _place_var(float(curvature[0]))
        across_var = _place_var(float(curvature[1]))
        xx = along_var * along_x * along_x + across_var * along_y * along_y
        yy = along_var * along_y * along_y + across_var * along_x * along_x
        xy = (along_var - across_var) * along_x * along_y
        return np.array([[xx, xy], [xy, yy]]), max(float(curvature[2]), 0.0)


def _place_var(curvature: float) -> float:
    """Variance of a place along an axis [m^2]."""
    return max(1.0 / max(curvature, 5.0), PLACE_STD_MIN_M**2)
