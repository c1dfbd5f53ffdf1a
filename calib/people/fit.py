"""Generalised least squares on heads, feet and boxes of standing people: the camera, and how well it is known; ours.

The paper's error sums distances, and a box as a ratio of areas; its minimum scatters two to three times as much as
least squares on the same pixels. People differ in height and lean; both move head, foot and box together, so that the
residuals of a person are whitened by their covariance. The flatter the minimum, the less is known of the camera.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.ground_camera import GroundCamera
from calib.people.model import (
    FOCAL,
    GIRTH,
    HEIGHT,
    N_CAMERA,
    N_SHARED,
    ROLL,
    STATURE,
    SWAY_STD_M,
    TILT,
    WIDTH_STD,
    CameraPrior,
    HumanModel,
)
from calib.people.samples import MarkedPeople
from calib.types import F64, Bool

POINT_PX = 2.0
"""Deviation of a point or edge marked by hand [px] (what people reach on a screen)."""
STRETCHES = 6
"""Parts of a recording that are left out one by one: about a walker each."""
FAR = 1e4
"""Residual of what is behind a camera."""


@dataclass(frozen=True, eq=False)
class GroundCameraFit:
    """Result of ``fit_camera``.

    Attributes:
        camera, prior: at the minimum, and what it was fitted with.
        log_evidence: of the samples under this lens and prior (Laplace's approximation), up to a constant.
        shared, covariance: (N_SHARED,) unknowns that all people share (see ``calib.people.model``) and their (N_SHARED,
            N_SHARED) covariance, larger where people fit worse than expected; inf when undetermined.
        places_m: (n, 2) where the people stand.
        variation: how much people vary, over what is expected [1].
        deviations: (n,) root mean square of the whitened residuals of every person; 1 is expected.
    """

    camera: GroundCamera
    prior: CameraPrior
    log_evidence: float
    covariance: F64
    shared: F64
    places_m: F64
    variation: float
    deviations: F64

    @property
    def std(self) -> F64:
        """(N_SHARED,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))


def fit_camera(
    camera: GroundCamera, people: MarkedPeople, model: HumanModel, prior: CameraPrior, variation: float | None = None
) -> GroundCameraFit:
    """Move a camera to start with, people marked in its image, and their common width and height to the least squares
    of all edges and points; None finds the variation of people, over what is expected [1], which takes longer."""
    from scipy.optimize import least_squares  # half a second

    # People stand at their feet, or below their heads where the foot is above the horizon.
    feet = camera.back_project(people.rows[:, 6:])
    heads = camera.back_project(people.rows[:, 4:6], model.height_m)
    stand = np.nan_to_num(np.where(np.isfinite(feet), feet, heads))
    shared = np.zeros(N_SHARED)
    shared[FOCAL] = math.log(camera.focal_px)
    shared[HEIGHT] = math.log(camera.height_m)
    shared[TILT] = camera.tilt_rad
    shared[ROLL] = camera.roll_rad
    values = np.append(shared, stand)
    rounds = (12, 40) if variation is None else (12,)
    scale = variation or 1.0
    for evaluations in rounds:
        # What people vary by moves head, foot and box together; how much depends on where the camera is.
        residuals = Residuals(camera, people, model, prior, values, scale)
        result = least_squares(
            residuals, values, residuals.jacobian, loss=residuals.loss, x_scale="jac", ftol=1e-5, max_nfev=evaluations
        )
        values = result.x
        if variation is None:
            # One person who walks upright varies little.
            trials = [Residuals(camera, people, model, prior, values, share) for share in (1.0, 0.5, 0.25)]
            scale = max(trials, key=lambda trial: _score(trial, values)).variation
    covariance = _covariance(result.jac)
    volume = np.linalg.slogdet(covariance)[1] if np.isfinite(covariance).all() else 0.0
    # The prior's own normalisation: a wide prior promises less.
    is_limited = np.isfinite(prior.std)
    evidence = -result.cost - residuals.log_spread + 0.5 * volume - float(np.log(prior.std[is_limited]).sum())
    squares = residuals.of_samples(values).reshape(-1, 8) ** 2
    deviations = np.sqrt(squares.sum(axis=1) * people.repeats / 6.0)
    shared = values[:N_SHARED]
    return GroundCameraFit(
        camera=shared_camera(shared, camera),
        prior=prior,
        log_evidence=float(evidence),
        covariance=covariance * max(1.0, float(np.median(deviations))) ** 2,
        shared=shared,
        places_m=values[N_SHARED:].reshape(-1, 2),
        variation=residuals.variation,
        deviations=deviations,
    )


def _score(residuals: Residuals, values: F64) -> float:
    """Log-likelihood of the samples, which each halving of the variation must raise by 2."""
    return residuals.log_likelihood(values) + 2.0 * math.log2(residuals.variation)


class Residuals:
    """Residuals of the samples, 8 per person, and then those of the prior; in deviations [1]."""

    def __init__(
        self,
        camera: GroundCamera,
        people: MarkedPeople,
        model: HumanModel,
        prior: CameraPrior,
        values: F64,
        variation: float,
    ) -> None:
        """Prepare; ``values`` are the unknowns at which the covariances of people are taken."""
        self.camera = camera
        self.people = people
        self.prior = prior
        self.variation = variation
        self.body = body_points(model)
        covariance = people.repeats * self._person_covariance(values, variation)
        self.whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        self.log_spread = 0.5 * float(np.linalg.slogdet(covariance)[1].sum())

    def __call__(self, values: F64) -> F64:
        return np.append(self.of_samples(values), (values[:N_SHARED] - self.prior.mean) / self.prior.std)

    def jacobian(self, values: F64, step: float = 1e-7) -> F64:
        """(8 n + N_SHARED, N_SHARED + 2 n) derivatives; a person's place moves only that person's rows."""
        n = len(self.people)
        here = self.of_samples(values)
        unknowns = np.arange(len(values))
        jacobian = np.zeros((8 * n + N_SHARED, len(values)))
        for k in range(N_SHARED):
            jacobian[: 8 * n, k] = self._slope(values, here, unknowns == k, step).ravel()
        numbers = np.arange(n)
        blocks = jacobian[: 8 * n].reshape(n, 8, len(values))
        for axis in range(2):
            is_moved = (unknowns >= N_SHARED) & ((unknowns - N_SHARED) % 2 == axis)
            blocks[numbers, :, N_SHARED + 2 * numbers + axis] = self._slope(values, here, is_moved, step)
        jacobian[8 * n :, :N_SHARED] = np.diag(1.0 / self.prior.std)
        return jacobian

    def loss(self, squares: F64) -> F64:
        """(3, m) robust loss of squared residuals and its two derivatives: soft L1 for samples, none for the prior.

        The prior of people's width has Cauchy's tails: marked as hulls they have the model's width, and as boxes around
        arms and strides, any.
        """
        loss = np.stack([squares, np.ones_like(squares), np.zeros_like(squares)])
        # Residuals beyond this many deviations count by their size instead of its square.
        n = 8 * len(self.people)
        scale = 2.0**2
        root = np.sqrt(1.0 + squares[:n] / scale)
        # Without its second derivative the step is that of reweighted least squares, which far residuals keep definite.
        loss[0, :n] = 2.0 * scale * (root - 1.0)
        loss[1, :n] = 1.0 / root
        width = n + GIRTH
        loss[0, width] = math.log1p(squares[width])
        loss[1, width] = 1.0 / (1.0 + squares[width])
        return loss

    def log_likelihood(self, values: F64) -> float:
        """Robust log-likelihood of the samples."""
        losses = self.loss(self(values) ** 2)[0, : 8 * len(self.people)]
        return -0.5 * float(losses.sum()) - self.log_spread

    def of_samples(self, values: F64) -> F64:
        """(8 n,) whitened residuals of the samples."""
        shared = values[:N_SHARED]
        places = values[N_SHARED:].reshape(-1, 2)
        is_upright = abs(shared[TILT]) < math.pi / 2 - 1e-3 and abs(shared[ROLL]) < 0.5
        if not is_upright or np.abs(shared).max() >= 12.0:
            return np.full(8 * len(self.people), FAR)
        off = self._rows(shared, places, np.zeros((len(places), 4))) - self.people.rows
        off = np.clip(np.nan_to_num(off, nan=FAR, posinf=FAR, neginf=-FAR), -FAR, FAR)
        return np.asarray((self.whiten @ off[..., None]).ravel())

    def _person_covariance(self, values: F64, variation: float) -> F64:
        """(n, 8, 8) covariance of every person's row: marking, arms and steps, height, lean and width."""
        rows = self.people.rows
        shared = values[:N_SHARED]
        places = values[N_SHARED:].reshape(-1, 2)
        diagonal = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1])[:, None]
        # Arms and steps move the edges of a box by this share of its diagonal [1]: some 4 cm of 1.8 m.
        sigma = np.hypot(POINT_PX, 0.02 * diagonal) * np.ones((1, 8))
        sigma[:, 4:] = POINT_PX
        covariance = sigma[:, :, None] ** 2 * np.eye(8)
        # Height, lean along x and y, and width of each person.
        deviation = np.empty((len(rows), 4))
        deviation[:, 0] = self.people.scale_std
        deviation[:, 1:] = (SWAY_STD_M, SWAY_STD_M, WIDTH_STD)
        for k in range(4):
            odd = np.zeros((len(rows), 4))
            odd[:, k] = 1e-4
            slope = (self._rows(shared, places, odd) - self._rows(shared, places, -odd)) / 2e-4
            slope = np.nan_to_num(slope) * variation * deviation[:, k, None]
            covariance += slope[:, :, None] * slope[:, None, :]
        return covariance

    def _rows(self, shared: F64, places: F64, odd: F64) -> F64:
        """Rows of people who differ by ``odd`` (n, 4): log height, lean along x and y [m], log width."""
        stature = np.where(self.people.given, 0.0, shared[STATURE])
        size = self.people.scale * np.exp(stature + odd[:, 0])
        width = np.exp(shared[GIRTH] + odd[:, 3])
        camera = shared_camera(shared, self.camera)
        return predict(camera, self.body, places, odd[:, 1:3], size, width, self.prior)

    def _slope(self, values: F64, here: F64, is_moved: Bool, step: float) -> F64:
        """(n, 8) derivative by all the marked unknowns at once."""
        ahead = self.of_samples(values + step * is_moved)
        return ((ahead - here) / step).reshape(-1, 8)


def body_points(model: HumanModel) -> F64:
    """(m, 3) points of a person at the origin [m]: the circles', the top of the head, the middle of the feet."""
    return np.concatenate([model.circles(), [[0.0, 0.0, model.height_m], [0.0, 0.0, 0.0]]])


def predict(camera: GroundCamera, body: F64, places: F64, lean: F64, size: F64, width: F64, prior: CameraPrior) -> F64:
    """(n, 8) rows that the camera would give of people at (n, 2) places, who lean by (n, 2) [m] from foot to head, with
    (n,) heights over the model's and (n,) widths over that of a model of their height [1]."""
    height_share = body[:, 2:] / body[-2, 2]
    points = body * size[:, None, None]
    points[..., :2] *= width[:, None, None]
    points[..., :2] += places[:, None] + lean[:, None] * height_share
    pixels = camera.project(points)
    low = pixels[:, :-2].min(axis=1)
    high = pixels[:, :-2].max(axis=1)
    if prior.reading == "boxes":
        middle = 0.5 * (low[:, 0] + high[:, 0])
        return np.column_stack([low, high, middle, low[:, 1], middle, high[:, 1]])
    if prior.reading == "level":
        low[:, 1] = pixels[:, -2:, 1].min(axis=1)
        high[:, 1] = pixels[:, -2:, 1].max(axis=1)
    return np.concatenate([low, high, pixels[:, -2], pixels[:, -1]], axis=1)


def shared_camera(shared: F64, like: GroundCamera) -> GroundCamera:
    """The camera of the (N_SHARED,) unknowns, with the image and lens of another."""
    focal_px, height_m = np.exp(shared[[FOCAL, HEIGHT]]).tolist()
    tilt_rad = float(shared[TILT])
    roll_rad = float(shared[ROLL])
    return replace(like, focal_px=focal_px, height_m=height_m, tilt_rad=tilt_rad, roll_rad=roll_rad)


def _covariance(jacobian: F64) -> F64:
    """(N_SHARED, N_SHARED) from the robustly weighted Jacobian at the minimum; inf when undetermined."""
    scale = np.sqrt(np.maximum((jacobian**2).sum(axis=0), 1e-30))
    _, singular, axes = np.linalg.svd(jacobian / scale, full_matrices=False)
    if not np.isfinite(singular).all() or singular[-1] < 1e-7 * singular[0]:
        return np.full((N_SHARED, N_SHARED), np.inf)
    half = (axes.T / singular)[:N_SHARED] / scale[:N_SHARED, None]
    return np.asarray(half @ half.T)


def with_stretches_left_out(
    fit: GroundCameraFit, people: MarkedPeople, model: HumanModel, frames: Sequence[int]
) -> GroundCameraFit:
    """The fit with the errors that samples of one walker have in common; ``frames`` are those of the samples.

    How far the camera moves when each stretch of the recording is left out in turn is added to its covariance (the
    jackknife of Tukey 1958 over groups). Without this, errors are three to four deviations.
    """
    stretches = np.array_split(np.argsort(frames, kind="stable"), STRETCHES)
    cameras = []
    for stretch in stretches:
        others = people.without(stretch)
        cameras.append(fit_camera(fit.camera, others, model, fit.prior, fit.variation).shared[:N_CAMERA])
    off = np.array(cameras) - np.mean(cameras, axis=0)
    covariance = fit.covariance.copy()
    covariance[:N_CAMERA, :N_CAMERA] += (STRETCHES - 1) / STRETCHES * off.T @ off
    return replace(fit, covariance=covariance)


def at_mean_focal(best: GroundCameraFit, people: MarkedPeople, model: HumanModel) -> GroundCameraFit:
    """The fit at the mean focal length, with the covariance of the best cameras at other focal lengths about it.

    How strongly people lean towards the image's edges goes with the square of the focal length, so that a short one
    seems better known than it is: its distribution is skewed, and is followed over a row of focal lengths that are
    held.
    """
    # A focal length known better is as good as normally distributed [1].
    if not 0.06 < best.std[FOCAL] < math.inf:
        return best
    # Logs of the focal lengths that are held, over the best one (half to twice).
    steps = np.array([-0.55, -0.3, -0.13, 0.0, 0.13, 0.3, 0.55])
    focals = best.shared[FOCAL] + steps
    nodes = [_fit_at_focal(best, focal, people, model) for focal in focals]
    pulls = (focals - best.prior.mean[FOCAL]) / best.prior.std[FOCAL]
    evidence = np.array([node.log_evidence for node in nodes]) - 0.5 * pulls**2 + np.log(np.gradient(steps))
    is_determined = np.isfinite([node.covariance.sum() for node in nodes])
    weights = np.where(is_determined, np.exp(evidence - evidence.max()), 0.0)
    weights /= weights.sum()
    mean = _fit_at_focal(best, float(weights @ focals), people, model)
    covariance = np.zeros((N_SHARED, N_SHARED))
    for node, weight in zip(nodes, weights, strict=True):
        if weight > 0:
            off = np.where(np.arange(N_SHARED) < N_CAMERA, node.shared - mean.shared, 0.0)
            covariance += weight * (node.covariance + np.outer(off, off))
    return replace(mean, covariance=covariance)


def _fit_at_focal(fit: GroundCameraFit, log_focal: float, people: MarkedPeople, model: HumanModel) -> GroundCameraFit:
    """The best camera of a focal length."""
    mean = fit.prior.mean.copy()
    std = fit.prior.std.copy()
    mean[FOCAL] = log_focal
    std[FOCAL] = 1e-3  # a deviation [1] at which it is as good as fixed
    camera = replace(fit.camera, focal_px=math.exp(log_focal))
    prior = replace(fit.prior, mean=mean, std=std)
    return replace(fit_camera(camera, people, model, prior, fit.variation), prior=fit.prior)
