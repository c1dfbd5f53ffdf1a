"""The camera from a few people, how well it is known (ours), and where one more person would help most."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.errors import WorkError
from calib.ground_camera import LENS_K_320, CameraDeviations, GroundCamera, distortion_k
from calib.people.fit import (
    STRETCHES,
    GroundCameraFit,
    Residuals,
    at_mean_focal,
    body_points,
    fit_camera,
    predict,
    shared_camera,
    with_stretches_left_out,
)
from calib.people.model import (
    FOCAL,
    GIRTH,
    HEIGHT,
    N_CAMERA,
    N_SHARED,
    PERSON_STD,
    ROLL,
    STATURE,
    TILT,
    CameraPrior,
    HumanModel,
    KnownValues,
    Reading,
    people_of,
    prior_of,
)
from calib.people.samples import HumanSample, MarkedPeople, level_ends, only_boxes, refuse_bad_samples
from calib.types import F64, AnyArray, Bool

GRID = (14, 24, 37)
"""Focal lengths and camera heights in equal ratios, and tilts (at most 5 degrees apart) to start from."""
STARTS = 3
"""Distinct results of the search that are refined (height and focal length trade off in a valley)."""
MAX_ERROR = 0.25
"""Largest plausible error of the samples that fit, their median [1]: beyond it they are not standing people in an
upright image."""
MAX_SIZE_STD = 0.2
"""Relative deviation of the size of people in the image up to which a camera is of use: beyond it, adults pass for
children."""
MAX_DISTANCE_M = 60.0
"""People are not sampled from farther away [m] (bounds the height of the camera)."""
ODD_FROM = 3.0
"""A sample whose residuals are this many deviations is odd: not a standing person, or marked wrongly."""


class Assessment(NamedTuple):
    """Verdict on a camera from people.

    Attributes:
        enough: whether the camera predicts how large people are in the image.
        next_sample: where the foot (u, v) of one more person helps most [px]; None where none does.
        sentence: all of this in words, beginning with "enough" or "not enough".
    """

    enough: bool
    next_sample: tuple[float, float] | None
    sentence: str


@dataclass(frozen=True, eq=False)
class HumanCalibration:
    """A camera from people, and how far to trust it.

    Attributes:
        camera, model: the best one, which holds its deviations, and the person it was found with.
        error, sample_errors: weighted error E = whf Ehf + wbb Ebb (Zhang 2008), mean and (n,) per sample.
        std, assessment: deviations, whether they are enough, and where to add the next sample.
        odd: numbers of the samples that fit badly and were weighted down.
        boxes_only: whether heads and feet were read as but the middles of the boxes' edges.
    """

    camera: GroundCamera
    model: HumanModel
    error: float
    sample_errors: F64
    std: CameraDeviations
    assessment: Assessment
    odd: tuple[int, ...]
    boxes_only: bool


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
    which no camera can be determined. WorkError: no camera fits them. ValueError: an unknown lens.

    Args:
        size: (width, height) of the image [px].
        lens: class of table 2; None tries all.
        known: focal length or field of view, camera height, height of the people, as far as known.
        independent: number of independent samples, where few people were observed often by outlines of foreground;
            None for all, marked by hand. The others repeat body height, gait and shadow, and are weighted down.
        name: of the samples' source, for messages.
        walked: (height, width), where something moved in the recording: more people are suggested there only.
    """
    refuse_bad_samples(samples, size, name)
    if lens is not None and lens not in LENS_K_320:
        raise ValueError(f"expected a lens of {', '.join(LENS_K_320)}, got {lens!r}")
    known = known or KnownValues()
    model = HumanModel().scaled(known.person_height_m or HumanModel().height_m)
    people = people_of(samples, model, independent)
    lenses = [lens] if lens else list(LENS_K_320)
    best = _best_fit(lenses, size, people, model, known)
    fit = at_mean_focal(best, people, model)
    if independent is not None and len(people) > 3 * STRETCHES:
        fit = with_stretches_left_out(fit, people, model, [sample.frame for sample in samples])
    errors = weighted_errors(fit.camera, fit.places_m, people.rows, model)
    _refuse_unfit(fit, errors, name)
    std, assessment = assess(fit, people, model, walked)
    return HumanCalibration(
        camera=replace(fit.camera, std=std),
        model=model,
        error=float(errors.mean()),
        sample_errors=errors,
        std=std,
        assessment=assessment,
        odd=tuple(np.flatnonzero(fit.deviations > ODD_FROM).tolist()),
        boxes_only=fit.prior.reading == "boxes",
    )


def _best_fit(
    lenses: Sequence[str], size: tuple[int, int], people: MarkedPeople, model: HumanModel, known: KnownValues
) -> GroundCameraFit:
    """The likeliest of the fits of every lens and every reading of the samples."""
    readings: list[Reading] = ["boxes"]
    if not only_boxes(people.rows):
        readings.append("level")
        if not level_ends(people.rows):
            readings.append("outline")
    quick = []
    for lens in lenses:
        for reading in readings:
            prior = prior_of(lens, size[0], known, reading)
            cameras = starts(people, size, lens, model, prior)
            fits = [fit_camera(camera, people, model, prior, variation=1.0) for camera in cameras]
            quick.append(max(fits, key=lambda fit: fit.log_evidence))
    # Fits whose log-evidence is lower by more are not refined further (one in 10^8).
    least = max(fit.log_evidence for fit in quick) - 20.0
    full = [fit_camera(fit.camera, people, model, fit.prior) for fit in quick if fit.log_evidence >= least]
    return max(full, key=lambda fit: fit.log_evidence)


def starts(
    people: MarkedPeople, size: tuple[int, int], lens: str, model: HumanModel, prior: CameraPrior
) -> list[GroundCamera]:
    """The best few cameras of a grid that differ, by where heads are above the marked feet and by the boxes' sizes."""
    low = prior.mean - 2.5 * np.minimum(prior.std, 1.0)
    high = prior.mean + 2.5 * np.minimum(prior.std, 1.0)
    if not np.isfinite(prior.std[HEIGHT]):
        low[HEIGHT] = math.log(1.15 * model.height_m)
        high[HEIGHT] = math.log(MAX_DISTANCE_M)
    focals = np.exp(np.linspace(low[FOCAL], high[FOCAL], GRID[0]))
    heights = np.exp(np.linspace(low[HEIGHT], high[HEIGHT], GRID[1]))
    tilts = np.radians(np.linspace(-89.0, 89.0, GRID[2]))
    # (n, 3) focal length [px], height [m] and tilt [rad].
    grid = np.stack(np.meshgrid(focals, heights, tilts, indexing="ij"), axis=-1).reshape(-1, 3)
    marked = _undistort(people.rows, size, lens)
    errors = _grid_errors(grid, marked, model)
    chosen: list[F64] = []
    for i in np.argsort(errors, kind="stable")[:2000]:
        focal_px, height_m, tilt_rad = grid[i]
        camera = np.array([math.log(focal_px), math.log(height_m), tilt_rad])
        if all(np.abs(camera - other).max() > 0.3 for other in chosen):
            chosen.append(camera)
        if len(chosen) == STARTS:
            break
    return [GroundCamera(*size, math.exp(f), math.exp(h), float(tilt), lens) for f, h, tilt in chosen]


def _undistort(rows: F64, size: tuple[int, int], lens: str) -> F64:
    """(n, 4, 2) both corners of the boxes, heads and feet of (n, 8) rows, from the image centre, without distortion."""
    marked = rows.reshape(-1, 4, 2) - (np.array(size) - 1) / 2
    k = distortion_k(lens, size[0])
    root = np.maximum(1.0 + 4.0 * k * np.linalg.norm(marked, axis=2), 0.0)
    return np.asarray(marked * (2.0 / (1.0 + np.sqrt(root)))[..., None])


def _grid_errors(grid: F64, marked: F64, model: HumanModel) -> F64:
    """(n,) mean differences between marked and predicted people, in diagonals of their boxes, for (n, 3) cameras."""
    f, h, tilt = (column.reshape(-1, 1) for column in grid.T)
    s = np.sin(tilt)
    c = np.cos(tilt)
    left_top, right_bottom, head, foot = np.moveaxis(marked, 1, 0)
    box = right_bottom - left_top
    below_head = h - model.height_m
    with np.errstate(all="ignore"):
        # People stand where the marked foot meets the floor; from there follow their heads and how large they look.
        far = h / (f * c + foot[:, 1] * s)
        x = far * foot[:, 0]
        y = far * (f * s - foot[:, 1] * c)
        depth = y * s + below_head * c
        u = f * x / depth
        v = f * (below_head * s - y * c) / depth
        shoulder = 2.0 * model.torso_radius_m * f / (y * s + (h - 0.85 * model.height_m) * c)
        off = np.hypot(u - head[:, 0], v - head[:, 1])
        off += np.abs(np.abs(u - foot[:, 0]) + shoulder - box[:, 0])
        # From above, a body is as long as its shoulders are wide; from the side its length is that from head to foot.
        length = np.maximum(np.abs(v - foot[:, 1]), shoulder)
        off += np.abs(length - box[:, 1])
        off /= np.hypot(*box.T)
    is_seen = (far > 0) & (depth > 0.05)
    return np.asarray(np.minimum(np.where(is_seen, off, np.inf), 1.5).mean(axis=1))


def weighted_errors(camera: GroundCamera, places_m: F64, rows: F64, model: HumanModel) -> F64:
    """(n,) error E = whf Ehf + wbb Ebb of the (n, 8) rows of people at (n, 2) places [m] (Zhang 2008, section 3.3)."""
    boxes = model.boxes(camera, places_m)
    low = boxes[:, :2]
    high = low + boxes[:, 2:]
    area = boxes[:, 2:].prod(axis=1)
    marked_low = rows[:, :2]
    marked_high = rows[:, 2:4]
    marked_area = (marked_high - marked_low).prod(axis=1)

    ends = np.stack([model.head(camera, places_m), model.foot(camera, places_m)], axis=1)
    distance = np.linalg.norm(ends - rows[:, 4:].reshape(-1, 2, 2), axis=2).mean(axis=1)
    radius = (np.sqrt(area / math.pi) + np.sqrt(marked_area / math.pi)) / 2

    sides = np.minimum(high, marked_high) - np.maximum(low, marked_low)
    common = np.maximum(sides, 0.0).prod(axis=1)
    overlap = common / (area + marked_area - common)

    length = np.linalg.norm(rows[:, 4:6] - rows[:, 6:], axis=1)
    diagonal = np.linalg.norm(marked_low - marked_high, axis=1)
    weight = np.minimum(1.0, length / diagonal)
    errors = weight * distance / radius + (1.0 - weight) * (1.0 - overlap)
    return np.asarray(np.nan_to_num(errors, nan=np.inf))


def _refuse_unfit(fit: GroundCameraFit, errors: F64, name: str) -> None:
    """Refuse samples most of which fit no camera; how badly the odd ones fit does not matter."""
    is_fit = fit.deviations <= ODD_FROM
    error = float(np.median(errors[is_fit])) if is_fit.any() else math.inf
    if error > MAX_ERROR or is_fit.mean() < 0.5:
        actual = f"error {error:.2f} (at most {MAX_ERROR:g}), {1.0 - is_fit.mean():.0%} of the samples far off"
        question = "are they standing people of one size in upright images of this size?"
        raise WorkError(f"{name}: no camera fits the samples: {actual}; {question}")
    roll_deg = math.degrees(fit.camera.roll_rad)
    # A larger roll is none of a camera, but of wrong samples (3.5 deviations of the prior).
    if abs(roll_deg) > 7.0:
        actual = f"people who lean as in one turned by {roll_deg:.0f} degrees"
        causes = "blobs that are not one person each, or a camera to be turned"
        raise WorkError(f"{name}: expected an upright image, found {actual}: {causes}")


def assess(
    fit: GroundCameraFit, people: MarkedPeople, model: HumanModel, walked: Bool | None = None
) -> tuple[CameraDeviations, Assessment]:
    """How well camera and floor are known over the region that the samples cover, and what would help most: more people
    only where ``walked`` (height, width) is set; None for anywhere."""
    # (m, 2) pixels: the feet and the middles between any two of them.
    feet = people.rows[:, 6:]
    first, second = np.triu_indices(len(feet))
    middles = 0.5 * (feet[first] + feet[second])
    advisor = _Advisor(fit, model, np.asarray(middles[:: max(1, len(middles) // 1000)]))
    relative, from_camera, size = advisor.deviations(fit.covariance).tolist()
    angles = np.degrees(fit.std).tolist()
    height, focal = fit.std[[HEIGHT, FOCAL]].tolist()
    std = CameraDeviations(height, angles[TILT], focal, angles[ROLL], relative, from_camera)
    next_sample = advisor.next_sample(walked)
    known = f"the size of people in the image is known to {min(size, 1.0):.0%}"
    if size <= MAX_SIZE_STD:
        return std, Assessment(True, next_sample, f"enough: {known}; where people were marked, {std.sentence}")
    advice = "mark more people, at more distances"
    if fit.prior.reading == "boxes":
        advice = "mark heads and feet where they are, not at the middles of the boxes' edges"
    elif next_sample is not None:
        u, v = next_sample
        advice = f"mark more people near pixel ({u:.0f}, {v:.0f})"
    sentence = f"not enough: {known} (at most {MAX_SIZE_STD:.0%}); {advice}, or give focal length and camera height"
    return std, Assessment(False, next_sample, sentence)


_TURNS_RAD = np.deg2rad([[-89.0, -44.0], [89.0, 44.0]])
"""Lowest and highest tilt and roll that a ``GroundCamera`` has."""


class _Advisor:
    """Finds how certain the camera is, and what would make it more so: another person, or a given value."""

    def __init__(self, fit: GroundCameraFit, model: HumanModel, pixels: F64) -> None:
        """Prepare; floor positions are judged at (n, 2) pixels."""
        self.fit = fit
        self._model = model
        self._pixels = pixels[np.isfinite(fit.camera.back_project(pixels)).all(axis=1)]
        self._places, self._rows = self._candidates()

    def deviations(self, covariance: F64) -> F64:
        """(3,) deviations, medians: of floor positions over their distance from the camera, relative to each other and
        from the camera, and of the size of people all over the image [1].

        Far places move more than in proportion, so that cameras away from the fit are tried: the points of the
        unscented transform (Julier and Uhlmann 1997).
        """
        if not np.isfinite(covariance).all() or not self._pixels.size or not self._places.size:
            return np.full(3, math.inf)
        squares, axes = np.linalg.eigh(covariance[:N_CAMERA, :N_CAMERA])
        steps = np.zeros((N_CAMERA, N_SHARED))
        steps[:, :N_CAMERA] = (axes * np.sqrt(N_CAMERA * np.maximum(squares, 0.0))).T
        relative = np.zeros(len(self._pixels))
        from_camera = np.zeros(len(self._pixels))
        size = np.zeros(len(self._places))
        floor = self._floor(self.fit.camera)
        arms = floor - floor.mean()
        sizes = self._log_sizes(self.fit.camera)
        for step in (*steps, *-steps):
            shared = self.fit.shared + step
            shared[[TILT, ROLL]] = np.clip(shared[[TILT, ROLL]], *_TURNS_RAD)
            camera = shared_camera(shared, self.fit.camera)
            off = np.nan_to_num(self._floor(camera) - floor)
            from_camera += np.abs(off) ** 2
            off -= off.mean()
            turn_rad = (arms.conj() * off).imag.sum() / np.vdot(arms, arms).real
            relative += np.abs(off - 1j * turn_rad * arms) ** 2
            size += np.nan_to_num(self._log_sizes(camera) - sizes, nan=1.0) ** 2
        squared_m = np.abs(floor) ** 2
        medians = [np.median(relative / squared_m), np.median(from_camera / squared_m), np.median(size)]
        return np.sqrt(np.array(medians) / len(steps))

    def _floor(self, camera: GroundCamera) -> AnyArray:
        """(n,) places on the floor that a camera shows at the pixels, x + iy [m]."""
        return camera.back_project(self._pixels) @ [1.0, 1j]

    def _log_sizes(self, camera: GroundCamera) -> F64:
        """(n,) logarithms of how large a camera shows people with their feet at the pixels of the candidates."""
        boxes = self._model.boxes(camera, camera.back_project(self._rows[:, 6:]))
        return np.asarray(np.log(np.maximum(np.hypot(boxes[:, 2], boxes[:, 3]), 1e-3)))

    def next_sample(self, walked: Bool | None) -> tuple[float, float] | None:
        """The place where one more person makes places best known from the camera."""
        fit = self.fit
        if not np.isfinite(fit.covariance).all():
            return None
        places = self._places
        rows = self._rows
        if walked is not None:
            u, v = rows[:, 6:8].round().astype(int).T
            is_walked = walked[v.clip(0, walked.shape[0] - 1), u.clip(0, walked.shape[1] - 1)]
            places = places[is_walked]
            rows = rows[is_walked]
        if not len(places):
            return None
        known = np.linalg.inv(fit.covariance)
        after = [
            self.deviations(np.linalg.inv(known + gain).astype(np.float64))[1]
            for gain in self._information(places, rows)
        ]
        best = int(np.argmin(after))
        return float(rows[best, 6]), float(rows[best, 7])

    def _candidates(self) -> tuple[F64, F64]:
        """Places [m] all over the image, 13 across and 10 down, where a whole person would be, and their rows."""
        fit = self.fit
        camera = fit.camera
        across = np.linspace(0, camera.width - 1, 13)
        down = np.linspace(0, camera.height - 1, 10)
        places = camera.back_project(np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2))
        places = places[np.isfinite(places).all(axis=1)]
        size = np.full(len(places), math.exp(fit.shared[STATURE]))
        width = np.full(len(places), math.exp(fit.shared[GIRTH]))
        rows = predict(camera, body_points(self._model), places, np.zeros_like(places), size, width, fit.prior)
        is_inside = (rows[:, :2] >= 0).all(axis=1) & (rows[:, 2:4] < np.array(camera.size)).all(axis=1)
        # A person lower than this in the image carries no information [px].
        is_inside &= np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1]) >= 20.0
        return places[is_inside], rows[is_inside]

    def _information(self, places: F64, rows: F64) -> F64:
        """(k, N_SHARED, N_SHARED) information of each of k people on the shared unknowns, its place being free."""
        n = len(rows)
        people = MarkedPeople(rows, np.ones(n), np.full(n, PERSON_STD), np.zeros(n, np.bool_))
        values = np.append(self.fit.shared, places)
        jacobian = Residuals(self.fit.camera, people, self._model, self.fit.prior, values, 1.0).jacobian(values)
        blocks = jacobian[: 8 * n].reshape(n, 8, -1)
        by_shared = blocks[..., :N_SHARED]
        numbers = np.arange(n)
        by_place = np.stack([blocks[numbers, :, N_SHARED + 2 * numbers + k] for k in range(2)], axis=-1)
        transposed = by_place.transpose(0, 2, 1)
        place_change = np.linalg.solve(transposed @ by_place + 1e-12 * np.eye(2), transposed @ by_shared)
        left_over = by_shared - by_place @ place_change
        return np.asarray(left_over.transpose(0, 2, 1) @ left_over)
