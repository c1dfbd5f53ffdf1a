"""One camera from standing people: height, tilt and focal length by search (Zhang et al. 2008, section 3.3)."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.errors import WorkError
from calib.ground_camera import LENS_K_320, GroundCamera
from calib.human._kernels import INFEASIBLE, candidate_errors
from calib.human.model import HumanModel
from calib.human.refine import GroundCameraFit, only_boxes, refine, usual_focal_px
from calib.human.samples import HumanSample, check_samples
from calib.params import Params
from calib.types import F64


class HumanCalibrationParams(Params):
    """The search for a camera."""

    coarse_tilts: int = Field(default=37, ge=5, le=361)
    """Tilts tried at first over their range [1] (our choice: at most 5 degrees apart)."""
    coarse_focals: int = Field(default=20, ge=3, le=200)
    """Focal lengths tried at first, in equal ratios [1] (our choice: at most 15 % apart)."""
    coarse_heights: int = Field(default=20, ge=3, le=200)
    """Camera heights tried at first, in equal ratios [1] (our choice)."""
    beam: int = Field(default=200, ge=1, le=1000)
    """Best cells kept between steps; height and focal length trade off along a valley (our choice)."""
    steps: int = Field(default=14, ge=1, le=30)
    """Finer steps, each halving the cells [1]; 14 reach 0.001 degrees (our choice)."""
    max_error: float = Field(default=0.25, gt=0)
    """Largest plausible error [1]: beyond it the samples are not standing people in an upright image (our choice)."""
    max_height_std: float = Field(default=0.25, gt=0)
    """Relative deviation of the height from which height and focal length count as inseparable (our choice)."""
    max_distance_m: float = Field(default=60.0, gt=1, le=500)
    """People are not sampled from farther away [m] (our choice: bounds the focal length)."""


@dataclass(frozen=True, eq=False)
class HumanCalibration:
    """A camera and how well it fits the samples.

    Attributes:
        camera: the best one.
        model: the person it was found with.
        error: mean weighted error E = whf Ehf + wbb Ebb over the samples.
        sample_errors: (n,) float64 E per sample.
        std: deviations of (height [relative], tilt [rad], focal length [relative]) for points marked to 2 px.
        girth: width of the sampled people against the model's [1].
        boxes_only: whether heads and feet were but the middles of the boxes' edges (``human_refine.only_boxes``).
        search_s: duration of the search [s].
    """

    camera: GroundCamera
    model: HumanModel
    error: float
    sample_errors: F64
    std: tuple[float, float, float]
    girth: float
    boxes_only: bool
    search_s: float


def calibrate_from_people(
    samples: Sequence[HumanSample],
    size: tuple[int, int],
    lens: str | None = None,
    *,
    model: HumanModel | None = None,
    params: HumanCalibrationParams | None = None,
    name: str = "samples",
) -> HumanCalibration:
    """Search the camera whose projected people fit the samples best, from coarse to fine.

    The paper's E_bb and weights are illegible in the copy at hand; our choice is E_bb = 1 - IoU of the boxes,
    w_hf = D_hf / D_bb (head to foot over the diagonal of the box), w_bb = 1 - w_hf. The person stands where head and
    foot together project nearest to the sample's (the paper is silent; our choice).

    Args:
        samples: at least 3 people of the model's height at different places.
        size: (width, height) of the image [px].
        lens: class of table 2; None tries all and takes the best.
        model: the person; the paper's 1.76 m by default.
        params: of the search.
        name: of the samples' source, for messages.
    Raises:
        InputError: samples from which no camera can be told.
        WorkError: no camera fits them.
        ValueError: an unknown lens.
    """
    check_samples(samples, size, name)
    if lens is not None and lens not in LENS_K_320:
        raise ValueError(f"expected a lens of {', '.join(LENS_K_320)}, got {lens!r}")
    model, params = model or HumanModel(), params or HumanCalibrationParams()
    _warm_up()
    start = time.perf_counter()
    rows = np.stack([sample.row() for sample in samples])
    problems = [_Problem(rows, size, kind, model) for kind in ([lens] if lens else LENS_K_320)]
    found = min((_fit(problem, params) for problem in problems), key=lambda fit: fit.refined.cost)
    elapsed = time.perf_counter() - start
    errors = found.problem.each(found.refined.camera)
    _check_fit(found, params, name)
    return HumanCalibration(
        found.refined.camera,
        model,
        float(errors.mean()),
        errors,
        found.refined.std,
        found.refined.girth,
        only_boxes(rows),
        elapsed,
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    problem: _Problem
    error: float
    refined: GroundCameraFit


def _check_fit(found: _Fit, params: HumanCalibrationParams, name: str) -> None:
    if found.error > params.max_error:
        raise WorkError(
            f"{name}: no camera fits the samples: best error {found.error:.2f} (at most {params.max_error:g}); "
            "are they standing people of one size in upright images of this size?"
        )
    height_std = found.refined.std[0]
    if height_std > params.max_height_std:
        raise WorkError(
            f"{name}: camera height and focal length cannot be told apart from these samples (height known to "
            f"{min(height_std, 10):.0%}): add people nearer to and farther from the camera"
        )


def _fit(problem: _Problem, params: HumanCalibrationParams) -> _Fit:
    candidates, errors = _search(problem, params)
    refined = [refine(problem.camera(c), problem.rows, problem.model) for c in _distinct(candidates)]
    return _Fit(problem, float(errors[0]), min(refined, key=lambda r: r.cost))


def _distinct(candidates: F64, count: int = 3) -> list[F64]:
    """The best few of (m, 3) sorted candidates that lie in different valleys."""
    kept: list[F64] = []
    for candidate in candidates:
        if all(np.abs(candidate - other).max() > 0.05 for other in kept):
            kept.append(candidate)
    return kept[:count]


class _Problem:
    """The samples of one lens class, ready for the kernel; a candidate is (log focal, log height, tilt)."""

    def __init__(self, rows: F64, size: tuple[int, int], lens: str, model: HumanModel) -> None:
        self.rows, self.size, self.lens, self.model = rows, size, lens, model
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
        upright = _Problem(_turned(self.rows, self.size, -camera.roll_rad), self.size, self.lens, self.model)
        one = [(upright.flat[i : i + 1], upright.marked[i : i + 1]) for i in range(len(self.rows))]
        values = np.array([[camera.focal_px, camera.height_m, camera.tilt_rad]])
        out = np.empty((len(one), 1))
        for row, (flat, marked) in zip(out, one, strict=True):
            candidate_errors(values, self.k, flat, marked, self.circles, self.model.height_m, np.inf, row)
        return out[:, 0]

    def bounds(self, params: HumanCalibrationParams) -> tuple[F64, F64]:
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
        high_focal = max(2.0 * low_focal, min(10.0 * width, params.max_distance_m * float(diagonal.min()) / size * 2))
        if only_boxes(self.rows):
            usual = usual_focal_px(self.lens, width)
            low_focal, high_focal = max(low_focal, 0.5 * usual), 2.0 * usual
        high_height = self.model.height_m + high_focal * size / float(diagonal.max())
        low = np.array([math.log(low_focal), math.log(self.model.height_m * 1.15), low_tilt])
        high = np.array([math.log(high_focal), math.log(min(high_height, params.max_distance_m)), high_tilt])
        return low, high


def _search(problem: _Problem, params: HumanCalibrationParams) -> tuple[F64, F64]:
    """The last (m, 3) candidates kept and their errors, best first."""
    low, high = problem.bounds(params)
    counts = (params.coarse_focals, params.coarse_heights, params.coarse_tilts)
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    candidates = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    step = (high - low) / (np.array(counts) - 1)
    around = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    limit = INFEASIBLE
    for step_number in range(params.steps + 1):
        errors = problem.errors(candidates, limit)
        best = np.argsort(errors, kind="stable")[: max(params.beam >> step_number, 20)]
        kept, limit = candidates[best], float(errors[best[-1]])
        step = step / 2
        candidates = np.unique((kept[:, None] + step * around).reshape(-1, 3), axis=0)
        candidates = np.clip(candidates, low, high)
    return kept, errors[best]


def _warm_up() -> None:
    """Have the kernel compiled, so that durations are the search's own."""
    flat, marked = np.zeros((1, 4)), np.array([[-1.0, -1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]])
    candidate_errors(np.array([[1.0, 3.0, 0.0]]), 0.0, flat, marked, np.zeros((1, 3)), 1.7, 1.0, np.empty(1))


def _turned(rows: F64, size: tuple[int, int], angle_rad: float) -> F64:
    """(n, 8) rows in an image turned clockwise about its centre; boxes keep their size, which small turns allow."""
    centre = (np.array(size) - 1) / 2
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turn = np.array([[c, -s], [s, c]])
    middle = (rows[:, :2] + rows[:, 2:4]) / 2
    half = (rows[:, 2:4] - rows[:, :2]) / 2
    middle, head, foot = ((p - centre) @ turn.T + centre for p in (middle, rows[:, 4:6], rows[:, 6:8]))
    return np.concatenate([middle - half, middle + half, head, foot], axis=1)
