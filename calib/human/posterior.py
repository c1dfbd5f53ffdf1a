"""Several cameras that explain samples, with their probabilities, as one camera and its covariance; ours.

How strongly people lean towards the image's edges goes with the square of the focal length, so that a short one seems
better known than it is: its distribution is skewed, and is followed over a row of focal lengths that are held.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.human.knowledge import FOCAL, HEIGHT, N_CAMERA, N_SHARED, ROLL, TILT
from calib.human.model import HumanModel
from calib.human.refine import GroundCameraFit, refine
from calib.human.samples import People
from calib.types import F64

MIN_PROBABILITY = 0.01
"""Cameras less probable are left out [1] (our choice)."""
HELD_STD = 1e-3
"""Deviation at which a focal length is held [1]."""
PROFILE = (-0.55, -0.3, -0.13, 0.13, 0.3, 0.55)
"""Logs of the focal lengths that are held, over the best one (our choice: half to twice)."""
OUTLINE_PX = 2.0
"""By so much the ends of outlines err alike [px] (our choice: as much as a hand errs at each)."""
MIN_PROFILED_STD = 0.06
"""A focal length known better is as good as normally distributed [1] (our choice)."""


@dataclass(frozen=True, eq=False)
class CameraPosterior:
    """What is known of a camera.

    Attributes:
        fit: the camera at the mean focal length, with the covariance about it of all alternatives together.
        alternatives: cameras that explain the samples too; with covariances of their own.
        weights: (n,) their probabilities, which sum to 1.
    """

    fit: GroundCameraFit
    alternatives: Sequence[GroundCameraFit]
    weights: F64


def posterior_of(fits: Sequence[GroundCameraFit], people: People, model: HumanModel) -> CameraPosterior:
    """The posterior of several fits (lenses, readings of the samples), the best of them first."""
    best = fits[0]
    nodes = _profile(best, people, model)
    others = list(fits[1:])
    weights = np.array([*(n.log_evidence for n in nodes), *(o.log_evidence for o in others)])
    weights = np.exp(weights - weights.max())
    # The nodes share the probability of the best fit.
    share = np.exp(np.array([best.log_evidence, *(o.log_evidence for o in others)]) - best.log_evidence)
    share = np.minimum(share, 1.0) / np.minimum(share, 1.0).sum()
    weights = np.append(share[0] * weights[: len(nodes)] / weights[: len(nodes)].sum(), share[1:])
    every = [*nodes, *others]
    kept = [i for i, fit in enumerate(every) if weights[i] >= MIN_PROBABILITY and np.isfinite(fit.covariance).all()]
    if not kept:
        return CameraPosterior(best, (best,), np.ones(1))
    alternatives, weights = [every[i] for i in kept], weights[kept] / weights[kept].sum()
    mean = best if len(alternatives) == 1 else _at_mean(best, alternatives, weights, people, model)
    off = np.stack([shared_of(fit) - shared_of(mean) for fit in alternatives])
    # Width and stature are not of interest beyond the best fit.
    off[:, N_CAMERA:] = 0.0
    covariance = np.einsum("i,ijk->jk", weights, np.stack([f.covariance for f in alternatives]))
    return CameraPosterior(replace(mean, covariance=covariance + (weights * off.T) @ off), alternatives, weights)


def with_outline_errors(posterior: CameraPosterior, people: People, model: HumanModel) -> CameraPosterior:
    """The posterior of samples that are outlines of foreground, whose ends err alike.

    Shadows, blur and compression end all feet, or all heads, a little too high or too low; far people are smaller, so
    that this looks like another tilt and focal length, and no number of people averages it out. What the camera moves
    by when all of them are moved is added to its covariance.
    """
    fit = posterior.fit
    still = shared_of(_refitted(fit, people, model))
    axis = people.rows[:, 6:] - people.rows[:, 4:6]
    along = axis / np.maximum(np.hypot(*axis.T), 1e-9)[:, None]
    moves = []
    number, upright = np.arange(len(people)), along[:, 1] >= 0
    for point, edge in ((slice(4, 6), np.where(upright, 1, 3)), (slice(6, 8), np.where(upright, 3, 1))):
        rows = people.rows.copy()
        rows[:, point] += OUTLINE_PX * along
        rows[number, edge] += OUTLINE_PX * along[:, 1]
        moves.append(shared_of(_refitted(fit, replace(people, rows=rows), model)) - still)
    moved = np.stack(moves)
    moved[:, N_CAMERA:] = 0.0
    more = moved.T @ moved
    alternatives = [replace(other, covariance=other.covariance + more) for other in posterior.alternatives]
    return replace(posterior, fit=replace(fit, covariance=fit.covariance + more), alternatives=alternatives)


def _refitted(fit: GroundCameraFit, people: People, model: HumanModel) -> GroundCameraFit:
    return refine(fit.camera, people, model, fit.prior, fit.variation)


def shared_of(fit: GroundCameraFit) -> F64:
    """(N_SHARED,) shared unknowns of a fit."""
    values, camera = np.zeros(N_SHARED), fit.camera
    values[[FOCAL, HEIGHT]] = math.log(camera.focal_px), math.log(camera.height_m)
    values[[TILT, ROLL]] = camera.tilt_rad, camera.roll_rad
    values[N_CAMERA:] = math.log(fit.girth), math.log(fit.stature)
    return values


def _profile(best: GroundCameraFit, people: People, model: HumanModel) -> list[GroundCameraFit]:
    """The best camera at focal lengths beside its own; their evidences are those of the nodes of an integral."""
    if not MIN_PROFILED_STD < math.sqrt(best.covariance[FOCAL, FOCAL]) < math.inf:
        return [best]
    focal, prior = math.log(best.camera.focal_px), best.prior
    steps = np.array([*PROFILE[: len(PROFILE) // 2], 0.0, *PROFILE[len(PROFILE) // 2 :]])
    nodes = []
    for step, width in zip(steps, np.gradient(steps), strict=True):
        fit = _held(best, focal + step, people, model)
        pull = (focal + step - prior.mean[FOCAL]) / prior.std[FOCAL]
        evidence = fit.log_evidence - 0.5 * pull**2 + math.log(width)
        nodes.append(replace(fit, log_evidence=evidence))
    return nodes


def _held(fit: GroundCameraFit, log_focal: float, people: People, model: HumanModel) -> GroundCameraFit:
    """The best camera of a focal length."""
    mean, std = fit.prior.mean.copy(), fit.prior.std.copy()
    mean[FOCAL], std[FOCAL] = log_focal, HELD_STD
    started = replace(fit.camera, focal_px=math.exp(log_focal))
    held = refine(started, people, model, replace(fit.prior, mean=mean, std=std), fit.variation)
    return replace(held, prior=fit.prior)


def _at_mean(
    best: GroundCameraFit, alternatives: Sequence[GroundCameraFit], weights: F64, people: People, model: HumanModel
) -> GroundCameraFit:
    """The best fit at the mean focal length of the alternatives of its lens."""
    alike = [(math.log(f.camera.focal_px), w) for f, w in zip(alternatives, weights, strict=True) if _same(f, best)]
    logs, shares = np.array(alike).T
    return _held(best, float(logs @ shares / shares.sum()), people, model)


def _same(one: GroundCameraFit, other: GroundCameraFit) -> bool:
    return one.camera.lens == other.camera.lens
