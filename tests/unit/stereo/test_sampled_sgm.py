"""Matching of every n-th row and column."""

import numpy as np
import pytest
from reference import sampled_matching as reference

from stereo._sampled_sgm_kernels import PathParams, layout, match_samples, room
from stereo.depth import RectifiedGeometry
from stereo.gating import Window
from stereo.matcher import DisparityRange, SgbmMatcher, SgbmParams, right_of
from stereo.sampled_sgm import SampledDisparity, SampledMatcher

GEOMETRY = RectifiedGeometry(320, 240, 400.0, 400.0, 160.0, 120.0, 0.1)
SEARCHED = DisparityRange(5, 32)


def textured(height: int, width: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (height, width // 2 + 1)).repeat(2, axis=1)[:, :width]
    return (0.7 * coarse + 0.3 * rng.integers(0, 256, (height, width))).astype(np.uint8)


@pytest.mark.parametrize(("step", "block"), [(1, 5), (2, 5), (3, 5), (2, 3), (2, 1), (2, 7)])
def test_sampled_match_equals_its_numpy_twin(step: int, block: int) -> None:
    first, count, offset = 3, 32, 20
    right = textured(21, 96, step)
    left = np.concatenate([right[:, 27:57], right[:, 40:60]], axis=1)  # disparities off the range and within it
    at = layout(*left.shape, step, block)
    shape, n = room(at, count)
    found = np.empty((at.rows, at.columns), np.int16)
    extremes = np.empty((2, at.rows, at.columns), np.uint8)
    area = block * block
    choice = PathParams(8 * area, 28 * area, 8, 1)
    planes, work = np.full(shape, 77, np.uint8), np.full(n, 77, np.int16)
    match_samples(left, right, offset, first, count, at, choice, planes, work, found, *extremes)
    costs = reference.costs(left, right, offset, first, count, step, block)
    np.testing.assert_array_equal(found, reference.disparities(costs, step, 8 * area, 28 * area, 8, 1))
    assert extremes[0, 1, 1] == left[step : 2 * step, step : 2 * step].min()
    assert extremes[1, 1, 1] == left[step : 2 * step, step : 2 * step].max()


def matcher(step: int, hidden: slice = slice(0, 0)) -> SampledMatcher:
    whole = np.full((240, 320), 255, np.uint8)
    mask = whole.copy()
    mask[:, hidden] = 0
    return SampledMatcher(GEOMETRY, SgbmParams(), step, mask, whole)


def pair(disparity: int) -> tuple[np.ndarray, np.ndarray]:
    wide = textured(240, 320 + disparity, 1)
    return wide[:, :320], wide[:, disparity:]


def matched(step: int, window: Window, disparity: int = 12, searched: DisparityRange = SEARCHED) -> np.ndarray:
    whole = np.full((240, 320), 255, np.uint8)
    opencv = SgbmMatcher(GEOMETRY, None, searched, whole, whole)
    ours, (left, right) = opencv if step == 1 else matcher(step), pair(disparity)
    return ours.part(left[window.slices], right[right_of(window, searched).slices], window, searched)


@pytest.mark.parametrize("step", [1, 2])
def test_a_window_has_the_disparity_of_its_samples(step: int) -> None:
    found = matched(step, Window(120, 60, 220, 160))
    assert found.shape == (100 // step, 100 // step)
    inside = found[8 // step : -8 // step, 8 // step : -8 // step] - 12.0
    assert abs(np.median(inside)) < 0.08
    assert (np.abs(inside) < 0.4).mean() > 0.95


def test_a_window_at_the_left_edge_has_disparity_where_the_right_camera_has_the_scene() -> None:
    found = matched(2, Window(0, 60, 80, 160), searched=DisparityRange(0, 32))
    assert np.isnan(found[:, :5]).all()
    assert np.isfinite(found[4:-4, 10:35]).mean() > 0.95


def test_what_shows_nothing_has_no_disparity() -> None:
    ours, (left, right), window = matcher(2, hidden=slice(140, 160)), pair(12), Window(120, 60, 220, 160)
    found = ours.part(left[window.slices], right[right_of(window, SEARCHED).slices], window, SEARCHED)
    assert np.isnan(found[:, 10:20]).all()
    assert np.isfinite(found[:, 30:]).all()


def test_smooth_surfaces_have_no_disparity() -> None:
    ours, window, plain = matcher(2), Window(120, 60, 220, 160), np.full((100, 100), 90, np.uint8)
    wide = np.full((100, 137), 90, np.uint8)
    assert np.isnan(ours.part(plain, wide, window, SEARCHED)).all()


def test_an_image_of_samples_repeats_them() -> None:
    samples = np.array([[1.0, 2.0], [3.0, np.nan]], np.float32)
    image = SampledDisparity(samples, 2, (3, 4)).image
    np.testing.assert_array_equal(image, [[1, 1, 2, 2], [1, 1, 2, 2], [3, 3, np.nan, np.nan]])
