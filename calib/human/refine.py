"""Least squares on head, foot and box after the search of ``human_calibration``; our addition to the paper.

The paper's error sums distances, and a box as a ratio of areas; its minimum scatters two to three times as much as
least squares on the same pixels. The search finds the right valley, this finds the bottom, and how flat it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calib.ground_camera import GroundCamera
from calib.human.model import HumanModel
from calib.types import F64

POINT_PX = 2.0
"""Deviation of a point or edge marked by hand [px] (our choice: what people reach on a screen)."""
BODY_SHARE = 0.02
"""Arms and steps move the edges of a box by this share of its diagonal [1]: some 4 cm of 1.8 m (our choice)."""
ROBUST_FROM = 2.0
"""Residuals beyond this many deviations count by their size instead of its square (our choice)."""
MAX_ITERATIONS = 100
FAR = 1e4
"""Residual of what a camera cannot see."""


@dataclass(frozen=True)
class Trust:
    """What is believed before the samples are seen.

    Attributes:
        girth_std: deviation of the log of a person's width against the model's [1]: clothes and build.
        focal_std: deviation of the log of the focal length from the middle of its lens class [1].
        roll_std_rad: deviation of the camera's roll (Zhang 2008, section 2, assumption 3: no significant one).
        point_px: deviation of head and foot points [px].
    """

    girth_std: float
    focal_std: float
    roll_std_rad: float
    point_px: float


DRAWN = Trust(girth_std=0.03, focal_std=1.0, roll_std_rad=math.radians(2.0), point_px=POINT_PX)
"""For box, head and foot drawn one by one: they show the focal length and the roll. From straight above only the
model's own width, which the paper fixes, tells height from focal length, so it is trusted (our choice)."""
BOXES = Trust(girth_std=0.5, focal_std=0.34, roll_std_rad=math.radians(2.0), point_px=1e6)
"""For boxes alone. They take in arms and strides. They hardly show the focal length, which scales the floor along the
view, so its lens class decides (0.34: as uniform within 20-60 degrees). And left unseen a roll of 2 degrees would turn
up as a focal length twice too long (our choice)."""
FIELDS_DEG: dict[str, tuple[float, float]] = {
    "pinhole": (20.0, 60.0),
    "normal": (20.0, 60.0),
    "normal-wide": (60.0, 120.0),
    "fisheye": (120.0, 150.0),
    "black-corner-fisheye": (150.0, 170.0),
}
"""Horizontal field of view per lens class: table 2, with the ends it leaves open closed by us. The paper's pinhole
(below 30 degrees, or synthetic video of any) is given the range of a normal lens."""


@dataclass(frozen=True)
class Refined:
    """Result of ``refine``.

    Attributes:
        camera: at the minimum.
        cost: half the robust sum of squares there.
        std: deviations of (height [relative], tilt [rad], focal length [relative]); inf when undetermined.
        girth: width of the people against the model's [1].
    """

    camera: GroundCamera
    cost: float
    std: tuple[float, float, float]
    girth: float


def refine(camera: GroundCamera, rows: F64, model: HumanModel) -> Refined:
    """Move camera, people and their common width to the least squares of all edges and points.

    Args:
        camera: from the search.
        rows: (n, 8) left, top, right, bottom, head u, v, foot u, v [px].
        model: the person; its height is what gives the scale.
    """
    problem = _Problem(camera, rows, model)
    state = problem.state(np.append(_values(camera), [0.0, camera.roll_rad]), _stand(camera, rows, model))
    damping = 1e-3
    for _ in range(MAX_ITERATIONS):
        shared, places, information = problem.step(state, damping)
        trial = problem.state(state.shared + shared, state.places + places)
        if trial.cost < state.cost:
            done = state.cost - trial.cost < 1e-7 * state.cost
            state, damping = trial, max(damping / 5.0, 1e-9)
            if done:
                break
        else:
            damping *= 5.0
            if damping > 1e6:
                break
    _, _, information = problem.step(state, 0.0)
    shared = state.shared
    return Refined(_camera(shared, camera), state.cost, _deviations(information), math.exp(shared[3]))


@dataclass(frozen=True, eq=False)
class _State:
    """Shared values (log focal, log height, tilt, log girth, roll), (n, 2) places, (n, 8) residuals and the cost."""

    shared: F64
    places: F64
    residuals: F64
    cost: float


class _Problem:
    """Robust least squares with few shared values and two per person, which are eliminated (Schur complement)."""

    def __init__(self, camera: GroundCamera, rows: F64, model: HumanModel) -> None:
        self.camera, self.rows, self.model = camera, rows, model
        diagonal = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1])[:, None]
        self.sigma = np.hypot(POINT_PX, BODY_SHARE * diagonal) * np.ones((1, 8))
        trust = BOXES if only_boxes(rows) else DRAWN
        self.sigma[:, 4:] = trust.point_px
        usual = math.log(usual_focal_px(camera.lens, camera.width))
        self.expected = np.array([usual, 0.0, 0.0, 0.0, 0.0])
        self.certainty = np.array([trust.focal_std**-2, 0.0, 0.0, trust.girth_std**-2, trust.roll_std_rad**-2])

    def state(self, shared: F64, places: F64) -> _State:
        off = self._residuals(shared, places)
        loss = 2.0 * (np.sqrt(1.0 + (off / ROBUST_FROM) ** 2) - 1.0) * ROBUST_FROM**2
        prior = self.certainty * (shared - self.expected) ** 2
        return _State(shared, places, off, 0.5 * float(loss.sum() + prior.sum()))

    def step(self, state: _State, damping: float) -> tuple[F64, F64, F64]:
        """Levenberg-Marquardt step of shared values and places, and the (5, 5) information on the shared values."""
        weights = 1.0 / np.sqrt(1.0 + (state.residuals / ROBUST_FROM) ** 2)
        by_shared = self._by_shared(state)
        by_place = self._by_place(state)
        a = np.einsum("nri,nr,nrj->ij", by_shared, weights, by_shared) + np.diag(self.certainty)
        b = np.einsum("nri,nr,nrk->nik", by_shared, weights, by_place)
        c = np.einsum("nrk,nr,nrl->nkl", by_place, weights, by_place)
        down = np.einsum("nri,nr,nr->i", by_shared, weights, state.residuals)
        down += self.certainty * (state.shared - self.expected)
        down_place = np.einsum("nrk,nr,nr->nk", by_place, weights, state.residuals)
        a += damping * np.diag(np.diag(a))
        c += (damping * np.einsum("nkk->nk", c) + 1e-12)[:, :, None] * np.eye(2)
        # A person whom a trial camera does not see leaves nothing to invert.
        inverse = np.linalg.pinv(c, rcond=1e-12, hermitian=True)
        information = a - np.einsum("nik,nkl,njl->ij", b, inverse, b)
        shared = -np.linalg.lstsq(information, down - np.einsum("nik,nkl,nl->i", b, inverse, down_place))[0]
        places = -np.einsum("nkl,nl->nk", inverse, down_place + np.einsum("nik,i->nk", b, shared))
        return shared, places, information

    def _residuals(self, shared: F64, places: F64) -> F64:
        if not (abs(shared[2]) < math.pi / 2 - 1e-3 and abs(shared[4]) < 0.5 and np.abs(shared).max() < 12.0):
            return np.full(self.rows.shape, FAR)
        seen = _predict(shared, places, self.camera, self.model)
        return np.clip(np.nan_to_num((seen - self.rows) / self.sigma, nan=FAR, posinf=FAR, neginf=-FAR), -FAR, FAR)

    def _by_shared(self, state: _State, step: float = 1e-6) -> F64:
        """(n, 8, 5) derivatives of the residuals."""
        return np.stack(
            [
                (self._residuals(state.shared + d, state.places) - self._residuals(state.shared - d, state.places))
                / (2 * step)
                for d in step * np.eye(5)
            ],
            axis=-1,
        )

    def _by_place(self, state: _State, step: float = 1e-6) -> F64:
        """(n, 8, 2) derivatives of the residuals of each person by its own place."""
        return np.stack(
            [
                (self._residuals(state.shared, state.places + d) - self._residuals(state.shared, state.places - d))
                / (2 * step)
                for d in step * np.eye(2)
            ],
            axis=-1,
        )


def only_boxes(rows: F64) -> bool:
    """Whether heads and feet are but the middles of the boxes' upper and lower edges, so that they add nothing.

    Taken at their word they would say that people never lean outwards in the image, which is an infinite focal length.
    """
    middle = (rows[:, 0] + rows[:, 2]) / 2
    ends = np.stack([middle, rows[:, 1], middle, rows[:, 3]], axis=1)
    return bool((np.abs(rows[:, 4:] - ends) <= 1.0).all())


def usual_focal_px(lens: str, width: int) -> float:
    """Middle of the focal lengths of a lens class [px], in equal ratios."""
    narrow, wide = (0.5 * width / math.tan(math.radians(field) / 2) for field in FIELDS_DEG[lens])
    return math.sqrt(narrow * wide)


def _values(camera: GroundCamera) -> F64:
    return np.array([math.log(camera.focal_px), math.log(camera.height_m), camera.tilt_rad])


def _camera(values: F64, like: GroundCamera) -> GroundCamera:
    focal, height = (float(v) for v in np.exp(values[:2]))
    return replace(like, focal_px=focal, height_m=height, tilt_rad=float(values[2]), roll_rad=float(values[4]))


def _predict(values: F64, places: F64, like: GroundCamera, model: HumanModel) -> F64:
    """(n, 8) rows that the camera would see of people at (n, 2) places."""
    camera = _camera(values, like)
    girth = math.exp(values[3])
    wide = replace(
        model,
        head_radius_m=model.head_radius_m * girth,
        torso_radius_m=model.torso_radius_m * girth,
        leg_radius_m=model.leg_radius_m * girth,
    )
    outline = wide.outline_points(camera, places)
    ends = [outline.min(axis=1), outline.max(axis=1), model.head(camera, places), model.foot(camera, places)]
    return np.concatenate(ends, axis=1)


def _stand(camera: GroundCamera, rows: F64, model: HumanModel) -> F64:
    """(n, 2) where the people stand by their feet, or by their heads where the foot is above the horizon."""
    feet = camera.back_project(rows[:, 6:])
    heads = camera.back_project(rows[:, 4:6], model.height_m)
    return np.nan_to_num(np.where(np.isfinite(feet), feet, heads))


def _deviations(information: F64) -> tuple[float, float, float]:
    """Of (log height, tilt, log focal)."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
    normed = information / np.outer(scale, scale)
    if not np.isfinite(normed).all() or np.linalg.cond(normed) > 1e13:
        return math.inf, math.inf, math.inf
    variance = np.diag(np.linalg.inv(normed)) / scale**2
    focal, height, tilt = np.sqrt(np.maximum(variance[:3], 0.0))
    return float(height), float(tilt), float(focal)
