"""How well a camera is found from standing people: cameras of known truth, and PETS against its Tsai calibration."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.rows import Row
from calib.errors import WorkError
from calib.formats.tsai import TsaiCamera, load_tsai
from calib.ground_camera import GroundCamera
from calib.people.calibration import calibrate_from_people
from calib.people.model import HumanModel
from calib.people.samples import HumanSample, choose_spread
from calib.types import F64
from planview.synthetic.assets import real_recordings

Reading = Literal["marked", "middles"]
"""Heads and feet are clicked where they are, or at the middles of the boxes' edges."""
CAMERAS = {
    "overhead": GroundCamera(640, 480, 400.0, 3.5, math.radians(5), "normal"),
    "oblique": GroundCamera(640, 480, 500.0, 4.0, math.radians(45), "normal-wide"),
    "near-horizontal": GroundCamera(640, 480, 600.0, 4.0, math.radians(68), "normal"),
}
SAMPLES, SEEDS, NOISE_PX = 8, 10, 2.0
LIMITS = {"height": 5.0, "tilt": 2.0, "focal": 6.0}
SEARCH_LIMIT_S = 2.0
PETS_PEOPLE, PETS_LIMIT_M = 12, 0.5
READINGS: tuple[Reading, ...] = ("marked", "middles")
PETS_SIZE, TSAI_SIZE = (480, 360), (768, 576)


def measure(progress: Callable[[str], None] = lambda _: None) -> tuple[Row, ...]:
    """Errors over seeds for several cameras, with 2 px of noise on every point and edge; then PETS, where it is."""
    rows: list[Row] = []
    for name, truth in CAMERAS.items():
        progress(f"people, {name} camera")
        rows += _rendered(name, truth)
    pets = real_recordings() / "pets09-s2l1-view001"
    if pets.is_dir():
        progress("people, PETS view 1")
        for reading in READINGS:
            progress(f"people, PETS view 1, {reading}")
            rows += _scripted_rows(reading, [scripted_clicks(pets, reading, seed) for seed in range(SEEDS)])
    return tuple(rows)


def _rendered(name: str, truth: GroundCamera) -> list[Row]:
    found = [
        calibrate_from_people(noisy_people(truth, SAMPLES, seed, NOISE_PX), truth.size, truth.lens)
        for seed in range(SEEDS)
    ]
    errors = {
        "height": [100 * abs(f.camera.height_m / truth.height_m - 1) for f in found],
        "tilt": [math.degrees(abs(f.camera.tilt_rad - truth.tilt_rad)) for f in found],
        "focal": [100 * abs(f.camera.focal_px / truth.focal_px - 1) for f in found],
    }
    rows = []
    for key, values in errors.items():
        unit, limit, worst = "deg" if key == "tilt" else "%", LIMITS[key], max(values)
        rows.append(Row(f"people, {name}: {key}, median of {SEEDS}", float(np.median(values)), unit, math.nan, True))
        rows.append(Row(f"people, {name}: {key}, worst of {SEEDS}", worst, unit, limit, worst <= limit))
    slowest = max(f.search_s for f in found)
    return [*rows, Row(f"people, {name}: search", slowest, "s", SEARCH_LIMIT_S, slowest <= SEARCH_LIMIT_S)]


def noisy_people(camera: GroundCamera, count: int, seed: int, noise_px: float) -> list[HumanSample]:
    """People of the model's size in different areas of the image, every edge and point off by Gaussian noise."""
    rng, model = np.random.default_rng(seed), HumanModel()
    feet = camera.back_project(rng.uniform((0, 0), (camera.width, camera.height), (1500, 2)))
    feet = feet[np.isfinite(feet).all(axis=1) & (np.hypot(feet[:, 0], feet[:, 1]) < 25.0)]
    boxes = model.boxes(camera, feet)
    whole = (boxes[:, :2] > 0).all(axis=1) & (boxes[:, :2] + boxes[:, 2:] < np.array(camera.size)).all(axis=1)
    feet = feet[whole & (boxes[:, 3] > 40.0)]
    samples = []
    for xy in feet:
        left, top, width, height = model.boxes(camera, xy)
        ends = np.array([left, top, left + width, top + height, *model.head(camera, xy), *model.foot(camera, xy)])
        samples.append(_sample(ends + rng.normal(0.0, noise_px, 8)))
    return list(choose_spread(samples, count))


@dataclass(frozen=True)
class ClickResult:
    """What a scripted person's clicks gave.

    Attributes:
        error_m: median distance of floor positions from the Tsai camera's, after a rigid alignment, over all annotated
            people; NaN where the clicks were refused.
        stated_m: floor error stated by the verdict; enough: the verdict.
    """

    error_m: float
    stated_m: float
    enough: bool


def scripted_clicks(folder: Path, reading: Reading, seed: int, lens: str | None = "pinhole") -> ClickResult:
    """Camera from 12 people of PETS at random, every edge and point clicked with 2 px of noise.

    Args:
        folder: of PETS view 1.
        reading: heads and feet where the Tsai camera shows a person of 1.76 m, or at the middles of the boxes' edges.
        seed: of the people and the noise.
        lens: class of table 2, None to try all.
    """
    table, tsai = np.loadtxt(folder / "gt.txt", delimiter=","), load_tsai(folder / "View_001.xml")
    rng = np.random.default_rng(seed)
    rows = np.stack([_ends(row, tsai, reading) for row in table[rng.choice(_alone(table), PETS_PEOPLE, replace=False)]])
    samples = [_sample(row) for row in rows + rng.normal(0.0, NOISE_PX, rows.shape)]
    try:
        found = calibrate_from_people(samples, PETS_SIZE, lens)
    except WorkError:
        return ClickResult(math.nan, math.nan, enough=False)
    verdict = found.assessment
    return ClickResult(floor_error_m(folder, found.camera), verdict.floor_error_m, verdict.enough)


def _scripted_rows(reading: Reading, results: Sequence[ClickResult]) -> list[Row]:
    name = f"people, PETS view 1, 12 scripted clicks, {reading}"
    errors = np.array([r.error_m for r in results])
    median = float(np.nanmedian(errors)) if np.isfinite(errors).any() else math.nan
    trusted = [r.error_m for r in results if r.enough]
    worst = max(trusted, default=math.nan)
    return [
        Row(f"{name}: median floor error", median, "m", PETS_LIMIT_M, not median > PETS_LIMIT_M),
        Row(f"{name}: worst of those called enough", worst, "m", 2 * PETS_LIMIT_M, not worst > 2 * PETS_LIMIT_M),
        Row(f"{name}: called enough, of {len(results)}", len(trusted), "", math.nan, True),
    ]


def floor_error_m(folder: Path, camera: GroundCamera) -> float:
    """Median distance of floor positions from the Tsai camera's, rigidly aligned, over all annotated people."""
    table = np.loadtxt(folder / "gt.txt", delimiter=",")
    feet = np.column_stack([table[:, 2] + table[:, 4] / 2, table[:, 3] + table[:, 5]])
    truth = load_tsai(folder / "View_001.xml").back_project(_tsai_px(feet))
    ours = camera.back_project(feet)
    known = np.isfinite(ours).all(axis=1) & np.isfinite(truth).all(axis=1)
    return float(np.median(_aligned_errors(ours[known], truth[known])))


def _tsai_px(pixels: F64) -> F64:
    return np.asarray((pixels + 0.5) * (TSAI_SIZE[0] / PETS_SIZE[0]) - 0.5)


def _ends(row: F64, tsai: TsaiCamera, reading: Reading) -> F64:
    """(8,) left, top, right, bottom, head u, v, foot u, v of an annotated person."""
    left, top, width, height, x_m, y_m = row[[2, 3, 4, 5, 7, 8]]
    box = np.array([left, top, left + width, top + height])
    if reading == "middles":
        middle = left + width / 2
        return np.append(box, [middle, top, middle, top + height])
    ends = tsai.project(np.array([[x_m, y_m, HumanModel().height_m], [x_m, y_m, 0.0]]))
    return np.append(box, (ends + 0.5) * (PETS_SIZE[0] / TSAI_SIZE[0]) - 0.5)


def _sample(row: F64) -> HumanSample:
    left, top, right, bottom, head_u, head_v, foot_u, foot_v = (float(v) for v in row)
    return HumanSample((left, top, right - left, bottom - top), (head_u, head_v), (foot_u, foot_v))


def _alone(table: F64) -> F64:
    """(k,) rows whose box touches neither the edge nor another box of its frame."""
    low, high = table[:, 2:4], table[:, 2:4] + table[:, 4:6]
    inside = (low > 2).all(axis=1) & (high < np.array(PETS_SIZE) - 2).all(axis=1)
    kept = []
    for i in np.flatnonzero(inside):
        others = np.flatnonzero((table[:, 0] == table[i, 0]) & (np.arange(len(table)) != i))
        touches = ((low[others] < high[i]) & (high[others] > low[i])).all(axis=1)
        if not touches.any():
            kept.append(i)
    return np.array(kept, dtype=np.int64)


def _aligned_errors(ours: F64, truth: F64) -> F64:
    """(n,) distances after the rotation and shift that fit best without the farthest tenth."""
    used = np.ones(len(ours), dtype=np.bool_)
    errors = np.zeros(len(ours))
    for _ in range(5):
        a, b = ours[used].mean(axis=0), truth[used].mean(axis=0)
        u, _, vt = np.linalg.svd((ours[used] - a).T @ (truth[used] - b))
        turn = vt.T @ np.diag([1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
        errors = np.hypot(*((ours - a) @ turn.T + b - truth).T)
        used = errors <= np.quantile(errors, 0.9)
    return errors
