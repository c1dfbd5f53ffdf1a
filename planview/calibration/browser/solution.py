"""What is solved, and what came out of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import InputError, WorkError
from calib.ground_camera import save_ground_camera
from calib.io import reason
from calib.people.calibration import HumanCalibration, calibrate_from_people
from calib.people.model import KnownValues
from calib.people.samples import MIN_SAMPLES, HumanSample, write_samples
from calib.rig import Floor
from calib.world import save_world
from planview.calibration.browser.floor_fit import FloorFit, fit_floor
from planview.calibration.browser.marks import Point
from planview.calibration.browser.verdict import ValueRow, Verdict, camera_rows, floor_rows, floor_verdict
from planview.calibration.floor import FloorView


@dataclass(frozen=True, eq=False)
class Task:
    """Everything that a solution depends on (see ``CalibrationSession``)."""

    name: str
    size: tuple[int, int]
    samples: tuple[HumanSample, ...]
    lens: str | None
    known: KnownValues
    floor_points: tuple[Point, ...]
    view: FloorView | None


@dataclass(frozen=True, eq=False)
class Solution:
    """A camera, or the floor of a stereo recording.

    Attributes:
        found: camera from the samples (one camera).
        fit: floor from the points (stereo).
        problem: why there is no solution, empty where there is one or nothing was solved.
    """

    found: HumanCalibration | None = None
    fit: FloorFit | None = None
    problem: str = ""

    def rows(self, plain_floor: Floor | None = None) -> list[ValueRow]:
        """Values with their deviations; empty without a solution.

        Args:
            plain_floor: found without points, to compare with.
        """
        if self.found is not None:
            return camera_rows(self.found)
        return floor_rows(self.fit, plain_floor) if self.fit else []

    def verdict(self) -> Verdict | None:
        """Whether it is enough; None where nothing was solved."""
        if self.problem:
            return Verdict(False, self.problem)
        if self.found is not None:
            return Verdict(self.found.assessment.enough, self.found.assessment.sentence)
        return floor_verdict(self.fit) if self.fit else None

    def metres(self, pixels: Sequence[Point]) -> list[Point | None]:
        """World (x, y) of pixels on the floor of the camera found, None where they are not on the floor."""
        if self.found is None:
            return [None] * len(pixels)
        xy = self.found.camera.back_project(np.array(pixels).reshape(-1, 2))
        return [(float(x), float(y)) if math.isfinite(x) and math.isfinite(y) else None for x, y in xy]


def solve(task: Task) -> Solution:
    """The camera or the floor of what is drawn so far; takes up to seconds."""
    try:
        if task.view is not None:
            return Solution(fit=fit_floor(task.view, task.floor_points)) if len(task.floor_points) >= 3 else Solution()
        if len(task.samples) < MIN_SAMPLES:
            return Solution()
        return Solution(calibrate_from_people(task.samples, task.size, task.lens, known=task.known, name=task.name))
    except (InputError, WorkError) as error:
        return Solution(problem=str(error))


def export(folder: Path, task: Task, solution: Solution) -> tuple[Path, ...]:
    """Write samples.json, and camera.toml or world.toml as far as there is a solution.

    Raises:
        InputError: nothing to write yet, or nowhere to write it.
    """
    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if task.samples:
            written.append(folder / "samples.json")
            write_samples(task.samples, written[-1], task.size)
        if solution.found is not None:
            written.append(folder / "camera.toml")
            save_ground_camera(solution.found.camera, written[-1])
        if solution.fit is not None:
            written.append(folder / "world.toml")
            save_world(solution.fit.floor, written[-1])
    except OSError as error:
        raise InputError(f"{folder}: expected a folder to write to, found {reason(error)}") from error
    if not written:
        raise InputError(f"{task.name}: expected something drawn before it is exported, found nothing")
    return tuple(written)
