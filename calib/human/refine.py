"""Generalised least squares on head, foot and box after the search of ``calib.human.search``; our addition.

The paper's error sums distances, and a box as a ratio of areas; its minimum scatters two to three times as much as
least squares on the same pixels. People differ in height and lean; both move head, foot and box together, so that the
residuals of a person are whitened by their covariance. How flat the minimum is tells how well the camera is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from calib.ground_camera import GroundCamera
from calib.human.knowledge import (
    FOCAL,
    GIRTH,
    HEIGHT,
    LEAN_M,
    N_SHARED,
    ROLL,
    STATURE,
    TILT,
    WIDTH_STD,
    CameraPrior,
)
from calib.human.model import HumanModel
from calib.human.samples import People
from calib.types import F64, Bool

POINT_PX = 2.0
"""Deviation of a point or edge marked by hand [px] (our choice: what people reach on a screen)."""
BODY_SHARE = 0.02
"""Arms and steps move the edges of a box by this share of its diagonal [1]: some 4 cm of 1.8 m (our choice)."""
ROBUST_FROM = 2.0
"""Residuals beyond this many deviations count by their size instead of its square (our choice)."""
MAX_EVALUATIONS = (12, 40)
"""Evaluations in the first and in the second round of ``refine``; where the variation of people is given, there is but
the first."""
VARIATIONS = (1.0, 0.5, 0.25)
"""People are tried as varying so much as expected, and less [1]: one person who walks upright varies little. Each step
down must raise the log-likelihood by 2 (our choice)."""
FAR = 1e4
"""Residual of what is behind a camera."""


@dataclass(frozen=True, eq=False)
class GroundCameraFit:
    """Result of ``refine``.

    Attributes:
        camera: at the minimum.
        prior: what it was fitted with.
        log_evidence: of the samples under this lens and prior (Laplace's approximation), up to a constant.
        covariance: (N_SHARED, N_SHARED) of the shared unknowns, larger where people fit worse than expected; inf when
            undetermined.
        girth, stature: width and mean height of the people against the model's [1].
        places_m: (n, 2) where the people stand.
        variation: how much people vary, over what is expected [1].
        deviations: (n,) root mean square of the whitened residuals of every person; 1 is expected.
    """

    camera: GroundCamera
    prior: CameraPrior
    log_evidence: float
    covariance: F64
    girth: float
    stature: float
    places_m: F64
    variation: float
    deviations: F64


def refine(
    camera: GroundCamera, people: People, model: HumanModel, prior: CameraPrior, variation: float | None = None
) -> GroundCameraFit:
    """Move camera, people and their common width and height to the least squares of all edges and points.

    Args:
        camera: from the search.
        people: the samples.
        model: the person; its height is what gives the scale.
        prior: of the shared unknowns.
        variation: how much people vary, over what is expected [1]; None finds it.
    """
    shared = np.zeros(N_SHARED)
    shared[[FOCAL, HEIGHT, TILT, ROLL]] = (
        math.log(camera.focal_px), math.log(camera.height_m), camera.tilt_rad, camera.roll_rad,
    )  # fmt: skip
    values = np.append(shared, _stand(camera, people.rows, model))
    scale = 1.0 if variation is None else variation
    for evaluations in MAX_EVALUATIONS if variation is None else MAX_EVALUATIONS[:1]:
        # What people vary by moves head, foot and box together; how much depends on where the camera is.
        residuals = Residuals(camera, people, model, prior, values, scale)
        found = least_squares(
            residuals, values, residuals.jacobian, loss=residuals.loss, x_scale="jac", ftol=1e-5, max_nfev=evaluations
        )
        values = found.x
        if variation is None:
            scale = max(VARIATIONS, key=lambda q: _likelihood(Residuals(camera, people, model, prior, values, q)))
    covariance = _covariance(found.jac)
    volume = np.linalg.slogdet(covariance)[1] if np.isfinite(covariance).all() else 0.0
    # The prior's own normalisation: a wide prior promises less.
    known = np.isfinite(prior.std)
    evidence = -found.cost - residuals.log_spread + 0.5 * volume - float(np.log(prior.std[known]).sum())
    shared = values[:N_SHARED]
    squares = residuals.of_samples(values).reshape(-1, 8) ** 2
    deviations = np.sqrt(squares.sum(axis=1) * people.repeats / 6.0)
    return GroundCameraFit(
        shared_camera(shared, camera),
        prior,
        float(evidence),
        covariance * max(1.0, float(np.median(deviations))) ** 2,
        math.exp(shared[GIRTH]),
        math.exp(shared[STATURE]),
        values[N_SHARED:].reshape(-1, 2),
        residuals.variation,
        deviations,
    )


class Residuals:
    """Residuals of the samples, 8 per person, and then those of the prior; in deviations [1]."""

    def __init__(
        self,
        camera: GroundCamera,
        people: People,
        model: HumanModel,
        prior: CameraPrior,
        values: F64,
        variation: float = 1.0,
    ) -> None:
        """Args as of ``refine``.

        ``values`` are the unknowns at which the covariances of people are taken, ``variation`` scales what people vary
        by [1].
        """
        self.camera, self.people, self.prior, self.values, self.variation = camera, people, prior, values, variation
        self.body = body_points(model)
        shared, places = values[:N_SHARED], values[N_SHARED:].reshape(-1, 2)
        covariance = people.repeats * person_covariance(shared, places, people, self._predicted, variation)
        self.whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        self.log_spread = 0.5 * float(np.linalg.slogdet(covariance)[1].sum())

    def __call__(self, values: F64) -> F64:
        return np.append(self.of_samples(values), (values[:N_SHARED] - self.prior.mean) / self.prior.std)

    def jacobian(self, values: F64, step: float = 1e-7) -> F64:
        """(8 n + N_SHARED, N_SHARED + 2 n) derivatives; a person's place moves only that person's rows."""
        n, here = len(self.people), self.of_samples(values)
        jacobian = np.zeros((8 * n + N_SHARED, len(values)))
        for k in range(N_SHARED):
            jacobian[: 8 * n, k] = self._slope(values, here, np.arange(len(values)) == k, step).ravel()
        numbers = np.arange(n)
        blocks = jacobian[: 8 * n].reshape(n, 8, len(values))
        for k in range(2):
            moved = np.arange(len(values)) >= N_SHARED
            moved[N_SHARED + 1 - k :: 2] = False
            blocks[numbers, :, N_SHARED + 2 * numbers + k] = self._slope(values, here, moved, step)
        jacobian[8 * n :, :N_SHARED] = np.diag(1.0 / self.prior.std)
        return jacobian

    def loss(self, squares: F64) -> F64:
        """(3, m) robust loss of squared residuals and its two derivatives: soft L1 for samples, none for the prior.

        The prior of people's width has Cauchy's tails: marked as hulls they have the model's width, and as boxes around
        arms and strides, any.
        """
        loss = np.stack([squares, np.ones_like(squares), np.zeros_like(squares)])
        n, scale = 8 * len(self.people), ROBUST_FROM**2
        root = np.sqrt(1.0 + squares[:n] / scale)
        # Without its second derivative the step is that of reweighted least squares, which far residuals keep definite.
        loss[0, :n], loss[1, :n] = 2.0 * scale * (root - 1.0), 1.0 / root
        width = n + GIRTH
        loss[0, width], loss[1, width] = math.log1p(squares[width]), 1.0 / (1.0 + squares[width])
        return loss

    def of_samples(self, values: F64) -> F64:
        """(8 n,) whitened residuals of the samples."""
        shared, places = values[:N_SHARED], values[N_SHARED:].reshape(-1, 2)
        if not (abs(shared[TILT]) < math.pi / 2 - 1e-3 and abs(shared[ROLL]) < 0.5 and np.abs(shared).max() < 12.0):
            return np.full(8 * len(self.people), FAR)
        off = self._predicted(shared, places, np.zeros((len(places), 4))) - self.people.rows
        off = np.clip(np.nan_to_num(off, nan=FAR, posinf=FAR, neginf=-FAR), -FAR, FAR)
        return np.asarray((self.whiten @ off[..., None]).ravel())

    def _predicted(self, shared: F64, places: F64, odd: F64) -> F64:
        stature = np.where(self.people.told, 0.0, shared[STATURE])
        size = self.people.scale * np.exp(stature + odd[:, 0])
        width = np.exp(shared[GIRTH] + odd[:, 3])
        return predict(shared, places, odd[:, 1:3], size, width, self.camera, self.body, self.prior)

    def _slope(self, values: F64, here: F64, moved: Bool, step: float) -> F64:
        """(n, 8) derivative by all the unknowns marked in ``moved`` at once."""
        return ((self.of_samples(values + step * moved) - here) / step).reshape(-1, 8)


def _likelihood(residuals: Residuals) -> float:
    """Robust log-likelihood of the samples where the residuals' covariances were taken."""
    squares = residuals(residuals.values) ** 2
    cost = 0.5 * float(residuals.loss(squares)[0, : 8 * len(residuals.people)].sum())
    return -cost - residuals.log_spread + 2.0 * math.log2(residuals.variation)


Predict = Callable[[F64, F64, F64], F64]
"""Rows (n, 8) from the shared unknowns, places (n, 2) and peculiarities (n, 4): log height, lean along x and y [m], log
width."""


def person_covariance(shared: F64, places: F64, people: People, predicted: Predict, variation: float) -> F64:
    """(n, 8, 8) covariance of every person's row: marking, arms and steps, height, lean and width."""
    rows = people.rows
    diagonal = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1])[:, None]
    sigma = np.hypot(POINT_PX, BODY_SHARE * diagonal) * np.ones((1, 8))
    sigma[:, 4:] = POINT_PX
    covariance = sigma[:, :, None] ** 2 * np.eye(8)
    deviation = np.column_stack([people.scale_std, np.full((len(rows), 3), (LEAN_M, LEAN_M, WIDTH_STD))])
    for k in range(4):
        odd = np.zeros((len(rows), 4))
        odd[:, k] = 1e-4
        slope = (predicted(shared, places, odd) - predicted(shared, places, -odd)) / 2e-4
        slope = np.nan_to_num(slope) * variation * deviation[:, k, None]
        covariance += slope[:, :, None] * slope[:, None, :]
    return covariance


def body_points(model: HumanModel) -> F64:
    """(m, 3) points of a person at the origin [m]: the circles', the top of the head, the middle of the feet."""
    return np.concatenate([model.circles(), [[0.0, 0.0, model.height_m], [0.0, 0.0, 0.0]]])


def predict(
    shared: F64, places: F64, lean: F64, size: F64, width: F64, like: GroundCamera, body: F64, prior: CameraPrior
) -> F64:
    """(n, 8) rows that the camera would give of people.

    Args:
        shared: (N_SHARED,) unknowns.
        places: (n, 2) floor positions [m].
        lean: (n, 2) from the foot's place to below the head [m].
        size: (n,) height of each person over the model's [1].
        width: (n,) width of each over that of a model of its height [1].
        like: a camera of the same image and lens.
        body: of the average person (see ``body_points``).
        prior: how boxes and marks hang together.
    """
    camera = shared_camera(shared, like)
    points = body * size[:, None, None]
    points[..., :2] *= width[:, None, None]
    points[..., :2] += places[:, None] + lean[:, None] * (body[:, 2:] / body[-2, 2])
    pixels = camera.project(points)
    low, high = pixels[:, :-2].min(axis=1), pixels[:, :-2].max(axis=1)
    if prior.boxes_only:
        middle = 0.5 * (low[:, 0] + high[:, 0])
        return np.column_stack([low, high, middle, low[:, 1], middle, high[:, 1]])
    if prior.level_ends:
        low[:, 1], high[:, 1] = pixels[:, -2:, 1].min(axis=1), pixels[:, -2:, 1].max(axis=1)
    return np.concatenate([low, high, pixels[:, -2], pixels[:, -1]], axis=1)


def shared_camera(shared: F64, like: GroundCamera) -> GroundCamera:
    """The camera of the (N_SHARED,) unknowns, with the image and lens of another."""
    focal, height = (float(v) for v in np.exp(shared[[FOCAL, HEIGHT]]))
    return replace(like, focal_px=focal, height_m=height, tilt_rad=float(shared[TILT]), roll_rad=float(shared[ROLL]))


def _stand(camera: GroundCamera, rows: F64, model: HumanModel) -> F64:
    """(n, 2) where the people stand by their feet, or by their heads where the foot is above the horizon."""
    feet = camera.back_project(rows[:, 6:])
    heads = camera.back_project(rows[:, 4:6], model.height_m)
    return np.nan_to_num(np.where(np.isfinite(feet), feet, heads))


def _covariance(jacobian: F64) -> F64:
    """(N_SHARED, N_SHARED) from the robustly weighted Jacobian at the minimum; inf when undetermined."""
    scale = np.sqrt(np.maximum((jacobian**2).sum(axis=0), 1e-30))
    _, singular, axes = np.linalg.svd(jacobian / scale, full_matrices=False)
    if not np.isfinite(singular).all() or singular[-1] < 1e-7 * singular[0]:
        return np.full((N_SHARED, N_SHARED), np.inf)
    half = (axes.T / singular)[:N_SHARED] / scale[:N_SHARED, None]
    return np.asarray(half @ half.T)
