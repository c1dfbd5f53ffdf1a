"""Rectification and matching on real pairs."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.types import F32, U8
from stereo.depth import RectifiedGeometry
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


def test_overhead_pair_has_its_row_offset_taken_out(shared_data: Path) -> None:
    recording = open_recording(shared_data / "overhead-stereo")
    frames = recording.sample(8)
    rectifier, fit = aligned_rectifier(recording.rig, frames)
    assert fit.before_px > 0.3  # 0.6 to 1.0 px at the recorded 1280x800, so half of it here
    assert fit.after_px < 0.2
    again = aligned_rectifier(recording.rig, frames[1::2])[1]
    assert again.after_px < 0.2
    pair = rectifier(frames[4].left, frames[4].right)
    disparity = SgbmMatcher(rectifier.geometry, mask=rectifier.mask)(pair.left_grey, pair.right_grey)
    depth = rectifier.geometry.disparity_metre / np.nanmedian(disparity)
    assert depth == pytest.approx(2.74, abs=0.15)


def test_overhead_videos_are_read_whole(shared_data: Path) -> None:
    recording = open_recording(shared_data / "overhead-stereo")
    count = sum(1 for _ in recording)
    assert count == recording.n_frames == 330 and recording.skipped == []
    assert recording.rig.left.size == (1280, 800)
    assert Rectifier(recording.rig).geometry.baseline_m == pytest.approx(0.0738, abs=1e-4)
