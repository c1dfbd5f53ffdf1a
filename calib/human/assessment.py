"""How well samples tell a camera: floor error expected where they were taken, and what would help most; ours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.ground_camera import GroundCamera
from calib.human.knowledge import (
    FOCAL,
    HEIGHT,
    KNOWN_FOCAL_STD,
    KNOWN_HEIGHT_STD,
    N_CAMERA,
    N_SHARED,
    PERSON_STD,
    ROLL,
    TILT,
)
from calib.human.model import HumanModel
from calib.human.refine import GroundCameraFit, Residuals, body_points, predict, shared_camera
from calib.human.samples import People
from calib.types import F64

MAX_FLOOR_ERROR_M = 0.5
"""Floor positions must be known this well [m] (our choice: half the gate within which tracks are matched)..."""
MAX_FLOOR_SHARE = 0.1
"""...and to this share of the region's size [1] (our choice: small rooms)."""
MIN_LEARNABLE_PX = 20.0
"""A person lower than this in the image tells nothing [px] (our choice)."""
NEXT_GRID = (13, 10)
"""Places tried for the next sample, across and down the image (our choice)."""
FURTHER = 6
"""So many further samples are a bearable effort (our choice): when they are not enough, a known value is asked for."""
STEP = 1e-5


class CameraDeviations(NamedTuple):
    """Standard deviations of a camera's values: height and focal length relative [1], tilt and roll [rad]."""

    height: float
    tilt_rad: float
    focal: float
    roll_rad: float


class NextSample(NamedTuple):
    """Where one more person would help most.

    Attributes:
        foot_px: (u, v) where the person should stand [px].
        floor_error_m: expected floor error with it.
    """

    foot_px: tuple[float, float]
    floor_error_m: float


@dataclass(frozen=True)
class Assessment:
    """How far a camera from people can be trusted.

    Attributes:
        enough: whether the floor error is within its limit.
        floor_error_m: standard deviation of floor positions [m], the median over the region between the samples' feet,
            after the shift and turn of the floor that fit best (they move no person against another).
        limit_m: largest floor error that is enough [m].
        next_sample: where one more person helps most; None where none does.
        sentence: all of this in plain words, beginning with "enough" or "not enough".
    """

    enough: bool
    floor_error_m: float
    limit_m: float
    next_sample: NextSample | None
    sentence: str


def camera_deviations(fits: Sequence[GroundCameraFit], weights: F64) -> CameraDeviations:
    """Deviations about the first of several fits that are right with the given probabilities."""
    best = _shared(fits[0])
    total = np.zeros(N_CAMERA)
    for fit, weight in zip(fits, weights, strict=True):
        total += weight * (np.diag(fit.covariance)[:N_CAMERA] + (_shared(fit) - best)[:N_CAMERA] ** 2)
    std = np.sqrt(total)
    return CameraDeviations(float(std[HEIGHT]), float(std[TILT]), float(std[FOCAL]), float(std[ROLL]))


def assess(fits: Sequence[GroundCameraFit], weights: F64, people: People, model: HumanModel) -> Assessment:
    """Expected floor error over the region that the samples cover, and what would lower it most.

    Args:
        fits: the camera taken first, then others that explain the samples with other lenses or readings.
        weights: (n,) their probabilities.
        people: the samples.
        model: the person.
    """
    fit = fits[0]
    region = _region(people.rows[:, 6:])
    floor = _FloorError(fit.camera, region)
    ambiguity = floor.between([f.camera for f in fits[1:]], weights[1:])
    error = floor.expected(fit.covariance, ambiguity)
    limit = min(MAX_FLOOR_ERROR_M, MAX_FLOOR_SHARE * floor.size_m)
    after, place = _best_place(fit, people, model, floor, ambiguity)
    found = None if place is None else NextSample(place, floor.expected(after, ambiguity))
    if error <= limit:
        text = f"enough: floor positions are known to {error:.2f} m where people were marked"
        return Assessment(True, error, limit, found, text)
    advice = _advice(fit, floor, ambiguity, limit, found, after)
    text = f"not enough: floor positions are known to {_metres(error)} only (at most {limit:.2g} m); {advice}"
    return Assessment(False, error, limit, found, text)


class _FloorError:
    """Errors of floor positions at pixels, without the rigid motion that moves all of them alike."""

    def __init__(self, camera: GroundCamera, pixels: F64) -> None:
        floor = camera.back_project(pixels)
        known = np.isfinite(floor).all(axis=1)
        self.pixels, self.floor = pixels[known], floor[known]
        low, high = np.quantile(self.floor, (0.05, 0.95), axis=0) if len(self.floor) else (np.zeros(2), np.zeros(2))
        self.size_m = float(np.hypot(*(high - low)))
        centred = self.floor - self.floor.mean(axis=0)
        rigid = np.zeros((len(self.floor), 2, 3))
        rigid[:, 0, 0] = rigid[:, 1, 1] = 1.0
        rigid[:, 0, 2], rigid[:, 1, 2] = -centred[:, 1], centred[:, 0]
        self._rigid = np.linalg.qr(rigid.reshape(-1, 3))[0]
        shared = _camera_shared(camera)
        slopes = []
        for k in range(N_CAMERA):
            step = STEP * (np.arange(N_SHARED) == k)
            ahead, behind = (shared_camera(shared + sign * step, camera) for sign in (1.0, -1.0))
            slopes.append((ahead.back_project(self.pixels) - behind.back_project(self.pixels)) / (2 * STEP))
        self._slope = self._without_motion(np.nan_to_num(np.stack(slopes, axis=-1)).reshape(-1, N_CAMERA))

    def expected(self, covariance: F64, ambiguity: F64) -> float:
        """Median over the pixels of the deviation [m], for a covariance of the shared unknowns."""
        if not np.isfinite(covariance).all() or not len(self.floor):
            return math.inf
        camera = covariance[:N_CAMERA, :N_CAMERA]
        variance = np.einsum("ik,kl,il->i", self._slope, camera, self._slope).reshape(-1, 2).sum(axis=1)
        return math.sqrt(float(np.median(variance + ambiguity)))

    def between(self, cameras: Sequence[GroundCamera], weights: F64) -> F64:
        """(m,) expected squared distance [m^2] to the floor positions under other cameras."""
        total = np.zeros(len(self.floor))
        for camera, weight in zip(cameras, weights, strict=True):
            off = np.nan_to_num(camera.back_project(self.pixels) - self.floor)
            total += weight * (self._without_motion(off.reshape(-1, 1)).reshape(-1, 2) ** 2).sum(axis=1)
        return total

    def _without_motion(self, field: F64) -> F64:
        return np.asarray(field - self._rigid @ (self._rigid.T @ field))


def _region(feet: F64) -> F64:
    """(m, 2) pixels: the feet and the middles between any two of them."""
    first, second = np.triu_indices(len(feet))
    middles = 0.5 * (feet[first] + feet[second])
    return np.asarray(middles[:: max(1, len(middles) // 1000)])


def _best_place(
    fit: GroundCameraFit, people: People, model: HumanModel, floor: _FloorError, ambiguity: F64
) -> tuple[F64, tuple[float, float] | None]:
    """Covariance after one more person at the place that lowers the floor error most, and its foot pixel."""
    if not np.isfinite(fit.covariance).all():
        return fit.covariance, None
    places, rows = _possible(fit, model)
    if not len(places):
        return fit.covariance, None
    further = People(rows, np.ones(len(rows)), np.full(len(rows), PERSON_STD), np.zeros(len(rows), np.bool_))
    information = _information(fit, further, places, model)
    known = np.linalg.inv(fit.covariance)
    after = [np.linalg.inv(known + gain) for gain in information]
    errors = [floor.expected(covariance, ambiguity) for covariance in after]
    best = int(np.argmin(errors))
    return np.linalg.inv(known + FURTHER * information[best]), (float(rows[best, 6]), float(rows[best, 7]))


def _possible(fit: GroundCameraFit, model: HumanModel) -> tuple[F64, F64]:
    """Places (k, 2) [m] all over the image where a whole person of a useful size would be, and their rows (k, 8)."""
    camera = fit.camera
    across, down = (np.linspace(0, extent - 1, n) for extent, n in zip(camera.size, NEXT_GRID, strict=True))
    places = camera.back_project(np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2))
    places = places[np.isfinite(places).all(axis=1)]
    size, width = np.full(len(places), fit.stature), np.full(len(places), fit.girth)
    upright = np.zeros_like(places)
    rows = predict(_shared(fit), places, upright, size, width, camera, body_points(model), fit.prior.boxes_only)
    inside = (rows[:, :2] >= 0).all(axis=1) & (rows[:, 2:4] < np.array(camera.size)).all(axis=1)
    tall = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1]) >= MIN_LEARNABLE_PX
    return places[inside & tall], rows[inside & tall]


def _information(fit: GroundCameraFit, further: People, places: F64, model: HumanModel) -> F64:
    """(k, N_SHARED, N_SHARED) what each further person tells of the shared unknowns, its own place being free."""
    values = np.append(_shared(fit), places)
    jacobian = Residuals(fit.camera, further, model, fit.prior, values).jacobian(values)
    blocks = jacobian[: 8 * len(places)].reshape(len(places), 8, -1)
    shared = blocks[..., :N_SHARED]
    numbers = np.arange(len(places))
    own = np.stack([blocks[numbers, :, N_SHARED + 2 * numbers + k] for k in range(2)], axis=-1)
    own_t = own.transpose(0, 2, 1)
    left_over = shared - own @ np.linalg.solve(own_t @ own + 1e-12 * np.eye(2), own_t @ shared)
    return np.asarray(left_over.transpose(0, 2, 1) @ left_over)


def _advice(
    fit: GroundCameraFit, floor: _FloorError, ambiguity: F64, limit: float, found: NextSample | None, after: F64
) -> str:
    told = []
    if np.isfinite(fit.covariance).all():
        for name, k, std in (
            ("the focal length or field of view", FOCAL, KNOWN_FOCAL_STD),
            ("the camera's height", HEIGHT, KNOWN_HEIGHT_STD),
        ):
            gain = np.diag((np.arange(N_SHARED) == k) / std**2)
            if floor.expected(np.linalg.inv(np.linalg.inv(fit.covariance) + gain), ambiguity) <= limit:
                told.append(name)
    give = f"give {' or '.join(told)}" if told else ""
    if found is None:
        return give or "mark more people, at more distances"
    place = f"add people {_where(fit, found.foot_px)}, near pixel ({found.foot_px[0]:.0f}, {found.foot_px[1]:.0f})"
    reached = floor.expected(after, ambiguity) <= limit
    if fit.prior.boxes_only:
        place = "mark heads and feet where they are, not at the middles of the boxes' edges"
        reached = False
    if give and not reached:
        return f"{give}, or {place}"
    return f"{place}, or {give}" if give else place


def _where(fit: GroundCameraFit, foot_px: tuple[float, float]) -> str:
    distances = np.hypot(*fit.places_m.T)
    distance = float(np.hypot(*fit.camera.back_project(foot_px)))
    if distance < 0.75 * np.median(distances):
        return "nearer to the camera"
    if distance > 1.33 * np.median(distances):
        return "farther from the camera"
    return "at the left of the image" if foot_px[0] < fit.camera.width / 2 else "at the right of the image"


def _metres(error: float) -> str:
    return f"{error:.2f} m" if error < 100 else "more than 100 m"


def _shared(fit: GroundCameraFit) -> F64:
    values = _camera_shared(fit.camera)
    values[N_CAMERA:] = math.log(fit.girth), math.log(fit.stature)
    return values


def _camera_shared(camera: GroundCamera) -> F64:
    values = np.zeros(N_SHARED)
    values[[FOCAL, HEIGHT, TILT, ROLL]] = (
        math.log(camera.focal_px), math.log(camera.height_m), camera.tilt_rad, camera.roll_rad,
    )  # fmt: skip
    return values
