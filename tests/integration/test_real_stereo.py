"""Rectification and matching on real pairs."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.types import F32, U8
from stereo.depth import RectifiedGeometry
from stereo.floor import FloorEstimator, setup_frames
from stereo.matcher import DisparityRange, SgbmMatcher
from stereo.readers import open_recording
from stereo.rectify import Rectifier, aligned_rectifier


def middlebury(folder: Path) -> tuple[U8, U8, F32]:
    left, right, truth = (cv2.imread(str(folder / name), 0) for name in ("im2.ppm", "im6.ppm", "disp2.pgm"))
    assert left is not None and right is not None and truth is not None
    known = truth.astype(np.float32) / 4
    known[truth == 0] = np.nan
    return left, right, known


@pytest.mark.parametrize(("scene", "bad_most"), [("cones", 0.064), ("teddy", 0.102)])
def test_middlebury_is_matched_better_than_by_plain_sgbm(shared_data: Path, scene: str, bad_most: float) -> None:
    left, right, truth = middlebury(shared_data / "middlebury-2003" / scene)
    geometry = RectifiedGeometry(left.shape[1], left.shape[0], 400.0, 400.0, 225.0, 187.0, 0.16)
    found = SgbmMatcher(geometry, disparities=DisparityRange(0, 64))(left, right)
    valid = np.isfinite(found) & np.isfinite(truth)
    bad = np.mean(np.abs(found - truth)[valid] > 1.0)
    assert bad <= bad_most
    assert valid.sum() / np.isfinite(truth).sum() > 0.85  # plain SGBM: 0.82


def test_overhead_pair_is_corrected_by_its_own_matches(shared_data: Path) -> None:
    recording = open_recording(shared_data / "overhead-stereo")
    frames = setup_frames(recording)
    rectifier, found = aligned_rectifier(recording.rig, frames)
    assert np.degrees(found.angles[2]) == pytest.approx(0.158, abs=0.02)  # see the recording's README
    assert list(found.is_applied) == [True, False, True]  # yaw cannot be told
    assert "roll corrected by 0.15" in str(found)
    assert found.before_px > 0.3
    assert found.after_px < 0.25  # 0.5 px of the recorded 1280
    floor = FloorEstimator(rectifier)(frames)
    assert floor.height_m == pytest.approx(2.706, abs=0.02)
    up = floor.world_SE3_left.rotation[2]
    about_x, about_y = np.degrees([np.arctan2(-up[1], -up[2]), np.arcsin(up[0])])
    assert about_x == pytest.approx(10.9, abs=1.0)  # at 640 px; 0.4 at the recorded 1280
    assert about_y == pytest.approx(2.8, abs=1.0)
    half = aligned_rectifier(recording.rig, frames[1::2])[1]
    assert np.all(np.abs(half.angles - found.angles) < 3.0 * found.deviations)


def test_overhead_videos_are_read_whole(shared_data: Path) -> None:
    recording = open_recording(shared_data / "overhead-stereo")
    count = sum(1 for _ in recording)
    assert count == recording.n_frames == 330 and recording.skipped == []
    assert recording.rig.left.size == (1280, 800)
    assert Rectifier(recording.rig).geometry.baseline_m == pytest.approx(0.0738, abs=1e-4)
