"""The camera from a few people, how well it is known (ours), and where one more person would help most."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.errors import WorkError
from calib.ground_camera import LENS_K_320, GroundCamera, distortion_k
from calib.people.fit import (
    STRETCHES,
    GroundCameraFit,
    Residuals,
    body_points,
    fit_camera,
    predict,
    shared_camera,
    with_focal_spread,
    with_outline_errors,
    with_stretches_left_out,
)
from calib.people.model import (
    FOCAL,
    GIRTH,
    HEIGHT,
    KNOWN_CAMERA_STD,
    N_CAMERA,
    N_SHARED,
    PERSON_STD,
    ROLL,
    TILT,
    CameraPrior,
    HumanModel,
    KnownValues,
    Reading,
    people_of,
    prior_of,
)
from calib.people.samples import HumanSample, MarkedPeople, check_samples, level_ends, only_boxes
from calib.types import F64, Bool

GRID = (14, 24, 37)
"""Focal lengths and camera heights in equal ratios, and tilts (at most 5 degrees apart) to start from."""
STARTS = 3
"""Distinct results of the search that are refined (height and focal length trade off in a valley)."""
MAX_ERROR = 0.25
"""Largest plausible error of the samples that fit, their median [1]: beyond it they are not standing people in an
upright image."""
MAX_HEIGHT_STD = 0.25
"""Relative deviation of the height from which height and focal length count as inseparable."""
MAX_DISTANCE_M = 60.0
"""People are not sampled from farther away [m] (bounds the height of the camera)."""
ODD_FROM = 3.0
"""A sample whose residuals are this many deviations is odd: not a standing person, or marked wrongly."""


class NextSample(NamedTuple):
    """Where one more person would help most: its foot (u, v) [px], and the floor error expected with it [m]."""

    foot_px: tuple[float, float]
    floor_error_m: float


class Assessment(NamedTuple):
    """How far a camera from people can be trusted.

    Attributes:
        enough: whether floor error, height and tilt are within their limits.
        floor_error_m: root mean square distance of floor positions from the true ones [m], the median over the region
            between the samples' feet, after the shift and turn of the floor that fit best (they move no person against
            another).
        next_sample: where one more person helps most; None where none does.
        sentence: all of this in words, beginning with "enough" or "not enough".
    """

    enough: bool
    floor_error_m: float
    next_sample: NextSample | None
    sentence: str


class CameraDeviations(NamedTuple):
    """Standard deviations of a camera's values: height and focal length relative [1], tilt and roll [rad]."""

    height: float
    tilt_rad: float
    focal: float
    roll_rad: float


@dataclass(frozen=True, eq=False)
class HumanCalibration:
    """A camera from people, and how far to trust it.

    Attributes:
        camera, model: the best one, and the person it was found with.
        error, sample_errors: weighted error E = whf Ehf + wbb Ebb (Zhang 2008), mean and (n,) per sample.
        std, assessment: deviations, whether they are enough, and where to add the next sample.
        odd: numbers of the samples that fit badly and were weighted down.
        stature: mean height of the sampled people against the model's [1], as far as a known camera height fixes it.
        boxes_only: whether heads and feet were read as but the middles of the boxes' edges.
        search_s: duration of the search [s].
    """

    camera: GroundCamera
    model: HumanModel
    error: float
    sample_errors: F64
    std: CameraDeviations
    assessment: Assessment
    odd: tuple[int, ...]
    stature: float
    boxes_only: bool
    search_s: float


def calibrate_from_people(
    samples: Sequence[HumanSample],
    size: tuple[int, int],
    lens: str | None = None,
    *,
    known: KnownValues | None = None,
    independent: int | None = None,
    name: str = "samples",
    walked: Bool | None = None,
) -> HumanCalibration:
    """The camera whose projected people fit at least 3 samples at different places best, its deviations and a verdict.

    A camera that is not known well enough is returned with an assessment that says so. Raises InputError: samples from
    which no camera can be determined. WorkError: no camera fits them, or height and focal length cannot be separated.
    ValueError: an unknown lens.

    Args:
        size: (width, height) of the image [px].
        lens: class of table 2; None tries all.
        known: focal length or field of view, camera height, height of the people, as far as known.
        independent: number of independent samples, where few people were observed often by outlines of foreground;
            None for all, marked by hand. The others repeat body height, gait and shadow, and are weighted down.
        name: of the samples' source, for messages.
        walked: (height, width), where something moved in the recording: more people are suggested there only.
    """
    check_samples(samples, size, name)
    if lens is not None and lens not in LENS_K_320:
        raise ValueError(f"expected a lens of {', '.join(LENS_K_320)}, got {lens!r}")
    known = known or KnownValues()
    model = HumanModel().scaled(known.person_height_m or HumanModel().height_m)
    start = time.perf_counter()
    people = people_of(samples, model, independent)
    best = _best([lens] if lens else list(LENS_K_320), size, people, model, known)
    fit = with_focal_spread(best, people, model)
    if independent is not None:
        fit = with_outline_errors(fit, people, model)
        if len(people) > 3 * STRETCHES:
            fit = with_stretches_left_out(fit, people, model, [sample.frame for sample in samples])
    errors = weighted_errors(fit.camera, fit.places_m, people.rows, model)
    _refuse_unfit(fit, errors, name)
    return HumanCalibration(
        camera=fit.camera,
        model=model,
        error=float(errors.mean()),
        sample_errors=errors,
        std=CameraDeviations(*(float(fit.std[k]) for k in (HEIGHT, TILT, FOCAL, ROLL))),
        assessment=assess(fit, people, model, walked),
        odd=tuple(int(i) for i in np.flatnonzero(fit.deviations > ODD_FROM)),
        stature=fit.stature,
        boxes_only=fit.prior.reading == "boxes",
        search_s=time.perf_counter() - start,
    )


def _best(
    lenses: Sequence[str], size: tuple[int, int], people: MarkedPeople, model: HumanModel, known: KnownValues
) -> GroundCameraFit:
    """The likeliest of the fits of every lens and every reading of the samples."""
    readings: tuple[Reading, ...] = ("boxes", "level", "outline")
    readings = readings[: 1 if only_boxes(people.rows) else 2 if level_ends(people.rows) else 3]
    priors = [(lens, prior_of(lens, size[0], known, reading)) for lens in lenses for reading in readings]
    quick = []
    for lens, prior in priors:
        cameras = starts(people, size, lens, model, prior)
        fits = [fit_camera(camera, people, model, prior, variation=1.0) for camera in cameras]
        quick.append(max(fits, key=lambda fit: fit.log_evidence))
    # Fits whose log-evidence is lower by more are not refined further (one in 10^8).
    rival = max(fit.log_evidence for fit in quick) - 20.0
    full = [fit_camera(fit.camera, people, model, fit.prior) for fit in quick if fit.log_evidence >= rival]
    return max(full, key=lambda fit: fit.log_evidence)


def starts(
    people: MarkedPeople, size: tuple[int, int], lens: str, model: HumanModel, prior: CameraPrior
) -> list[GroundCamera]:
    """The best few cameras of a grid that differ, by where heads are above the marked feet and by the boxes' sizes."""
    person_m = model.height_m
    radius_m = model.torso_radius_m
    low, high = (prior.mean + sign * 2.5 * np.minimum(prior.std, 1.0) for sign in (-1, 1))
    if not np.isfinite(prior.std[HEIGHT]):
        low[HEIGHT] = math.log(1.15 * person_m)
        high[HEIGHT] = math.log(MAX_DISTANCE_M)
    focals, heights = (np.exp(np.linspace(low[k], high[k], n)) for k, n in zip((FOCAL, HEIGHT), GRID, strict=False))
    tilts = np.radians(np.linspace(-89.0, 89.0, GRID[2]))
    f, h, tilt = (axis.reshape(-1, 1) for axis in np.meshgrid(focals, heights, tilts, indexing="ij"))
    s = np.sin(tilt)
    c = np.cos(tilt)
    # (n, 4, 2) corners, head and foot from the image centre, without lens distortion.
    marked = people.rows.reshape(-1, 4, 2) - (np.array(size) - 1) / 2
    k = distortion_k(lens, size[0])
    root = np.maximum(1.0 + 4.0 * k * np.linalg.norm(marked, axis=2), 0.0)
    left_top, right_bottom, head, foot = np.moveaxis(marked * (2.0 / (1.0 + np.sqrt(root)))[..., None], 1, 0)
    box = right_bottom - left_top
    with np.errstate(all="ignore"):
        # People stand where the marked foot meets the floor; from there follow their heads and how large they look.
        far = h / (f * c + foot[:, 1] * s)
        x = far * foot[:, 0]
        y = far * (f * s - foot[:, 1] * c)
        depth = y * s + (h - person_m) * c
        u = f * x / depth
        v = f * ((h - person_m) * s - y * c) / depth
        shoulder = 2.0 * radius_m * f / (y * s + (h - 0.85 * person_m) * c)
        off = np.hypot(u - head[:, 0], v - head[:, 1])
        off += np.abs(np.abs(u - foot[:, 0]) + shoulder - box[:, 0])
        # From above, a body is as long as its shoulders are wide; from the side its length is that from head to foot.
        off += np.abs(np.maximum(np.abs(v - foot[:, 1]), shoulder) - box[:, 1])
        off /= np.hypot(*box.T)
    seen = (far > 0) & (depth > 0.05)
    error = np.minimum(np.where(seen, off, np.inf), 1.5).mean(axis=1)
    chosen: list[F64] = []
    for i in np.argsort(error, kind="stable")[:2000]:
        camera = np.array([math.log(f[i, 0]), math.log(h[i, 0]), tilt[i, 0]])
        if all(np.abs(camera - other).max() > 0.3 for other in chosen):
            chosen.append(camera)
        if len(chosen) == STARTS:
            break
    return [GroundCamera(*size, math.exp(f), math.exp(h), float(t), lens) for f, h, t in chosen]


def weighted_errors(camera: GroundCamera, places_m: F64, rows: F64, model: HumanModel) -> F64:
    """(n,) error E = whf Ehf + wbb Ebb of the (n, 8) rows of people at (n, 2) places [m] (Zhang 2008, section 3.3)."""
    boxes = model.boxes(camera, places_m)
    low = boxes[:, :2]
    high = low + boxes[:, 2:]
    area = boxes[:, 2:].prod(axis=1)
    marked_area = (rows[:, 2:4] - rows[:, :2]).prod(axis=1)
    ends = np.stack([model.head(camera, places_m), model.foot(camera, places_m)], axis=1)
    apart = np.linalg.norm(ends - rows[:, 4:].reshape(-1, 2, 2), axis=2).mean(axis=1)
    radius = (np.sqrt(area / math.pi) + np.sqrt(marked_area / math.pi)) / 2
    common = np.maximum(np.minimum(high, rows[:, 2:4]) - np.maximum(low, rows[:, :2]), 0.0).prod(axis=1)
    overlap = common / (area + marked_area - common)
    length = np.linalg.norm(rows[:, 4:6] - rows[:, 6:], axis=1)
    weight = np.minimum(1.0, length / np.linalg.norm(rows[:, 2:4] - rows[:, :2], axis=1))
    return np.asarray(np.nan_to_num(weight * apart / radius + (1.0 - weight) * (1.0 - overlap), nan=np.inf))


def _refuse_unfit(fit: GroundCameraFit, errors: F64, name: str) -> None:
    """Most samples must fit well, and determine the camera; how badly the odd ones fit does not matter."""
    fits = fit.deviations <= ODD_FROM
    error = float(np.median(errors[fits])) if fits.any() else math.inf
    roll_deg = math.degrees(fit.camera.roll_rad)
    height_std = float(fit.std[HEIGHT])
    problem = ""
    if error > MAX_ERROR or fits.mean() < 0.5:
        found = f"error {error:.2f} (at most {MAX_ERROR:g}), {1.0 - fits.mean():.0%} of the samples far off"
        way = "are they standing people of one size in upright images of this size?"
        problem = f"no camera fits the samples: {found}; {way}"
    # A larger roll is none of a camera, but of wrong samples (3.5 deviations of the prior).
    elif abs(roll_deg) > 7.0:
        found = f"people who lean as in one turned by {roll_deg:.0f} degrees"
        way = "blobs that are not one person each, or a camera to be turned"
        problem = f"expected an upright image, found {found}: {way}"
    elif not height_std <= MAX_HEIGHT_STD:
        found = f"height known to {min(height_std, 10):.0%}"
        way = "add people nearer to and farther from the camera, or give the focal length or the camera's height"
        problem = f"camera height and focal length cannot be separated by these samples ({found}): {way}"
    if problem:
        raise WorkError(f"{name}: {problem}")


FLOOR_ERROR_M = 0.35
"""Floor error that is enough [m], and a tenth of the region in small rooms: half the distance of two people who walk
side by side."""
KNOWN_HEIGHT_STD = 0.06
KNOWN_TILT_STD = math.radians(1.5)
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
    values = advisor.deviations(fit.covariance)
    limits = advisor.limits
    enough = bool((values <= limits).all())
    error, height, tilt = values.tolist()
    away = advisor.deviations(fit.covariance, from_camera=True)[0]
    relative, absolute = (f"{one:.2f} m" if one < 100 else "more than 100 m" for one in (error, away))
    text = (
        f"where people were marked, floor positions are known to {relative} relative to each other and to {absolute} "
        f"from the camera, the camera's height to {height:.0%}, its tilt to {math.degrees(tilt):.1f} degrees"
    )
    if enough:
        return Assessment(True, error, found, f"enough: {text}")
    most = f"at most {limits[0]:.2g} m, {KNOWN_HEIGHT_STD:.0%} and {math.degrees(KNOWN_TILT_STD):g} degrees"
    return Assessment(False, error, found, f"not enough: {text} ({most}); {advisor.advice(found)}")


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
        self.fit = fit
        self._pixels = pixels[known]
        self._floor = floor[known]
        region_m = 0.0
        if known.any():
            low, high = np.quantile(self._floor, (0.05, 0.95), axis=0)
            region_m = float(np.hypot(*(high - low)))
        self.limits = np.array([min(FLOOR_ERROR_M, 0.1 * region_m), KNOWN_HEIGHT_STD, KNOWN_TILT_STD])
        x, y = (self._floor - self._floor.mean(axis=0)).T
        one = np.ones(len(x))
        zero = np.zeros(len(x))
        rigid = np.stack([np.column_stack([one, zero, -y]), np.column_stack([zero, one, x])], axis=1)
        self._rigid = np.linalg.qr(rigid.reshape(-1, 3))[0]
        self.gain: F64 | None = None

    def deviations(self, covariance: F64, *, from_camera: bool = False) -> F64:
        """(3,) of floor positions, as distances [m], the median over the pixels, relative to each other or
        ``from_camera``, camera height [1] and tilt [rad].

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
        return np.array([math.sqrt(float(np.median(total)) / len(steps)), height_std, tilt_std])

    def next_sample(self, model: HumanModel, walked: Bool | None) -> NextSample | None:
        """The place where one more person brings the deviations nearest to their limits."""
        if not np.isfinite(self.fit.covariance).all():
            return None
        # Places [m] all over the image, 13 across and 10 down, where a whole person would be.
        fit = self.fit
        camera = fit.camera
        across = np.linspace(0, camera.width - 1, 13)
        down = np.linspace(0, camera.height - 1, 10)
        places = camera.back_project(np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2))
        places = places[np.isfinite(places).all(axis=1)]
        size = np.full(len(places), fit.stature)
        width = np.full(len(places), math.exp(fit.shared[GIRTH]))
        rows = predict(camera, body_points(model), places, np.zeros_like(places), size, width, fit.prior)
        inside = (rows[:, :2] >= 0).all(axis=1) & (rows[:, 2:4] < np.array(camera.size)).all(axis=1)
        # A person lower than this in the image carries no information [px].
        inside &= np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1]) >= 20.0
        places = places[inside]
        rows = rows[inside]
        if walked is not None:
            u, v = rows[:, 6:8].round().astype(int).T
            met = walked[v.clip(0, walked.shape[0] - 1), u.clip(0, walked.shape[1] - 1)]
            places = places[met]
            rows = rows[met]
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
        away = float(np.hypot(*self.fit.camera.back_project(found.foot_px)) / np.median(np.hypot(*self.fit.places_m.T)))
        where = "nearer to the camera" if away < 0.75 else "farther from the camera"
        if 0.75 <= away <= 1.33:
            where = f"at the {'left' if u < self.fit.camera.width / 2 else 'right'} of the image"
        more = f"add people {where}, near pixel ({u:.0f}, {v:.0f})"
        # Six further samples are a bearable effort: where they are not enough, a known value is better advice.
        reached = self._enough(6 * self.gain)
        if self.fit.prior.reading == "boxes":
            more = "mark heads and feet where they are, not at the middles of the boxes' edges"
            reached = False
        if give and not reached:
            return f"{give}, or {more}"
        return f"{more}, or {give}" if give else more

    def _enough(self, gain: F64) -> bool:
        return bool(np.isfinite(self.fit.covariance).all() and (self._after(gain) <= self.limits).all())

    def _after(self, gain: F64) -> F64:
        """``deviations`` with further information."""
        return self.deviations(np.linalg.inv(np.linalg.inv(self.fit.covariance) + gain).astype(np.float64))
