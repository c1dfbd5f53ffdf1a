"""How well samples determine a camera, and where one more would help most; ours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.people.fit import GroundCameraFit, Residuals, body_points, predict, shared_camera
from calib.people.model import FOCAL, HEIGHT, KNOWN_CAMERA_STD, N_CAMERA, N_SHARED, PERSON_STD, ROLL, TILT, HumanModel
from calib.people.samples import MarkedPeople
from calib.types import F64, Bool


class NextSample(NamedTuple):
    """Where one more person would help most: its foot (u, v) [px], and the floor error expected with it [m]."""

    foot_px: tuple[float, float]
    floor_error_m: float


@dataclass(frozen=True)
class Assessment:
    """How far a camera from people can be trusted.

    Attributes:
        enough: whether floor error, height and tilt are within their limits.
        floor_error_m: standard deviation of floor positions [m], the median over the region between the samples' feet,
            after the shift and turn of the floor that fit best (they move no person against another).
        next_sample: where one more person helps most; None where none does.
        sentence: all of this in words, beginning with "enough" or "not enough".
    """

    enough: bool
    floor_error_m: float
    next_sample: NextSample | None
    sentence: str


MAX_HEIGHT_STD, MAX_TILT_STD = 0.06, math.radians(1.5)
"""Deviations of the camera's height [1] and tilt [rad] up to which it is known well enough (half of those that three
people give)."""


def assess(fit: GroundCameraFit, people: MarkedPeople, model: HumanModel, walked: Bool | None = None) -> Assessment:
    """How well camera and floor are known over the region that the samples cover, and what would help most: more people
    only where ``walked`` (height, width) is set; None for anywhere."""
    # (m, 2) pixels: the feet and the middles between any two of them.
    feet = people.rows[:, 6:]
    first, second = np.triu_indices(len(feet))
    middles = 0.5 * (feet[first] + feet[second])
    advisor = _Advisor(fit, np.asarray(middles[:: max(1, len(middles) // 1000)]))
    found = advisor.next_sample(model, walked)
    values, limits = advisor.deviations(fit.covariance), advisor.limits
    enough = bool((values <= limits).all())
    error, height, tilt = values.tolist()
    away = advisor.deviations(fit.covariance, from_camera=True)[0]
    text = (
        f"where people were marked, floor positions are known to {_metres(error)} relative to each other and to "
        f"{_metres(away)} from the camera, the camera's height to {height:.0%}, its tilt to {math.degrees(tilt):.1f} "
        "degrees"
    )
    if enough:
        return Assessment(True, error, found, f"enough: {text}")
    most = f"at most {limits[0]:.2g} m, {MAX_HEIGHT_STD:.0%} and {math.degrees(MAX_TILT_STD):g} degrees"
    return Assessment(False, error, found, f"not enough: {text} ({most}); {advisor.advice(found)}")


def _metres(error: float) -> str:
    return f"{error:.2f} m" if error < 100 else "more than 100 m"


_TURNS_RAD = np.deg2rad([[-89.0, -44.0], [89.0, 44.0]])
"""Lowest and highest tilt and roll that a ``GroundCamera`` has."""


class _Advisor:
    """What would make the camera known well enough: another person, many, or a known value.

    Attributes:
        limits: (3,) largest ``deviations`` that are enough.
        gain: (N_SHARED, N_SHARED) information of the person that ``next_sample`` asks for; None without one.
    """

    def __init__(self, fit: GroundCameraFit, pixels: F64) -> None:
        """Prepare; floor positions are judged at (n, 2) pixels, without the rigid motion that moves all alike."""
        floor = fit.camera.back_project(pixels)
        known = np.isfinite(floor).all(axis=1)
        self.fit, self._pixels, self._floor = fit, pixels[known], floor[known]
        low, high = np.quantile(self._floor, (0.05, 0.95), axis=0) if known.any() else (np.zeros(2), np.zeros(2))
        # Floor positions must be known to half the gate within which tracks are matched [m], and to a tenth of the
        # region's size in small rooms.
        self.limits = np.array([min(0.5, 0.1 * float(np.hypot(*(high - low)))), MAX_HEIGHT_STD, MAX_TILT_STD])
        x, y = (self._floor - self._floor.mean(axis=0)).T
        one, zero = np.ones(len(x)), np.zeros(len(x))
        rigid = np.stack([np.column_stack([one, zero, -y]), np.column_stack([zero, one, x])], axis=1)
        self._rigid = np.linalg.qr(rigid.reshape(-1, 3))[0]
        self.gain: F64 | None = None

    def deviations(self, covariance: F64, *, from_camera: bool = False) -> F64:
        """(3,) of floor positions [m], the median over the pixels, relative to each other or ``from_camera``, camera
        height [1] and tilt [rad].

        Far places move more than in proportion, so that cameras away from the fit are tried: the points of the
        unscented transform (Julier and Uhlmann 1997).
        """
        height_std, tilt_std = np.sqrt(covariance.diagonal()[[HEIGHT, TILT]])
        if not np.isfinite(covariance).all() or not len(self._floor):
            return np.array([math.inf, height_std, tilt_std])
        squares, axes = np.linalg.eigh(covariance[:N_CAMERA, :N_CAMERA])
        steps = np.zeros((N_CAMERA, N_SHARED))
        steps[:, :N_CAMERA] = (axes * np.sqrt(N_CAMERA * np.maximum(squares, 0.0))).T
        total = np.zeros(len(self._floor))
        for step in (*steps, *-steps):
            shared = self.fit.shared + step
            shared[[TILT, ROLL]] = np.clip(shared[[TILT, ROLL]], *_TURNS_RAD)
            moved = shared_camera(shared, self.fit.camera).back_project(self._pixels)
            off = np.nan_to_num(moved - self._floor).ravel()
            if not from_camera:
                off -= self._rigid @ (self._rigid.T @ off)
            total += (off.reshape(-1, 2) ** 2).sum(axis=1)
        return np.array([math.sqrt(float(np.median(total)) / len(steps) / 2), height_std, tilt_std])

    def next_sample(self, model: HumanModel, walked: Bool | None) -> NextSample | None:
        """The place where one more person brings the deviations nearest to their limits."""
        if not np.isfinite(self.fit.covariance).all():
            return None
        # Places [m] all over the image, 13 across and 10 down, where a whole person would be.
        fit, camera = self.fit, self.fit.camera
        across, down = (np.linspace(0, extent - 1, n) for extent, n in zip(camera.size, (13, 10), strict=True))
        places = camera.back_project(np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2))
        places = places[np.isfinite(places).all(axis=1)]
        size, width = np.full(len(places), fit.stature), np.full(len(places), fit.girth)
        rows = predict(camera, body_points(model), places, np.zeros_like(places), size, width, fit.prior)
        inside = (rows[:, :2] >= 0).all(axis=1) & (rows[:, 2:4] < np.array(camera.size)).all(axis=1)
        # A person lower than this in the image carries no information [px].
        inside &= np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1]) >= 20.0
        places, rows = places[inside], rows[inside]
        if walked is not None:
            u, v = rows[:, 6:8].round().astype(int).T
            met = walked[v.clip(0, walked.shape[0] - 1), u.clip(0, walked.shape[1] - 1)]
            places, rows = places[met], rows[met]
        if not len(places):
            return None
        further = MarkedPeople(rows, np.ones(len(rows)), np.full(len(rows), PERSON_STD), np.zeros(len(rows), np.bool_))
        # (k, N_SHARED, N_SHARED) information of each further person on the shared unknowns, its own place being free.
        values = np.append(self.fit.shared, places)
        jacobian = Residuals(self.fit.camera, further, model, self.fit.prior, values, 1.0).jacobian(values)
        blocks = jacobian[: 8 * len(places)].reshape(len(places), 8, -1)
        shared = blocks[..., :N_SHARED]
        numbers = np.arange(len(places))
        own = np.stack([blocks[numbers, :, N_SHARED + 2 * numbers + k] for k in range(2)], axis=-1)
        own_t = own.transpose(0, 2, 1)
        left_over = shared - own @ np.linalg.solve(own_t @ own + 1e-12 * np.eye(2), own_t @ shared)
        gains = np.asarray(left_over.transpose(0, 2, 1) @ left_over)
        after = np.array([self._after(gain) for gain in gains])
        best = int(np.argmin((after / self.limits).max(axis=1)))
        self.gain = gains[best]
        return NextSample((float(rows[best, 6]), float(rows[best, 7])), float(after[best, 0]))

    def advice(self, found: NextSample | None) -> str:
        """What to do, in words."""
        knowable = ((FOCAL, "the focal length or field of view"), (HEIGHT, "the camera's height"))
        gain = np.eye(N_SHARED) / KNOWN_CAMERA_STD**2
        helpful = " or ".join(name for k, name in knowable if self._enough(np.diag(gain[k])))
        if not helpful and self._enough(np.diag(gain[FOCAL] + gain[HEIGHT])):
            helpful = " and ".join(name for _, name in knowable)
        give = f"give {helpful}" if helpful else ""
        if found is None or self.gain is None:
            return give or "mark more people, at more distances"
        u, v = found.foot_px
        more = f"add people {_where(self.fit, found.foot_px)}, near pixel ({u:.0f}, {v:.0f})"
        # Six further samples are a bearable effort: where they are not enough, a known value is better advice.
        reached = self._enough(6 * self.gain)
        if self.fit.prior.reading == "boxes":
            more, reached = "mark heads and feet where they are, not at the middles of the boxes' edges", False
        if give and not reached:
            return f"{give}, or {more}"
        return f"{more}, or {give}" if give else more

    def _enough(self, gain: F64) -> bool:
        return bool(np.isfinite(self.fit.covariance).all() and (self._after(gain) <= self.limits).all())

    def _after(self, gain: F64) -> F64:
        """``deviations`` with further information."""
        return self.deviations(np.linalg.inv(np.linalg.inv(self.fit.covariance) + gain).astype(np.float64))


def _where(fit: GroundCameraFit, foot_px: tuple[float, float]) -> str:
    distances = np.hypot(*fit.places_m.T)
    distance = float(np.hypot(*fit.camera.back_project(foot_px)))
    if distance < 0.75 * np.median(distances):
        return "nearer to the camera"
    if distance > 1.33 * np.median(distances):
        return "farther from the camera"
    return "at the left of the image" if foot_px[0] < fit.camera.width / 2 else "at the right of the image"
