"""Board, floor and human calibration, and the alignment of two rigs by people, against known truth."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.floors import deviation_rows, floor_rows
from benchmarks.options import JsonFlag, Row, figure, progress, report
from benchmarks.random_scenes.generator import random_scene
from calib.board.detect import Board, BoardView
from calib.board.solve import solve_board
from calib.camera import Camera, LensModel
from calib.errors import WorkError
from calib.ground_camera import GroundCamera
from calib.io import load_toml
from calib.people.calibration import calibrate_from_people
from calib.people.model import HumanModel
from calib.people.samples import HumanSample, choose_spread
from calib.pose import SE3
from calib.rig import StereoRig
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

Family = Literal["board", "floor", "human", "walkers", "rigs", "deviations"]
BOARD_SIZE = 1280, 800
LENSES: dict[str, tuple[float, LensModel, tuple[float, ...]]] = {
    "plain": (900.0, "brown", ()),
    "brown": (900.0, "brown", (-0.3, 0.1, 5e-4, -3e-4)),
    "tele": (2000.0, "brown", (-0.1, 0.05, 0.0, 0.0)),
    "fisheye": (420.0, "fisheye", (0.05, -0.02, 0.005, -0.001)),
    "rational": (600.0, "rational", (0.3, 0.05, 2e-4, -1e-4, 0.001, 0.65, 0.1, 0.01)),
}
"""Focal length [px], model and coefficients."""
CAMERAS = {
    "overhead": GroundCamera(640, 480, 400.0, 3.5, math.radians(5), "normal"),
    "oblique": GroundCamera(640, 480, 500.0, 4.0, math.radians(45), "normal-wide"),
    "near-horizontal": GroundCamera(640, 480, 600.0, 4.0, math.radians(68), "normal"),
}
PEOPLE_SEEDS, CLICK_NOISE_PX = 10, 2.0
PEOPLE_LIMITS = {"height": 5.0, "tilt": 2.0, "focal": 6.0}
RIG_LIMITS = {"place": ("cm", 5.0), "heading": ("deg", 0.5), "clock": ("ms", 30.0)}


def random_rig(lens: str, rng: np.random.Generator) -> StereoRig:
    """A rig such as is built: lenses (of LENSES) and mounts of one kind scatter by a per cent and a degree."""
    focal, model, coefficients = LENSES[lens]

    def camera() -> Camera:
        fx, fy = focal * (1 + 0.01 * rng.normal(size=2))
        cx, cy = np.array(BOARD_SIZE) / 2 + 8 * rng.normal(size=2)
        distortion = tuple(float(k * (1 + 0.02 * rng.normal())) for k in coefficients)
        return Camera(*BOARD_SIZE, float(fx), float(fy), float(cx), float(cy), model, distortion)

    shift = np.array([-rng.uniform(0.06, 0.25), 0.0, 0.0]) + 0.002 * rng.normal(size=3)
    return StereoRig(camera(), camera(), SE3.from_rotvec(0.02 * rng.normal(size=3), shift), f"random {lens} rig")


def board_views(rig: StereoRig, board: Board, n: int, noise_px: float, rng: np.random.Generator) -> list[BoardView]:
    """Pairs in which both images show the whole board, at places and tilts all over the left image.

    Args:
        noise_px: standard deviation of each corner coordinate.
    """
    points, extent = board.points, float(board.points.max())
    near = 1.5 * extent * rig.left.fx / rig.left.width
    ids = np.arange(len(points))
    views: list[BoardView] = []
    while len(views) < n:
        turn = SE3.from_rotvec(rng.normal(size=3) * [0.45, 0.45, 0.3])
        middle = rig.left.unproject([rng.uniform(0.12, 0.88, 2) * rig.left.size])[0] * rng.uniform(near, 2.5 * near)
        left_SE3_board = SE3(turn.rotation, middle - turn.rotation @ points.mean(axis=0))
        left = rig.left.project(left_SE3_board @ points)
        right = rig.right.project(rig.right_SE3_left @ (left_SE3_board @ points))
        if all(((p > 0) & (p < np.array(rig.left.size) - 1)).all() for p in (left, right)):
            noise = noise_px * rng.normal(size=(2, *left.shape))
            views.append(BoardView(f"view {len(views):02d}", ids, left + noise[0], right + noise[1]))
    return views


def calibration_errors(truth: StereoRig, found: StereoRig) -> tuple[float, float, float]:
    """Worst focal length error [%], baseline error [%] and rotation error [deg]."""
    (left, right), (true_left, true_right) = ((rig.left, rig.right) for rig in (found, truth))
    ratios = (left.fx / true_left.fx, left.fy / true_left.fy, right.fx / true_right.fx, right.fy / true_right.fy)
    baseline = abs(found.baseline_m / truth.baseline_m - 1)
    turn = (found.right_SE3_left @ truth.right_SE3_left.inverse()).rotvec
    focal = max(abs(ratio - 1) for ratio in ratios)
    return 100 * focal, 100 * baseline, math.degrees(float(np.linalg.norm(turn)))


def board_rows() -> list[Row]:
    """Worst errors over the random rigs of every lens."""
    rows, board, n_rigs = [], Board(9, 6, 0.03), 3
    for lens in LENSES:
        progress(f"boards, {lens} lens")
        errors = []
        for seed in range(n_rigs):
            rng = np.random.default_rng(seed)
            truth = random_rig(lens, rng)
            views = board_views(truth, board, n=30, noise_px=0.2, rng=rng)
            errors.append(calibration_errors(truth, solve_board(views, board, truth.left.size).rig))
        # The principal point, and with it the direction of the optical axis, is open the more the longer the lens.
        turn = 0.075 if lens == "tele" else 0.05
        limits = ("focal length", "%", 0.2), ("baseline", "%", 0.3), ("rotation", "deg", turn)
        for (what, unit, limit), worst in zip(limits, np.max(errors, axis=0).tolist(), strict=True):
            rows.append(figure(f"boards, {lens} lens, worst of {n_rigs} rigs: {what}", worst, unit, limit))
    return rows


def human_rows() -> list[Row]:
    """Errors over seeds for several cameras, with noise on every point and edge."""
    rows = []
    for name, truth in CAMERAS.items():
        progress(f"people, {name} camera")
        found = [
            calibrate_from_people(noisy_people(truth, seed), truth.size, truth.lens) for seed in range(PEOPLE_SEEDS)
        ]
        errors = {
            "height": [100 * abs(f.camera.height_m / truth.height_m - 1) for f in found],
            "tilt": [math.degrees(abs(f.camera.tilt_rad - truth.tilt_rad)) for f in found],
            "focal": [100 * abs(f.camera.focal_px / truth.focal_px - 1) for f in found],
        }
        for key, values in errors.items():
            unit, what = "deg" if key == "tilt" else "%", f"people, {name}: {key}"
            rows.append(figure(f"{what}, median of {PEOPLE_SEEDS}", float(np.median(values)), unit))
            rows.append(figure(f"{what}, worst of {PEOPLE_SEEDS}", max(values), unit, PEOPLE_LIMITS[key]))
        wide = {
            "height": [(f.camera.height_m / truth.height_m - 1) / f.std.height for f in found],
            "tilt": [(f.camera.tilt_rad - truth.tilt_rad) / f.std.tilt_rad for f in found],
            "focal": [(f.camera.focal_px / truth.focal_px - 1) / f.std.focal for f in found],
        }
        for key, values in wide.items():
            rms = math.sqrt(float(np.mean(np.square(values))))
            rows.append(figure(f"people, {name}: errors over deviations, {key}, rms", rms, "1"))
        rows.append(figure(f"people, {name}: search", max(f.search_s for f in found), "s", 2.0))
    return rows


def noisy_people(camera: GroundCamera, seed: int) -> list[HumanSample]:
    """People of the model's size in different areas of the image, every edge and point off by Gaussian noise."""
    rng, model = np.random.default_rng(seed), HumanModel()
    feet = camera.back_project(rng.uniform((0, 0), (camera.width, camera.height), (1500, 2)))
    feet = feet[np.isfinite(feet).all(axis=1) & (np.hypot(feet[:, 0], feet[:, 1]) < 25.0)]
    boxes = model.boxes(camera, feet)
    whole = (boxes[:, :2] > 0).all(axis=1) & (boxes[:, :2] + boxes[:, 2:] < np.array(camera.size)).all(axis=1)
    samples = []
    for xy in feet[whole & (boxes[:, 3] > 40.0)]:
        left, top, width, height = model.boxes(camera, xy)
        ends = np.array([left, top, left + width, top + height, *model.head(camera, xy), *model.foot(camera, xy)])
        left, top, right, bottom, *points = (float(v) for v in ends + rng.normal(0.0, CLICK_NOISE_PX, 8))
        box = left, top, right - left, bottom - top
        samples.append(HumanSample(box, (points[0], points[1]), (points[2], points[3])))
    return list(choose_spread(samples, 8))


WALKED, WALKED_SEEDS = ("door_oblique", "station", "corridor"), (1201, 1202)
"""Scenes of one camera in which people walk by, and what decides their cameras and people."""


def walked_scene(name: str, seed: int) -> Scene:
    """A committed scene of one camera with another camera and other people."""
    table, rng = load_toml(SCENES / "single" / f"{name}.toml", "a scene"), np.random.default_rng(seed)
    camera, ceiling_m = table["camera"], table["room"]["size_m"][2]
    height_m = min(camera["at_m"][2] * math.exp(rng.uniform(-0.15, 0.12)), ceiling_m - 0.1)
    camera |= {
        "tilt_deg": camera["tilt_deg"] + rng.uniform(-5, 5),
        "focal_px": camera["focal_px"] * math.exp(rng.uniform(-0.15, 0.15)),
        "at_m": [*camera["at_m"][:2], height_m],
    }
    for person in table["people"]:
        person["height_m"] = float(np.clip(rng.normal(1.72, 0.09), 1.5, 1.95))
    return Scene.model_validate(table | {"seed": int(rng.integers(1 << 30)), "fps": 10})


def floor_error_m(found: GroundCamera, true: GroundCamera, pixels: F64) -> float:
    """Distance of floor positions from the true ones [m], the median over (n, 2) pixels, after the best shift and turn
    of the floor."""
    a, b = found.back_project(pixels), true.back_project(pixels)
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    a, b = (part[known] - part[known].mean(axis=0) for part in (a, b))
    x, y = (a * b).sum(), (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    turn = np.array([[x, -y], [y, x]]) / np.hypot(x, y)
    return float(np.sqrt(np.median(((a @ turn.T - b) ** 2).sum(axis=1))))


def walker_rows() -> list[Row]:
    """Errors over the deviations that are given of cameras from people who walk by."""
    off: dict[str, list[float]] = {"floor positions": [], "height": [], "tilt": [], "focal": []}
    for name, seed in product(WALKED, WALKED_SEEDS):
        progress(f"people who walk by, {name} {seed}")
        scene = walked_scene(name, seed)
        assert scene.camera is not None
        true = ground_camera(scene.camera)
        with tempfile.TemporaryDirectory() as place:
            write_recording(SceneRenderer(scene), Path(place) / name, storage="jpg")
            try:
                samples, independent = collect_samples(open_video(Path(place) / name))
                found = calibrate_from_people(samples, true.size, independent=independent)
            except WorkError as error:
                progress(f"refused: {error}")
                continue
        feet = np.array([sample.foot_px for sample in samples])
        first, second = np.triu_indices(len(feet))
        error_m = floor_error_m(found.camera, true, 0.5 * (feet[first] + feet[second]))
        off["floor positions"].append(error_m / found.assessment.floor_error_m)
        off["height"].append((found.camera.height_m / true.height_m - 1) / found.std.height)
        off["tilt"].append((found.camera.tilt_rad - true.tilt_rad) / found.std.tilt_rad)
        off["focal"].append((found.camera.focal_px / true.focal_px - 1) / found.std.focal)
    rms = {what: float(np.sqrt(np.mean(np.square(values)))) for what, values in off.items()}
    count = len(off["tilt"])
    return [figure(f"{count} cameras from walkers: errors over deviations, {k}, rms", v, "1") for k, v in rms.items()]


def rig_rows() -> list[Row]:
    """Two rigs in one random room, whose clocks begin apart: aligned by the people whom both track."""
    rows = []
    for seed in (101, 102, 103):
        progress(f"two rigs, seed {seed}")
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "rigs"
            folder.mkdir()
            write_rigs(random_scene("rigs", seed).rigs, folder, storage="jpg")
            true = load_rigs(folder / RIGS_FILE)
            try:
                records = [record_rig(folder / entry.folder, Config()) for entry in true]
                errors = alignment_error(rig_entries(records, align_records(records), folder), true)
            except WorkError as error:
                progress(f"refused: {error}")
                errors = (math.inf,) * 3
        named = zip(RIG_LIMITS.items(), errors, strict=True)
        rows += [figure(f"rigs, seed {seed}: {key}", value, *limit) for (key, limit), value in named]
    return rows


def alignment_error(found: Sequence[RigEntry], true: Sequence[RigEntry]) -> tuple[float, float, float]:
    """Of the second rig relative to the first: place [cm], heading [deg] and clock [ms]."""
    (angle, place), (true_angle, true_place) = (
        (math.atan2(*pose.rotation[1::-1, 0]), pose.translation[:2])
        for pose in (found[1].world_SE3_left, true[1].world_SE3_left)
    )
    heading = math.remainder(angle - true_angle, 2 * math.pi)
    clock_s = found[1].start_s - true[1].start_s
    return 100 * float(np.hypot(*(place - true_place))), abs(math.degrees(heading)), 1000 * abs(clock_s)


FAMILIES: dict[Family, Callable[[], list[Row]]] = {
    "board": board_rows, "floor": floor_rows, "human": human_rows, "walkers": walker_rows, "rigs": rig_rows,
    "deviations": deviation_rows,
}  # fmt: skip


def calibration(*, only: Family | None = None, json_output: JsonFlag = False) -> None:
    """Score board, floor and human calibration, and the alignment of rigs, against known truth.

    Example: python -m benchmarks calibration --only board

    Parameters
    ----------
    only
        One family: board, floor, human, walkers (as ``--auto`` takes them), rigs or deviations (of floors).
    json_output
        Print one JSON object on stdout.
    """
    report(json_output, rows=[row for name, rows in FAMILIES.items() if only in (None, name) for row in rows()])
