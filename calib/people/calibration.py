"""The camera from a few people: search, refinement and assessment in one call."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.errors import WorkError
from calib.ground_camera import LENS_K_320, GroundCamera
from calib.people._kernels import INFEASIBLE, candidate_errors
from calib.people.assessment import Assessment, CameraDeviations, assess, camera_deviations
from calib.people.model import HumanModel, KnownValues, people_of, prior_of, usual_focal_px
from calib.people.refine import GroundCameraFit, refine, with_focal_spread, with_outline_errors
from calib.people.samples import HumanSample, MarkedPeople, check_samples, level_ends, only_boxes
from calib.types import F64, Bool

KNOWN_RANGE = 1.15
"""A given value is searched up to this factor from it; the deviation decides afterwards (our choice)."""


COARSE = (20, 20, 37)
"""Focal lengths and camera heights, in equal ratios (at most 15 % apart), and tilts (at most 5 degrees apart) tried at
first (our choice)."""
BEAM = 200
"""Best cells kept between steps; height and focal length trade off along a valley (our choice)."""
STEPS = 14
"""Finer steps, each halving the cells [1]; 14 reach 0.001 degrees (our choice)."""
MAX_ERROR = 0.25
"""Largest plausible error of the samples that fit, their median [1]: beyond it they are not standing people in an
upright image (our choice)."""
MAX_HEIGHT_STD = 0.25
"""Relative deviation of the height from which height and focal length count as inseparable (our choice)."""
MAX_DISTANCE_M = 60.0
"""People are not sampled from farther away [m] (our choice: bounds the focal length)."""


class SearchProblem:
    """The samples of one lens class, ready for the kernel; a candidate is (log focal, log height, tilt)."""

    def __init__(
        self, rows: F64, size: tuple[int, int], lens: str, model: HumanModel, known: KnownValues, boxes_only: bool
    ) -> None:
        self.rows, self.size, self.lens, self.model = rows, size, lens, model
        self.known, self.boxes_only = known, boxes_only
        self.k = LENS_K_320[lens] * 320.0 / size[0]
        centre = np.tile([(size[0] - 1) / 2, (size[1] - 1) / 2], 4)
        self.marked = np.ascontiguousarray(rows - centre)
        points = self.marked[:, 4:].reshape(-1, 2, 2)
        root = 1.0 + 4.0 * self.k * np.hypot(points[..., 0], points[..., 1])
        scale = np.where(root > 0, 2.0 / (1.0 + np.sqrt(np.maximum(root, 0.0))), np.nan)
        self.flat = np.ascontiguousarray((points * scale[..., None]).reshape(-1, 4))
        self.circles = model.circles()

    def errors(self, candidates: F64, limit: float = INFEASIBLE) -> F64:
        """(m,) mean errors of (m, 3) candidates, not below ``limit`` where they exceed it."""
        cameras = np.column_stack([np.exp(candidates[:, :2]), candidates[:, 2]])
        out = np.empty(len(cameras))
        if not np.isfinite(self.flat).all():
            return np.full(len(cameras), INFEASIBLE)
        candidate_errors(cameras, self.k, self.flat, self.marked, self.circles, self.model.height_m, limit, out)
        return out

    def camera(self, candidate: F64) -> GroundCamera:
        focal, height = (float(v) for v in np.exp(candidate[:2]))
        return GroundCamera(*self.size, focal, height, float(candidate[2]), self.lens)

    def each(self, camera: GroundCamera) -> F64:
        """(n,) error of every sample."""
        # (n, 8) rows in an image turned clockwise about its centre; boxes keep their size, which small turns allow.
        angle_rad = -camera.roll_rad
        centre = (np.array(self.size) - 1) / 2
        c, s = math.cos(angle_rad), math.sin(angle_rad)
        turn = np.array([[c, -s], [s, c]])
        middle = (self.rows[:, :2] + self.rows[:, 2:4]) / 2
        half = (self.rows[:, 2:4] - self.rows[:, :2]) / 2
        middle, head, foot = ((p - centre) @ turn.T + centre for p in (middle, self.rows[:, 4:6], self.rows[:, 6:8]))
        turned = np.concatenate([middle - half, middle + half, head, foot], axis=1)
        upright = SearchProblem(turned, self.size, self.lens, self.model, self.known, self.boxes_only)
        one = [(upright.flat[i : i + 1], upright.marked[i : i + 1]) for i in range(len(self.rows))]
        values = np.array([[camera.focal_px, camera.height_m, camera.tilt_rad]])
        out = np.empty((len(one), 1))
        for row, (flat, marked) in zip(out, one, strict=True):
            candidate_errors(values, self.k, flat, marked, self.circles, self.model.height_m, np.inf, row)
        return out[:, 0]

    def bounds(self) -> tuple[F64, F64]:
        """Lower and upper (log focal, log height, tilt) that the samples allow (section 3.3)."""
        box = self.marked[:, 2:4] - self.marked[:, :2]
        diagonal = np.hypot(box[:, 0], box[:, 1])
        upright = (self.marked[:, 7] - self.marked[:, 5]) / diagonal
        low_tilt, high_tilt = math.radians(-89.0), math.radians(89.0)
        # Heads above feet everywhere: the point below the camera is beneath the image's people, so it looks forward.
        if upright.min() > 0.5:
            low_tilt = 0.0
        elif upright.max() < -0.5:
            high_tilt = 0.0
        elif np.abs(upright).max() < 0.5:
            low_tilt, high_tilt = math.radians(-60.0), math.radians(60.0)
        size = math.hypot(self.model.height_m, 2 * self.model.torso_radius_m)
        width = self.size[0]
        # 150 degrees of view at most; at least what shows the smallest sample at the largest distance.
        low_focal = 0.13 * width
        high_focal = max(2.0 * low_focal, min(10.0 * width, MAX_DISTANCE_M * float(diagonal.min()) / size * 2))
        if self.boxes_only:
            usual = usual_focal_px(self.lens, width)
            low_focal, high_focal = max(low_focal, 0.5 * usual), 2.0 * usual
        focal = self.known.focal(width, self.k)
        if focal is not None:
            low_focal, high_focal = focal / KNOWN_RANGE, focal * KNOWN_RANGE
        high_height = self.model.height_m + high_focal * size / float(diagonal.max())
        low_height, high_height = self.model.height_m * 1.15, min(high_height, MAX_DISTANCE_M)
        if self.known.height_m is not None:
            low_height, high_height = self.known.height_m / KNOWN_RANGE, self.known.height_m * KNOWN_RANGE
        low = np.array([math.log(low_focal), math.log(low_height), low_tilt])
        high = np.array([math.log(high_focal), math.log(max(high_height, low_height * 1.01)), high_tilt])
        return low, high


def search(problem: SearchProblem) -> F64:
    """The last (m, 3) candidates kept, best first."""
    low, high = problem.bounds()
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, COARSE, strict=True)]
    candidates = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    step = (high - low) / (np.array(COARSE) - 1)
    around = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    limit = INFEASIBLE
    for step_number in range(STEPS + 1):
        n_kept = max(BEAM >> step_number, 20)
        errors = problem.errors(candidates, limit) if step_number else _first_errors(problem, candidates, n_kept)
        best = np.argsort(errors, kind="stable")[:n_kept]
        kept, limit = candidates[best], float(errors[best[-1]])
        step = step / 2
        candidates = np.unique((kept[:, None] + step * around).reshape(-1, 3), axis=0)
        candidates = np.clip(candidates, low, high)
    return kept


def _first_errors(problem: SearchProblem, candidates: F64, n_kept: int) -> F64:
    """(m,) errors of the first cells, in parts that are spread over all of them.

    The ``n_kept`` best so far are a limit for the next part: beyond it no cell is kept, and need not be computed.
    """
    errors, limit, parts = np.full(len(candidates), np.inf), INFEASIBLE, 16
    for part in range(parts):
        errors[part::parts] = problem.errors(candidates[part::parts], limit)
        known = errors[np.isfinite(errors)]
        if len(known) >= n_kept:
            limit = min(limit, float(np.partition(known, n_kept - 1)[n_kept - 1]))
    return errors


ODD_FROM = 3.0
"""A sample whose residuals are this many deviations is odd: not a standing person, or marked wrongly (our choice)."""


@dataclass(frozen=True, eq=False)
class HumanCalibration:
    """A camera from people, and how far to trust it.

    Attributes:
        camera: the best one.
        model: the person it was found with.
        error: mean weighted error E = whf Ehf + wbb Ebb over the samples (Zhang 2008).
        sample_errors: (n,) float64 E per sample.
        std: standard deviations of height, tilt, focal length and roll.
        assessment: expected floor error, whether it is enough, and where to add the next sample.
        odd: numbers of the samples that fit badly and were weighted down.
        girth: width of the sampled people against the model's [1].
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
    girth: float
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
    """The camera whose projected people fit the samples best, its deviations and a verdict.

    A camera that is not known well enough is returned all the same, and its assessment shows it; one of which height
    and focal length cannot be separated at all is refused.

    Args:
        samples: at least 3 people at different places.
        size: (width, height) of the image [px].
        lens: class of table 2; None tries all.
        known: focal length or field of view, camera height, height of the people, as far as known.
        independent: so many of the samples are independent, as of few people observed often, found by outlines of
            foreground; None for all, marked by hand. The others repeat the same body height, gait and shadow, and are
            weighted down.
        name: of the samples' source, for messages.
        walked: (height, width), where something moved in the recording: more people are asked for there only.
    Raises:
        InputError: samples from which no camera can be determined.
        WorkError: no camera fits them, or too many do.
        ValueError: an unknown lens.
    """
    check_samples(samples, size, name)
    if lens is not None and lens not in LENS_K_320:
        raise ValueError(f"expected a lens of {', '.join(LENS_K_320)}, got {lens!r}")
    known = known or KnownValues()
    model = HumanModel().scaled(known.person_height_m or HumanModel().height_m)
    start = time.perf_counter()
    people = people_of(samples, model, independent)
    best = _best([lens] if lens else list(LENS_K_320), size, people, model, known)
    _refuse_unfit(best, name)
    fit = with_focal_spread(best.fit, people, model)
    if independent is not None:
        fit = with_outline_errors(fit, people, model)
    std = camera_deviations(fit)
    roll_deg = math.degrees(fit.camera.roll_rad)
    # A larger roll is none of a camera, but of wrong samples (our choice: 3.5 deviations of the prior).
    if abs(roll_deg) > 7.0:
        raise WorkError(
            f"{name}: expected an upright image, found people who lean as in one turned by {roll_deg:.0f} degrees: "
            "blobs that are not one person each, or a camera to be turned"
        )
    if not std.height <= MAX_HEIGHT_STD:
        raise WorkError(
            f"{name}: camera height and focal length cannot be separated by these samples (height known to "
            f"{min(std.height, 10):.0%}): add people nearer to and farther from the camera, or give the focal length "
            "or the camera's height"
        )
    errors = best.problem.each(fit.camera)
    return HumanCalibration(
        camera=fit.camera,
        model=model,
        error=float(errors.mean()),
        sample_errors=errors,
        std=std,
        assessment=assess(fit, people, model, walked),
        odd=tuple(int(i) for i in np.flatnonzero(fit.deviations > ODD_FROM)),
        girth=fit.girth,
        stature=fit.stature,
        boxes_only=fit.prior.boxes_only,
        search_s=time.perf_counter() - start,
    )


def _refuse_unfit(best: _Tried, name: str) -> None:
    """Most samples must fit well; how badly the odd ones fit, which are weighted down, does not matter."""
    fits = best.fit.deviations <= ODD_FROM
    error = float(np.median(best.problem.each(best.fit.camera)[fits])) if fits.any() else math.inf
    if error > MAX_ERROR or fits.mean() < 0.5:
        raise WorkError(
            f"{name}: no camera fits the samples: error {error:.2f} (at most {MAX_ERROR:g}), "
            f"{1.0 - fits.mean():.0%} of the samples far off; "
            "are they standing people of one size in upright images of this size?"
        )


@dataclass(frozen=True, eq=False)
class _Tried:
    problem: SearchProblem
    fit: GroundCameraFit


def _best(
    lenses: Sequence[str],
    size: tuple[int, int],
    people: MarkedPeople,
    model: HumanModel,
    known: KnownValues,
) -> _Tried:
    """The likeliest of the fits of every lens and every reading of the samples."""
    readings = (True,) if only_boxes(people.rows) else (False, True)
    problems = [SearchProblem(people.rows, size, lens, model, known, boxes) for lens in lenses for boxes in readings]
    quick = [t for p in problems for t in _fits(p, people)]
    # Fits whose log-evidence is lower by more are not refined further (our choice: one in 10^8).
    rival = max(t.fit.log_evidence for t in quick) - 20.0
    near = [t for t in quick if t.fit.log_evidence >= rival]
    full = [replace(t, fit=refine(t.fit.camera, people, model, t.fit.prior)) for t in near]
    return max(full, key=lambda t: t.fit.log_evidence)


def _fits(problem: SearchProblem, people: MarkedPeople) -> list[_Tried]:
    """The best fit of every way in which boxes may end, with people who vary as much as expected."""
    cameras = [problem.camera(candidate) for candidate in _distinct(search(problem))]
    ends = (False,) if problem.boxes_only else (True,) if level_ends(people.rows) else (False, True)
    tried = []
    for level in ends:
        prior = prior_of(cameras[0], problem.known, problem.boxes_only, level)
        refined = [refine(camera, people, problem.model, prior, variation=1.0) for camera in cameras]
        tried.append(_Tried(problem, max(refined, key=lambda r: r.log_evidence)))
    return tried


def _distinct(candidates: F64) -> list[F64]:
    """The best few of (m, 3) sorted candidates that lie in different valleys."""
    kept: list[F64] = []
    for candidate in candidates:
        if all(np.abs(candidate - other).max() > 0.05 for other in kept):
            kept.append(candidate)
    # So many distinct results of the search are refined (our choice).
    return kept[:3]
