"""Search of the camera whose projected people fit samples best, coarse to fine (Zhang et al. 2008, section 3.3)."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from calib.ground_camera import LENS_K_320, GroundCamera
from calib.params import Params
from calib.people._kernels import INFEASIBLE, candidate_errors
from calib.people.model import HumanModel, KnownValues, usual_focal_px
from calib.types import F64

PARTS = 16
"""The first cells are searched in so many parts (our choice)."""
KNOWN_RANGE = 1.15
"""A value that was told is searched up to this factor from it; the deviation decides afterwards (our choice)."""


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
    """Largest plausible error of the samples that fit, their median [1]: beyond it they are not standing people in an
    upright image (our choice)."""
    max_height_std: float = Field(default=0.25, gt=0)
    """Relative deviation of the height from which height and focal length count as inseparable (our choice)."""
    max_distance_m: float = Field(default=60.0, gt=1, le=500)
    """People are not sampled from farther away [m] (our choice: bounds the focal length)."""


class SearchProblem:
    """The samples of one lens class, ready for the kernel; a candidate is (log focal, log height, tilt)."""

    def __init__(
        self, rows: F64, size: tuple[int, int], lens: str, model: HumanModel, known: KnownValues, boxes_only: bool
    ) -> None:
        """Args:
        rows: (n, 8) samples (see ``HumanSample.row``).
        size: (width, height) of the image [px].
        lens: class of table 2.
        model: the person.
        known: values given; they narrow the search.
        boxes_only: heads and feet are but the middles of the boxes' edges.
        """
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
        # (n, 8) rows in an image turned clockwise about its centre; boxes keep their size, which small turns
        # allow.
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
        if self.boxes_only:
            usual = usual_focal_px(self.lens, width)
            low_focal, high_focal = max(low_focal, 0.5 * usual), 2.0 * usual
        focal = self.known.focal(width, self.k)
        if focal is not None:
            low_focal, high_focal = focal / KNOWN_RANGE, focal * KNOWN_RANGE
        high_height = self.model.height_m + high_focal * size / float(diagonal.max())
        low_height, high_height = self.model.height_m * 1.15, min(high_height, params.max_distance_m)
        if self.known.height_m is not None:
            low_height, high_height = self.known.height_m / KNOWN_RANGE, self.known.height_m * KNOWN_RANGE
        low = np.array([math.log(low_focal), math.log(low_height), low_tilt])
        high = np.array([math.log(high_focal), math.log(max(high_height, low_height * 1.01)), high_tilt])
        return low, high


def search(problem: SearchProblem, params: HumanCalibrationParams) -> tuple[F64, F64]:
    """The last (m, 3) candidates kept and their errors, best first."""
    low, high = problem.bounds(params)
    counts = (params.coarse_focals, params.coarse_heights, params.coarse_tilts)
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    candidates = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    step = (high - low) / (np.array(counts) - 1)
    around = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    limit = INFEASIBLE
    for step_number in range(params.steps + 1):
        n_kept = max(params.beam >> step_number, 20)
        errors = problem.errors(candidates, limit) if step_number else _first_errors(problem, candidates, n_kept)
        best = np.argsort(errors, kind="stable")[:n_kept]
        kept, limit = candidates[best], float(errors[best[-1]])
        step = step / 2
        candidates = np.unique((kept[:, None] + step * around).reshape(-1, 3), axis=0)
        candidates = np.clip(candidates, low, high)
    return kept, errors[best]


def _first_errors(problem: SearchProblem, candidates: F64, n_kept: int) -> F64:
    """(m,) errors of the first cells, in parts that are spread over all of them.

    The ``n_kept`` best so far are a limit for the next part: beyond it no cell is kept, and need not be computed.
    """
    errors, limit = np.full(len(candidates), np.inf), INFEASIBLE
    for part in range(PARTS):
        errors[part::PARTS] = problem.errors(candidates[part::PARTS], limit)
        known = errors[np.isfinite(errors)]
        if len(known) >= n_kept:
            limit = min(limit, float(np.partition(known, n_kept - 1)[n_kept - 1]))
    return errors


def warm_up() -> None:
    """Have the kernel compiled, so that durations are the search's own."""
    flat, marked = np.zeros((1, 4)), np.array([[-1.0, -1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]])
    candidate_errors(np.array([[1.0, 3.0, 0.0]]), 0.0, flat, marked, np.zeros((1, 3)), 1.7, 1.0, np.empty(1))
