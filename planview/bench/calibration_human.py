"""How well a camera is found from standing people: cameras of known truth, and PETS against its Tsai calibration."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib.formats.tsai import load_tsai
from calib.ground_camera import GroundCamera
from calib.human.calibration import calibrate_from_people
from calib.human.choice import choose_spread
from calib.human.model import HumanModel
from calib.human.samples import HumanSample
from calib.types import F64
from planview.bench.rows import Row
from planview.synthetic.committed import real_recordings

CAMERAS = {
    "overhead": GroundCamera(640, 480, 400.0, 3.5, math.radians(5), "normal"),
    "oblique": GroundCamera(640, 480, 500.0, 4.0, math.radians(45), "normal-wide"),
    "near-horizontal": GroundCamera(640, 480, 600.0, 4.0, math.radians(68), "normal"),
}
SAMPLES, SEEDS, NOISE_PX = 8, 10, 2.0
LIMITS = {"height": 5.0, "tilt": 2.0, "focal": 6.0}
SEARCH_LIMIT_S = 2.0
PETS_PEOPLE, PETS_LIMIT_M = 12, 0.6
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
        for lens in ("pinhole", "normal", None):
            error = pets_error_m(pets, lens)
            name = f"people, PETS view 1, lens {lens or 'tried'}: median floor error"
            rows.append(Row(name, error, "m", PETS_LIMIT_M, error <= PETS_LIMIT_M))
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
        a, b, c, d, *points = (float(v) for v in ends + rng.normal(0.0, noise_px, 8))
        samples.append(HumanSample((a, b, c - a, d - b), (points[0], points[1]), (points[2], points[3])))
    return list(choose_spread(samples, count))


def pets_error_m(folder: Path, lens: str | None) -> float:
    """Median distance of floor positions from the Tsai camera's, after a rigid alignment, over all annotated people.

    The people are chosen by a rule: boxes that touch neither the image's edge nor another box, then ``choose_spread``.
    An annotator's box is no hull: head and foot are taken as the middles of its upper and lower edge.
    """
    table = np.loadtxt(folder / "gt.txt", delimiter=",")
    people = choose_spread([_boxed(row) for row in table[_alone(table)]], PETS_PEOPLE)
    camera = calibrate_from_people(people, PETS_SIZE, lens).camera
    feet = np.column_stack([table[:, 2] + table[:, 4] / 2, table[:, 3] + table[:, 5]])
    scale = TSAI_SIZE[0] / PETS_SIZE[0]
    truth = load_tsai(folder / "View_001.xml").back_project((feet + 0.5) * scale - 0.5)
    ours = camera.back_project(feet)
    known = np.isfinite(ours).all(axis=1) & np.isfinite(truth).all(axis=1)
    return float(np.median(_aligned_errors(ours[known], truth[known])))


def _boxed(row: F64) -> HumanSample:
    left, top, width, height = (float(v) for v in row[2:6])
    middle = left + width / 2
    return HumanSample((left, top, width, height), (middle, top), (middle, top + height), int(row[0]) - 1)


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
