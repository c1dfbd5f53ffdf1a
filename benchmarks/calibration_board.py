"""Board calibration against known truth: noisy corners of random rigs, and OpenCV's public pairs."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np

from benchmarks.board_views import LENS_NAMES, board_views, random_rig
from benchmarks.rows import Row
from calib.board.detect import Board
from calib.board.solve import solve_board
from calib.rig import StereoRig

SEEDS = 3
"""Rigs per lens."""
VIEWS = 30
NOISE_PX = 0.2
FOCAL_LIMIT, BASELINE_LIMIT, ROTATION_LIMIT_DEG = 0.2, 0.3, 0.05
TELE_ROTATION_LIMIT_DEG = 0.075
"""The principal point, and with it the direction of the optical axis, is open the more the longer the lens."""
OPENCV_BASELINE_SQUARES = 3.3427
"""Of the reference extrinsics.yml that comes with OpenCV's pairs."""


def measure() -> list[Row]:
    """Worst errors over all rigs of a lens; and OpenCV's pairs where they are at hand."""
    rows = [row for lens in LENS_NAMES for row in _measure_lens(lens)]
    return rows + _measure_opencv_pairs()


def calibration_errors(truth: StereoRig, found: StereoRig) -> tuple[float, float, float]:
    """Worst focal length error [%], baseline error [%] and rotation error [deg]."""
    focal = max(
        abs(getattr(getattr(found, side), key) / getattr(getattr(truth, side), key) - 1)
        for side in ("left", "right")
        for key in ("fx", "fy")
    )
    baseline = abs(found.baseline_m / truth.baseline_m - 1)
    turn = (found.right_SE3_left @ truth.right_SE3_left.inverse()).rotvec
    return 100 * focal, 100 * baseline, math.degrees(float(np.linalg.norm(turn)))


def _measure_lens(lens: str) -> list[Row]:
    board = Board(9, 6, 0.03)
    errors = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        truth = random_rig(lens, rng)
        views = board_views(truth, board, VIEWS, NOISE_PX, rng)
        errors.append(calibration_errors(truth, solve_board(views, board, truth.left.size).rig))
    worst = np.max(errors, axis=0)
    named = (
        ("focal length", "%", FOCAL_LIMIT),
        ("baseline", "%", BASELINE_LIMIT),
        ("rotation", "deg", TELE_ROTATION_LIMIT_DEG if lens == "tele" else ROTATION_LIMIT_DEG),
    )
    return [
        Row(f"boards, {lens} lens, worst of {SEEDS} rigs: {name}", float(value), unit, limit, bool(value <= limit))
        for value, (name, unit, limit) in zip(worst, named, strict=True)
    ]


def _measure_opencv_pairs() -> list[Row]:
    from planview.calibration.board import BoardRequest, calibrate_images

    data = os.environ.get("PLANVIEW_TEST_DATA")
    folder = Path(data) / "opencv-stereo-chessboard" if data else None
    if folder is None or not folder.is_dir():
        return []
    square_m = 0.025
    result = calibrate_images(folder, BoardRequest(None, square_m))
    off = 100 * abs(result.rig.baseline_m / square_m / OPENCV_BASELINE_SQUARES - 1)
    rms = result.fit.rms_px
    return [
        Row("boards, OpenCV pairs: stereo rms", rms, "px", 0.25, rms <= 0.25),
        Row("boards, OpenCV pairs: pairs not used", len(result.rejected), "", math.nan, True),
        Row("boards, OpenCV pairs: baseline against reference", off, "%", 1.0, off <= 1.0),
    ]
