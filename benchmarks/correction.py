"""Correction of aged calibrations: rendered rigs turned by known angles, and the real overhead pair."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from rich.console import Console

from benchmarks.calibration import Row, rendered_lobby, show_rows
from benchmarks.options import JsonFlag
from benchmarks.passes import bench_engine
from benchmarks.real import score_real, truth_of
from calib.pose import SE3
from calib.rig import Floor, StereoRig
from calib.types import F64
from planview.engine.config import load_config
from planview.engine.open import base_config
from planview.output.script import run
from planview.synthetic.assets import real_recordings
from stereo.floor import FloorEstimator, setup_frames
from stereo.readers.open import open_recording
from stereo.rectify import Rectifier, aligned_rectifier


def correction(*, json_output: JsonFlag = False) -> None:
    """Score the correction of calibrations whose right camera has turned; with --json one JSON object on stdout.

    Example: python -m benchmarks correction
    """
    rows: list[Row] = []
    with Console(stderr=True, markup=False).status("...") as status:
        for tilt_deg in (15, 60):
            status.update(f"rendered at {tilt_deg} degrees")
            rows += rendered_rows(tilt_deg)
        if (real_recordings() / "overhead-stereo").is_dir():
            status.update("the real overhead pair")
            rows += real_rows()
    show_rows(rows, json_output)


def rendered_rows(tilt_deg: int) -> list[Row]:
    """The committed lobby from one camera, its calibration right and off by each angle."""
    true, true_floor, frames = rendered_lobby(tilt_deg)
    rows = []
    for error_deg, axis in [(0.0, 0), *((e, axis) for e in (0.1, 0.25, 0.5) for axis in range(3))]:
        turn = SE3.from_rotvec(math.radians(error_deg) * np.eye(3)[axis])
        rectifier, found = aligned_rectifier(replace(true, right_SE3_left=turn @ true.right_SE3_left), frames)
        floor = FloorEstimator(rectifier)(frames)
        left_deg = np.degrees((rectifier.rig.right_SE3_left @ true.right_SE3_left.inverse()).rotvec)
        name = f"rendered at {tilt_deg}, {('pitch', 'yaw', 'roll')[axis]} off by {error_deg:g}"
        height, positions = abs(floor.height_m - true_floor.height_m), head_error_m(true, true_floor, rectifier, floor)
        limit = 3.0 * math.degrees(float(np.nanmax(found.deviations)))
        rows += [
            Row(f"{name}: angle left", float(np.abs(left_deg).max()), "deg", limit),
            Row(f"{name}: floor height", 100 * height, "cm", 2.0),
            Row(f"{name}: positions", 100 * positions, "cm"),
        ]
    return rows


def head_error_m(true: StereoRig, true_floor: Floor, rectifier: Rectifier, floor: Floor) -> float:
    """Mean error on the floor [m] of heads seen without noise, 2 to 6 m from the camera, by a rig and floor found."""
    ideal, geometry = Rectifier(true), rectifier.geometry
    u, v = (axis.ravel() for axis in np.meshgrid(*(np.linspace(0.1, 0.9, 9) * side for side in ideal.geometry.size)))
    rays: F64 = ideal.geometry.rays(np.column_stack([u, v]))
    world = rays @ true_floor.world_SE3_left.rotation.T
    reach = (true_floor.height_m - 1.6) / np.maximum(-world[:, 2], 1e-6)
    seen = (world[:, 2] < 0) & (reach * rays[:, 2] < 6.0)
    left = ideal.rect_SE3_left.inverse() @ (rays * reach[:, None])[seen]
    right = true.right_SE3_left @ left
    turns = rectifier.rig.rectifying_rotations()
    a, b = ((p @ turn.T)[:, :2] / (p @ turn.T)[:, 2:] for p, turn in zip((left, right), turns, strict=True))
    depth = geometry.baseline_m / (a - b)[:, 0]
    found = floor.world_SE3_left @ np.column_stack([a * depth[:, None], depth])
    truth = true_floor.world_SE3_left @ (rays * reach[:, None])[seen]
    return float(np.hypot(*(found - truth)[:, :2].T).mean())


def real_rows() -> list[Row]:
    """What the correction leaves of the real overhead pair, its floor, and both trackers' positions."""
    folder = real_recordings() / "overhead-stereo"
    recording = open_recording(folder)
    frames = setup_frames(recording)
    rectifier, found = aligned_rectifier(recording.rig, frames)
    floor, scale = FloorEstimator(rectifier)(frames), recording.rig.left.width / rectifier.geometry.width
    up, name = floor.world_SE3_left.rotation[2], "real overhead pair"
    # Angles about x and about y [deg], and the height [m], are from the README of the shared recordings.
    rows = [
        Row(f"{name}, {found}: residual of {found.before_px * scale:.2f} px", found.after_px * scale, "px", 0.5),
        Row(f"{name}: tilt", abs(math.degrees(math.atan2(-up[1], -up[2])) - 10.9), "deg", 0.5),
        Row(f"{name}: roll", abs(math.degrees(floor.roll_rad) - 2.8), "deg", 0.5),
        Row(f"{name}: height", 100 * abs(floor.height_m - 2.706), "cm", 2.0),
    ]
    for tracker in ("template", "peaks"):
        engine = bench_engine(folder, tracker, load_config(None, (), base_config(folder)))
        score = score_real(name, tracker, run(engine), truth_of(folder), np.arange(recording.n_frames))
        error = score.evaluation.to_json()["position_error_mean_m"]
        rows.append(Row(f"{name}: positions by {tracker}", 100 * error, "cm", 6.0))
    return rows
