"""Robust least squares on head, foot and box after the search of ``calib.human.calibration``; our addition.

The paper's error sums distances, and a box as a ratio of areas; its minimum scatters two to three times as much as
least squares on the same pixels. The search finds the right valley, this finds the bottom, and how flat it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from calib.ground_camera import GroundCamera
from calib.human.model import HumanModel
from calib.types import F64, Bool

POINT_PX = 2.0
"""Deviation of a point or edge marked by hand [px] (our choice: what people reach on a screen)."""
BODY_SHARE = 0.02
"""Arms and steps move the edges of a box by this share of its diagonal [1]: some 4 cm of 1.8 m (our choice)."""
ROBUST_FROM = 2.0
"""Residuals beyond this many deviations count by their size instead of its square (our choice)."""
MAX_EVALUATIONS = 100
FAR = 1e4
"""Residual of what is behind a camera."""
FOCAL, HEIGHT, TILT, GIRTH, ROLL = range(5)
"""Order of the shared unknowns: log focal length, log height, tilt, log girth, roll; two per person follow."""
N_SHARED = 5


@dataclass(frozen=True)
class CameraPrior:
    """What is known before any sample; each becomes a residual of its own.

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


MARKED = CameraPrior(girth_std=0.03, focal_std=1.0, roll_std_rad=math.radians(2.0), point_px=POINT_PX)
"""For box, head and foot marked one by one: they show the focal length and the roll. From straight above only the
model's own width, which the paper fixes, tells height from focal length, so it is trusted (our choice)."""
BOXES = CameraPrior(girth_std=0.5, focal_std=0.34, roll_std_rad=math.radians(2.0), point_px=1e6)
"""For boxes alone. They take in arms and strides. They hardly show the focal length, which scales the floor along the
view, so its lens class decides (0.34: as uniform within 20-60 degrees). And an unnoticed roll of 2 degrees would turn
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
class GroundCameraFit:
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


def refine(camera: GroundCamera, rows: F64, model: HumanModel) -> GroundCameraFit:
    """Move camera, people and their common width to the least squares of all edges and points.

    Args:
        camera: from the search.
        rows: (n, 8) left, top, right, bottom, head u, v, foot u, v [px].
        model: the person; its height is what gives the scale.
    """
    residuals = _Residuals(camera, rows, model)
    shared = np.array([math.log(camera.focal_px), math.log(camera.height_m), camera.tilt_rad, 0.0, camera.roll_rad])
    start = np.append(shared, _stand(camera, rows, model))
    found = least_squares(
        residuals, start, residuals.jacobian, loss=residuals.loss, x_scale="jac", ftol=1e-7, max_nfev=MAX_EVALUATIONS
    )
    shared = found.x[:N_SHARED]
    return GroundCameraFit(_camera(shared, camera), float(found.cost), _deviations(found.jac), math.exp(shared[GIRTH]))


class _Residuals:
    """Residuals of the samples, 8 per person, and then those of the prior; in deviations [1]."""

    def __init__(self, camera: GroundCamera, rows: F64, model: HumanModel) -> None:
        self.camera, self.rows, self.model = camera, rows, model
        prior = BOXES if only_boxes(rows) else MARKED
        diagonal = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1])[:, None]
        self.sigma = np.hypot(POINT_PX, BODY_SHARE * diagonal) * np.ones((1, 8))
        self.sigma[:, 4:] = prior.point_px
        self.expected = np.array([math.log(usual_focal_px(camera.lens, camera.width)), 0.0, 0.0, 0.0, 0.0])
        self.certainty = np.array([1.0 / prior.focal_std, 0.0, 0.0, 1.0 / prior.girth_std, 1.0 / prior.roll_std_rad])

    def __call__(self, values: F64) -> F64:
        shared = values[:N_SHARED]
        return np.append(self._of_samples(values), self.certainty * (shared - self.expected))

    def jacobian(self, values: F64, step: float = 1e-6) -> F64:
        """(8 n + 5, 5 + 2 n) derivatives; a person's place moves only that person's rows."""
        n = len(self.rows)
        jacobian = np.zeros((8 * n + N_SHARED, len(values)))
        for k in range(N_SHARED):
            jacobian[: 8 * n, k] = self._slope(values, np.arange(len(values)) == k, step).ravel()
        people = np.arange(n)
        blocks = jacobian[: 8 * n].reshape(n, 8, len(values))
        for k in range(2):
            moved = np.arange(len(values)) >= N_SHARED
            moved[N_SHARED + 1 - k :: 2] = False
            blocks[people, :, N_SHARED + 2 * people + k] = self._slope(values, moved, step)
        jacobian[8 * n :, :N_SHARED] = np.diag(self.certainty)
        return jacobian

    def loss(self, squares: F64) -> F64:
        """(3, m) robust loss of squared residuals and its two derivatives: soft L1 for samples, none for the prior."""
        loss = np.stack([squares, np.ones_like(squares), np.zeros_like(squares)])
        n, scale = 8 * len(self.rows), ROBUST_FROM**2
        root = np.sqrt(1.0 + squares[:n] / scale)
        # Without its second derivative the step is that of reweighted least squares, which far residuals keep definite.
        loss[0, :n], loss[1, :n] = 2.0 * scale * (root - 1.0), 1.0 / root
        return loss

    def _of_samples(self, values: F64) -> F64:
        shared, places = values[:N_SHARED], values[N_SHARED:].reshape(-1, 2)
        if not (abs(shared[TILT]) < math.pi / 2 - 1e-3 and abs(shared[ROLL]) < 0.5 and np.abs(shared).max() < 12.0):
            return np.full(self.rows.size, FAR)
        off = (_predict(shared, places, self.camera, self.model) - self.rows) / self.sigma
        return np.clip(np.nan_to_num(off, nan=FAR, posinf=FAR, neginf=-FAR), -FAR, FAR).ravel()

    def _slope(self, values: F64, moved: Bool, step: float) -> F64:
        """(n, 8) derivative by all the unknowns marked in ``moved`` at once."""
        ahead, behind = self._of_samples(values + step * moved), self._of_samples(values - step * moved)
        return ((ahead - behind) / (2 * step)).reshape(-1, 8)


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


def _camera(shared: F64, like: GroundCamera) -> GroundCamera:
    focal, height = (float(v) for v in np.exp(shared[[FOCAL, HEIGHT]]))
    return replace(like, focal_px=focal, height_m=height, tilt_rad=float(shared[TILT]), roll_rad=float(shared[ROLL]))


def _predict(shared: F64, places: F64, like: GroundCamera, model: HumanModel) -> F64:
    """(n, 8) rows that the camera would give of people at (n, 2) places."""
    camera = _camera(shared, like)
    girth = math.exp(shared[GIRTH])
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


def _deviations(jacobian: F64) -> tuple[float, float, float]:
    """Of (log height, tilt, log focal length), from the robustly weighted Jacobian at the minimum."""
    scale = np.sqrt(np.maximum((jacobian**2).sum(axis=0), 1e-30))
    _, singular, axes = np.linalg.svd(jacobian / scale, full_matrices=False)
    if not np.isfinite(singular).all() or singular[-1] < 1e-6 * singular[0]:
        return math.inf, math.inf, math.inf
    std = np.sqrt(((axes.T / singular) ** 2).sum(axis=1)) / scale
    return float(std[HEIGHT]), float(std[TILT]), float(std[FOCAL])
