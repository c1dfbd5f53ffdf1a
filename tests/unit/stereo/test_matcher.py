"""Matching of reduced images, refined at full size: sub-pixel disparity, invalid pixels, ranges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import stereo_kernels as reference
from toy_stereo import SIZE, ToyWorld, toy_rig

from calib.rig import Floor, world_from_plane
from calib.types import U8
from stereo.depth import Matched, RectifiedGeometry
from stereo.matcher import (
    FIRST_PAIRS,
    KEPT_MAX,
    DisparityRange,
    RangeParams,
    SgbmMatcher,
    coarse_disparity,
    differences,
    disparity_range,
    shared_step,
)

GEOMETRY = RectifiedGeometry(320, 240, 230.0, 230.0, 159.5, 119.5, 0.12)
OVERHEAD = RectifiedGeometry(640, 400, 406.0, 406.0, 320.0, 200.0, 0.0738)


def shifted(disparity_px: float, noise: float = 1.0) -> tuple[U8, U8]:
    """A plane facing the camera, from a texture ten times finer than the pixels."""
    rng = np.random.default_rng(3)
    fine = rng.normal(size=(240, 3800))
    kernel = np.exp(-0.5 * (np.arange(-40, 41) / 12.0) ** 2)
    rows = np.apply_along_axis(np.convolve, 1, fine, kernel / kernel.sum(), "same")
    rows = rows / rows.std()
    start = np.arange(320) * 10
    at = [start, start + round(10 * disparity_px)]
    left, right = (120.0 + 35.0 * rows[:, i] + rng.normal(size=(240, 320)) * noise for i in at)
    return np.clip(left, 0, 255).astype(np.uint8), np.clip(right, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("disparity", [12.0, 12.3, 12.5, 12.7])
def test_sub_pixel_disparity_is_not_drawn_to_whole_pixels(disparity):
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 32))(*shifted(disparity))
    inner = found[20:-20, 60:-20]
    assert np.isfinite(inner).mean() > 0.95
    assert np.nanmean(inner) == pytest.approx(disparity, abs=0.08)


@pytest.mark.parametrize("first_px", [0, 5])
def test_left_band_is_matched_as_far_as_the_right_camera_sees_wherever_the_search_starts(first_px):
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(first_px, 64 if not first_px else 32))(*shifted(12.0))
    assert np.isfinite(found[20:-20, 16:64]).mean() > 0.9
    assert np.isfinite(found[20:-20, 16:-20]).mean() > 0.9
    assert not np.isfinite(found[:, :11]).any()
    assert np.nanmedian(found) == pytest.approx(12.0, abs=0.1)


@pytest.mark.parametrize("level", [255, 90], ids=["saturated", "without texture"])
def test_area_that_shows_nothing_has_no_disparity(level):
    left, right = shifted(12.0)
    left[60:180, 100:250] = level
    right[60:180, 88:238] = level
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 32))(left, right)
    assert np.isnan(found[75:165, 115:235]).all()


def test_unrelated_images_give_little_disparity():
    left, right = (ToyWorld(seed=seed).pair(toy_rig())[0] for seed in (1, 2))
    assert np.isfinite(SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 64))(left, right)).mean() < 0.4


def test_images_of_another_size_are_refused():
    narrow = np.zeros((240, 300), np.uint8)
    with pytest.raises(ValueError, match=r"\(240, 320\)"):
        SgbmMatcher(GEOMETRY)(narrow, narrow)


@pytest.mark.parametrize(("side", "seen"), [("mask", 197), ("right_mask", 212)])
def test_pixels_that_are_masked_or_whose_match_is_have_no_disparity(side, seen):
    mask = np.full(SIZE[::-1], 255, np.uint8)
    mask[:, 200:] = 0
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 32), **{side: mask})(*shifted(12.0))
    assert np.isnan(found[:, seen:]).all()
    assert np.isfinite(found[20:-20, 60 : seen - 7]).mean() > 0.9


@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_samples_have_the_disparity_of_their_pixels(step):
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(5, 32), step=step).match(*shifted(12.3)).disparity
    inside = found[64 // step : -64 // step, 124 // step : -104 // step] - 12.3
    assert abs(np.nanmedian(inside)) < 0.08
    assert (np.abs(inside) < 0.4).mean() > 0.9


@pytest.mark.parametrize("step", [2, 3, 4])
def test_samples_of_an_image_whose_size_is_no_multiple_are_one_more(step):
    odd = RectifiedGeometry(317, 233, 230.0, 230.0, 159.5, 119.5, 0.12)
    left, right = (np.ascontiguousarray(image[:233, :317]) for image in shifted(12.0))
    matcher = SgbmMatcher(odd, disparities=DisparityRange(0, 32), step=step)
    assert matcher.match(left, right).disparity.shape == matcher.shape == (-(-233 // step), -(-317 // step))
    found = matcher(left, right)
    assert found.shape == (233, 317)
    assert np.nanmedian(found) == pytest.approx(12.0, abs=0.08)


def brighter(image: U8, levels: int, rows: slice = slice(None), columns: slice = slice(None)) -> U8:
    changed = image.copy()
    changed[rows, columns] += np.uint8(levels)
    return changed


@pytest.fixture(scope="module")
def still() -> tuple[SgbmMatcher, Matched, U8, U8]:
    """A matcher after many pairs, what it found in the last, and that pair, nowhere too bright to become brighter."""
    left, right = (np.minimum(image, 200) for image in shifted(12.0))
    matcher = SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 32))
    return matcher, matcher.match(left, right)._replace(seen=FIRST_PAIRS), left, right


def test_the_first_pairs_are_matched_whatever_they_show(still):
    matcher, first, left, right = still
    assert matcher.match(left, right, first._replace(seen=FIRST_PAIRS - 1)).kept == 0


def test_pair_in_which_nothing_moved_is_not_matched_again(still):
    matcher, first, left, right = still
    second = matcher.match(left.copy(), right.copy(), first)
    assert second.disparity is first.disparity
    assert (first.kept, second.kept) == (0, 1)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize(("levels", "kept"), [(5, 1), (6, 0)])
def test_change_of_five_by_five_samples_in_one_image_is_matched(still, side, levels, kept):
    matcher, first, *pair = still
    pair[side] = brighter(pair[side], levels, slice(100, 105), slice(200, 205))
    assert matcher.match(*pair, first).kept == kept


def test_light_that_drifts_is_matched_again_before_it_has_drifted_far(still):
    matcher, last, left, right = still
    kept = []
    for levels in range(2, 13, 2):
        last = matcher.match(brighter(left, levels), brighter(right, levels), last)
        kept.append(last.kept)
    assert kept == [1, 2, 0, 1, 2, 0]


def test_disparity_is_kept_for_a_number_of_pairs_at_most(still):
    matcher, last, left, right = still
    kept = [(last := matcher.match(left, right, last)).kept for _ in range(KEPT_MAX + 2)]
    assert kept == [*range(1, KEPT_MAX + 1), 0, 1]


WIDE = RectifiedGeometry(640, 480, 500.0, 500.0, 320.0, 240.0, 1.0)
ABOVE, LEVEL = (Floor(world_from_plane(np.array(n), h)) for n, h in (([0, 0, -1.0], 2.74), ([0, -1.0, 0], 1.6)))


@pytest.mark.parametrize(
    ("geometry", "params", "floor", "first_px", "count"),
    [
        (GEOMETRY, RangeParams(nearest_m=1.0), None, 0, 32),  # f b / 1 m = 27.6 px
        (WIDE, RangeParams(max_disparities=100), None, None, 96),
        # f b = 29.96: 9.2 px at 3.24 m, 40.5 px at 0.74 m.
        (OVERHEAD, RangeParams(reach_m=2.0, below_floor_m=0.5), ABOVE, 8, 48),
        (OVERHEAD, RangeParams(nearest_m=0.7), LEVEL, 0, None),
    ],
    ids=["nearest distance", "bounded for wide baselines", "heads above a floor", "level camera to infinity"],
)
def test_range_reaches_what_can_be_seen(geometry, params, floor, first_px, count):
    found = disparity_range(geometry, params, floor)
    assert first_px in (found.first_px, None)
    assert count in (found.count, None)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(1, 3))
def test_coarse_disparity_equals_its_numpy_twin(seed, lowest, step):
    rng = np.random.default_rng(seed)
    fixed = rng.integers(-16, 500, (9, 37)).astype(np.int16)
    usable, right_mask = (np.where(rng.uniform(size=(9, 37)) < 0.8, 255, 0).astype(np.uint8) for _ in range(2))
    ours = np.empty((9, 37), np.float32)
    coarse_disparity(fixed, usable, right_mask, step, lowest, ours)
    np.testing.assert_array_equal(ours, reference.coarse_disparity(fixed, usable, right_mask, step, lowest))


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 2))
def test_refinement_equals_its_numpy_twin(seed, step, apart):
    rng = np.random.default_rng(seed)
    left, right = (rng.integers(0, 256, size).astype(np.uint8) for size in ((9, 12), (40, 60)))
    disparity = rng.uniform(3.0, 7.0, (9, 12)).astype(np.float32)
    disparity[rng.uniform(size=disparity.shape) < 0.2] = np.nan
    error, slope, found = (np.empty_like(disparity) for _ in range(3))
    differences(left, right, disparity, 2, step, apart, error, slope)
    expected = reference.differences(left, right, disparity, 2, step, apart)
    np.testing.assert_allclose((error, slope), expected, atol=2e-3)
    shared_step(disparity, error, slope, 1.0, 12.0, found)
    np.testing.assert_allclose(found, reference.shared_step(disparity, error, slope, 1.0, 12.0), atol=1e-3)
