"""Calibration from people, and the alignment of two rigs by people, against known truth."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.members import draw_member, rig_scenes
from benchmarks.options import Report, Row, benchmark, figure, progress, tables
from calib.errors import WorkError
from calib.ground_camera import GroundCamera
from calib.io import load_toml
from calib.people.calibration import HumanCalibration, calibrate_from_people
from calib.people.model import HumanModel
from calib.people.samples import HumanSample, choose_spread
from calib.pose import SE3
from calib.types import F64
from calib.world import RIGS_FILE, RigEntry, load_rigs
from planview.calibration.align import align_records, record_rig, rig_entries
from planview.calibration.people import collect_samples
from planview.engine.config import Config
from planview.synthetic.assets import SCENES
from planview.synthetic.camera import ground_camera
from planview.synthetic.render import SceneRenderer
from planview.synthetic.scene import Scene
from planview.synthetic.write import write_recording, write_rigs
from stereo.readers import open_video

Family = Literal["human", "walkers", "rigs"]
CAMERAS = {
    "overhead": GroundCamera(640, 480, 400.0, 3.5, math.radians(5), "normal"),
    "oblique": GroundCamera(640, 480, 500.0, 4.0, math.radians(45), "normal-wide"),
    "near-horizontal": GroundCamera(640, 480, 600.0, 4.0, math.radians(68), "normal"),
}
PEOPLE_SEEDS = 10
PLACES = 1500
"""Places on the floor from which people are chosen."""
FAR_M = 25.0
LOW_PX = 40.0
"""Nobody is farther away, or lower in the image."""
CLICK_NOISE_PX = 2.0
"""Standard deviation of every marked point and edge."""
PEOPLE_LIMITS = {"height": ("%", 5.0), "tilt": ("deg", 2.0), "focal": ("%", 6.0)}
SEARCH_LIMIT_S = 2.0
WALKED = ("door_oblique", "station", "corridor")
WALKED_SEEDS = (1201, 1202)
"""Scenes of one camera in which people walk by, and what decides their cameras and people."""
RIG_SEEDS = (101, 102, 103)
RIG_LIMITS = {"place": ("cm", 5.0), "heading": ("deg", 0.5), "clock": ("ms", 30.0)}


@benchmark
def calibration(*, only: Family | None = None) -> Report:
    """Score calibration from people, and the alignment of rigs, against known truth.

    Example: python -m benchmarks calibration --only human

    Args:
        only: One family: human (people who are marked), walkers (as --auto takes them) or rigs.
    """
    families: dict[Family, Callable[[], list[Row]]] = {"human": human_rows, "walkers": walker_rows, "rigs": rig_rows}
    rows: list[Row] = []
    for name, score in families.items():
        if only in (None, name):
            rows += score()
    return tables(rows=rows)


def human_rows() -> list[Row]:
    """Errors over seeds for several cameras, with noise on every point and edge."""
    rows = []
    for name, camera in CAMERAS.items():
        progress(f"people, {name} camera")
        results = []
        search_s = 0.0
        for seed in range(PEOPLE_SEEDS):
            people = noisy_people(camera, seed)
            start_s = time.perf_counter()
            results.append(calibrate_from_people(people, camera.size, camera.lens))
            search_s = max(search_s, time.perf_counter() - start_s)
        errors = [camera_errors(result, camera) for result in results]
        for key, (unit, limit) in PEOPLE_LIMITS.items():
            scale = math.degrees(1.0) if unit == "deg" else 100.0
            sizes = [scale * abs(error[key]) for error in errors]
            rows.append(figure(f"people, {name}: {key}, median of {PEOPLE_SEEDS}", float(np.median(sizes)), unit))
            rows.append(figure(f"people, {name}: {key}, worst of {PEOPLE_SEEDS}", max(sizes), unit, limit))
        for key in PEOPLE_LIMITS:
            ratios = [over_deviations(result, camera)[key] for result in results]
            rows.append(figure(f"people, {name}: errors over deviations, {key}, rms", _rms(ratios), "1"))
        rows.append(figure(f"people, {name}: search", search_s, "s", SEARCH_LIMIT_S))
    return rows


def camera_errors(result: HumanCalibration, truth: GroundCamera) -> dict[str, float]:
    """Errors of a camera: relative of height and focal length, and of the tilt [rad]."""
    camera = result.camera
    return {
        "height": camera.height_m / truth.height_m - 1,
        "tilt": camera.tilt_rad - truth.tilt_rad,
        "focal": camera.focal_px / truth.focal_px - 1,
    }


def over_deviations(result: HumanCalibration, truth: GroundCamera) -> dict[str, float]:
    """Errors of a camera over the deviations that are given."""
    errors = camera_errors(result, truth)
    std = result.std
    return {
        "height": errors["height"] / std.height,
        "tilt": math.degrees(errors["tilt"]) / std.tilt_deg,
        "focal": errors["focal"] / std.focal,
    }


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


def noisy_people(camera: GroundCamera, seed: int) -> list[HumanSample]:
    """People of the model's size in different areas of the image, every edge and point off by Gaussian noise."""
    rng = np.random.default_rng(seed)
    model = HumanModel()
    feet = camera.back_project(rng.uniform((0, 0), (camera.width, camera.height), (PLACES, 2)))
    feet = feet[np.isfinite(feet).all(axis=1) & (np.hypot(feet[:, 0], feet[:, 1]) < FAR_M)]
    boxes = model.boxes(camera, feet)
    is_whole = (boxes[:, :2] > 0).all(axis=1) & (boxes[:, :2] + boxes[:, 2:] < np.array(camera.size)).all(axis=1)
    samples = []
    for foot in feet[is_whole & (boxes[:, 3] > LOW_PX)]:
        left, top, width, height = model.boxes(camera, foot)
        edges = np.array([left, top, left + width, top + height])
        marked = np.concatenate([edges, model.head(camera, foot), model.foot(camera, foot)])
        left, top, right, bottom, head_x, head_y, foot_x, foot_y = map(
            float, marked + rng.normal(0.0, CLICK_NOISE_PX, 8)
        )
        samples.append(HumanSample((left, top, right - left, bottom - top), (head_x, head_y), (foot_x, foot_y)))
    return list(choose_spread(samples, 8))


def walked_scene(name: str, seed: int) -> Scene:
    """A committed scene of one camera with another camera and other people."""
    table = load_toml(SCENES / "single" / f"{name}.toml", "a scene")
    rng = np.random.default_rng(seed)
    camera = table["camera"]
    x_m, y_m, height_m = camera["at_m"]
    ceiling_m = table["room"]["size_m"][2]
    height_m = min(height_m * math.exp(rng.uniform(-0.15, 0.12)), ceiling_m - 0.1)
    camera["at_m"] = [x_m, y_m, height_m]
    camera["tilt_deg"] += rng.uniform(-5, 5)
    camera["focal_px"] *= math.exp(rng.uniform(-0.15, 0.15))
    for person in table["people"]:
        person["height_m"] = float(np.clip(rng.normal(1.72, 0.09), 1.5, 1.95))
    return Scene.model_validate(table | {"seed": int(rng.integers(1 << 30)), "fps": 10})


def walker_rows() -> list[Row]:
    """Errors over the deviations that are given of cameras from people who walk by."""
    ratios: dict[str, list[float]] = {"floor positions": [], "height": [], "tilt": [], "focal": []}
    for name in WALKED:
        for seed in WALKED_SEEDS:
            progress(f"people who walk by, {name} {seed}")
            try:
                some = walker_ratios(walked_scene(name, seed))
            except WorkError as error:
                progress(f"refused: {error}")
                continue
            for key, value in some.items():
                ratios[key].append(value)
    count = len(ratios["tilt"])
    return [
        figure(f"{count} cameras from walkers: errors over deviations, {key}, rms", _rms(values), "1")
        for key, values in ratios.items()
    ]


def walker_ratios(scene: Scene) -> dict[str, float]:
    """Render a scene and calibrate its camera from the people who walk by: errors over deviations.

    Raises WorkError: the calibration is refused.
    """
    assert scene.camera is not None
    truth = ground_camera(scene.camera)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "scene"
        write_recording(SceneRenderer(scene), folder, storage="jpg")
        samples, independent = collect_samples(open_video(folder))
    result = calibrate_from_people(samples, truth.size, independent=independent)
    feet = np.array([sample.foot_px for sample in samples])
    first, second = np.triu_indices(len(feet))
    places = floor_error(result.camera, truth, 0.5 * (feet[first] + feet[second]))
    return {"floor positions": places / result.std.from_camera, **over_deviations(result, truth)}


def floor_error(found: GroundCamera, true: GroundCamera, pixels: F64) -> float:
    """Distance of floor positions from the true ones over that from the camera [1], the median over (n, 2) pixels."""
    true_m = true.back_project(pixels)
    off_m = found.back_project(pixels) - true_m
    return math.sqrt(float(np.nanmedian((off_m**2).sum(axis=1) / (true_m**2).sum(axis=1))))


def rig_rows() -> list[Row]:
    """Errors of two rigs in one room, whose clocks begin apart: aligned by the people whom both track."""
    table = load_toml(SCENES / "rigs" / "two.toml", "a scene in TOML")
    rows = []
    for seed in RIG_SEEDS:
        progress(f"two rigs, seed {seed}")
        errors = dict.fromkeys(RIG_LIMITS, math.inf)
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "rigs"
            folder.mkdir()
            write_rigs(rig_scenes(draw_member(table, seed, "two")), folder, storage="jpg")
            true = load_rigs(folder / RIGS_FILE)
            try:
                records = [record_rig(folder / entry.folder, Config()) for entry in true]
                errors = alignment_errors(rig_entries(records, align_records(records), folder), true)
            except WorkError as error:
                progress(f"refused: {error}")
        for key, (unit, limit) in RIG_LIMITS.items():
            rows.append(figure(f"rigs, seed {seed}: {key}", errors[key], unit, limit))
    return rows


def alignment_errors(found: Sequence[RigEntry], true: Sequence[RigEntry]) -> dict[str, float]:
    """Errors of the second rig relative to the first: place [cm], heading [deg] and clock [ms]."""
    pose = found[1].world_SE3_left
    true_pose = true[1].world_SE3_left
    place_m = np.hypot(*(pose.translation - true_pose.translation)[:2])
    heading_rad = math.remainder(_heading_rad(pose) - _heading_rad(true_pose), 2 * math.pi)
    clock_s = found[1].start_s - true[1].start_s
    return {
        "place": 100 * float(place_m),
        "heading": abs(math.degrees(heading_rad)),
        "clock": 1000 * abs(clock_s),
    }


def _heading_rad(pose: SE3) -> float:
    return math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])
