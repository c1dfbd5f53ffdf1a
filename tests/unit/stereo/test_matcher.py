"""Matching from both ends: the lag of one pass is taken out, and masks turn with the images."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import stereo_kernels as reference
from toy_stereo import SIZE, ToyWorld, toy_rig

from calib.rig import Floor, world_from_plane
from calib.types import U8
from stereo import _kernels
from stereo.depth import RectifiedGeometry
from stereo.gating import Window
from stereo.matcher import (
    SUBPIXEL,
    DisparityRange,
    RangeParams,
    SampledDisparity,
    SgbmMatcher,
    TwoWayMatcher,
    disparity_range,
    farthest_head_m,
    right_of,
)
from stereo.rectify import RectifiedPair, Rectifier

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
def test_sub_pixel_disparity_is_not_drawn_to_whole_pixels(disparity: float) -> None:
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 32))(*shifted(disparity))
    inner = found[20:-20, 60:-20]
    assert np.isfinite(inner).mean() > 0.95 and np.nanmean(inner) == pytest.approx(disparity, abs=0.08)


def test_disparity_of_the_floor_is_that_of_its_depth() -> None:
    rig = toy_rig()
    world = ToyWorld(tilt_deg=0.0)
    rectifier = Rectifier(rig)
    pair = rectifier(*world.pair(rig))
    found = SgbmMatcher(rectifier.geometry, mask=rectifier.mask)(pair.left_grey, pair.right_grey)
    expected = 230.0 * 0.12 / 2.5
    assert np.isfinite(found[:, 24:]).mean() > 0.95
    assert np.nanmedian(found) == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("first_px", [0, 5])
def test_left_band_is_matched_as_far_as_the_right_camera_sees_wherever_the_search_starts(first_px):
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(first_px, 64 if not first_px else 32))(*shifted(12.0))
    assert np.isfinite(found[20:-20, 16:64]).mean() > 0.9 and np.isfinite(found[20:-20, 16:-20]).mean() > 0.9
    assert not np.isfinite(found[:, :11]).any() and np.nanmedian(found) == pytest.approx(12.0, abs=0.1)


@pytest.mark.parametrize("level", [255, 90], ids=["saturated", "without texture"])
def test_area_that_shows_nothing_has_no_disparity(level: int) -> None:
    left, right = shifted(12.0)
    left[60:180, 100:250] = level
    right[60:180, 88:238] = level
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 32))(left, right)
    assert np.isnan(found[75:165, 115:235]).all()


def test_unrelated_images_give_little_disparity_and_other_sizes_are_refused():
    left, _ = ToyWorld(seed=1).pair(toy_rig())
    right, _ = ToyWorld(seed=2).pair(toy_rig())
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 64))(left, right)
    assert np.isfinite(found).mean() < 0.4
    with pytest.raises(ValueError, match=r"\(240, 320\)"):
        SgbmMatcher(GEOMETRY)(np.zeros((240, 300), np.uint8), np.zeros((240, 300), np.uint8))


@pytest.mark.parametrize(("side", "seen"), [("mask", 197), ("right_mask", 212)])
def test_pixels_that_are_masked_or_whose_match_is_have_no_disparity(side: str, seen: int) -> None:
    mask = np.full(SIZE[::-1], 255, np.uint8)
    mask[:, 200:] = 0
    found = SgbmMatcher(GEOMETRY, disparities=DisparityRange(0, 32), **{side: mask})(*shifted(12.0))  # type: ignore[arg-type]
    assert np.isnan(found[:, seen:]).all() and np.isfinite(found[20:-20, 60 : seen - 7]).mean() > 0.9


@pytest.mark.parametrize("step", [1, 2, 3])
def test_a_window_has_the_disparity_of_its_samples(step: int) -> None:
    searched, window, (left, right) = DisparityRange(5, 32), Window(120, 60, 219, 159), shifted(12.0)
    matcher = SgbmMatcher(GEOMETRY, step=step)
    right = right[right_of(window, searched).slices]
    found = matcher.part(left[window.slices][::step], right[::step], window, searched)
    assert found.shape == (99 // step + 99 % step, 99 // step + 99 % step)
    inside = found[8 // step : -8 // step, 8 // step : -8 // step] - 12.0
    assert abs(np.median(inside)) < 0.08 and (np.abs(inside) < 0.4).mean() > 0.95


def test_samples_of_a_window_are_those_of_every_pixel() -> None:
    mask = np.full(SIZE[::-1], 255, np.uint8)
    mask[:, 150:170] = 0
    searched, window, (left, right) = DisparityRange(0, 32), Window(0, 60, 220, 160), shifted(12.0)
    every, second = (
        SgbmMatcher(GEOMETRY, mask=mask, right_mask=mask, step=step).part(
            left[window.slices][::step], right[right_of(window, searched).slices][::step], window, searched
        )
        for step in (1, 2)
    )
    assert second.shape == every[::2, ::2].shape
    assert np.isnan(second[:, 75:85]).all() and np.isfinite(second[:, 20:70]).mean() > 0.95
    assert np.nanmedian(np.abs(second - every[::2, ::2])) < 0.1


def test_an_image_of_samples_repeats_them() -> None:
    samples = np.array([[1.0, 2.0], [3.0, np.nan]], np.float32)
    image = SampledDisparity(samples, 2, (3, 4)).image
    np.testing.assert_array_equal(image, [[1, 1, 2, 2], [1, 1, 2, 2], [3, 3, np.nan, np.nan]])


def test_range_without_a_floor_is_that_of_the_nearest_distance_and_bounded_for_wide_baselines():
    found = disparity_range(GEOMETRY, RangeParams(nearest_m=1.0))
    assert found == DisparityRange(0, 32)  # f b / 1 m = 27.6 px
    wide = RectifiedGeometry(640, 480, 500.0, 500.0, 320.0, 240.0, 1.0)
    assert disparity_range(wide, RangeParams(max_disparities=100)).count == 96


def test_range_above_a_known_floor_reaches_heads_and_from_a_level_camera_infinity():
    floor = Floor(world_from_plane(np.array([0.0, 0.0, -1.0]), 2.74))
    found = disparity_range(OVERHEAD, RangeParams(reach_m=2.0, below_floor_m=0.5), floor)
    # f b = 29.96: 9.2 px at 3.24 m, 40.5 px at 0.74 m.
    assert found == DisparityRange(8, 48)
    floor = Floor(world_from_plane(np.array([0.0, -1.0, 0.0]), 1.6))
    assert disparity_range(OVERHEAD, RangeParams(nearest_m=0.7), floor).first_px == 0
    assert farthest_head_m(GEOMETRY, floor) == np.inf


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(0, 30), st.integers(1, 3))
def test_disparity_kernel_equals_its_numpy_twin(seed: int, lowest: int, left: int, step: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (9, 37)
    fixed = rng.integers(-16, 700, shape).astype(np.int16)
    shapes = shape, (9, 37 * step + left)
    masks = [np.where(rng.uniform(size=size) < 0.8, 255, 0).astype(np.uint8) for size in shapes]
    darkest = rng.integers(0, 256, shape).astype(np.uint8)
    brightest = np.maximum(darkest, rng.integers(0, 256, shape)).astype(np.uint8)
    ours, theirs = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for kernel, out in ((_kernels.disparity_from_fixed, ours), (reference.disparity_from_fixed, theirs)):
        kernel(fixed, *masks, darkest, brightest, left, step, lowest, SUBPIXEL, 250, 6, out)
    np.testing.assert_array_equal(ours, theirs)


def test_far_rows_need_fewer_disparities_and_the_farthest_head_is_a_childs_in_the_corner():
    tilt = np.radians(60.0)
    floor = Floor(world_from_plane(np.array([0.0, -np.sin(tilt), -np.cos(tilt)]), 2.7))
    rows = Window(0, 0, GEOMETRY.width, 60)
    far, everywhere = (disparity_range(GEOMETRY, None, floor, window) for window in (rows, None))
    assert far.count < everywhere.count and far.first_px == everywhere.first_px
    floor = Floor(world_from_plane(np.array([0.0, 0.0, -1.0]), 2.85))
    assert farthest_head_m(OVERHEAD, floor) == pytest.approx(2.0)


RECTIFIER = Rectifier(toy_rig())


def pair() -> RectifiedPair:
    return RECTIFIER(*ToyWorld().pair(RECTIFIER.rig, (), 0))


def test_two_way_matching_is_the_mean_of_both_passes() -> None:
    images = pair()
    one_way = SgbmMatcher(RECTIFIER.geometry)
    down = one_way(images.left_grey, images.right_grey)
    turned = (np.ascontiguousarray(i[::-1]) for i in (images.left_grey, images.right_grey))
    up = one_way(*turned)[::-1]
    found = TwoWayMatcher(RECTIFIER.geometry)(images.left_grey, images.right_grey)
    valid = np.isfinite(found)
    assert valid.mean() > 0.5
    np.testing.assert_allclose(found[valid], (0.5 * (down + up))[valid])
    assert (np.abs(down - up)[valid] < 2.0).all()


def test_two_way_matching_loses_only_what_a_mask_covers() -> None:
    images = pair()
    mask = RECTIFIER.mask.copy()
    mask[:60] = 0
    unmasked = TwoWayMatcher(RECTIFIER.geometry)(images.left_grey, images.right_grey)
    found = TwoWayMatcher(RECTIFIER.geometry, mask=mask)(images.left_grey, images.right_grey)
    assert np.isnan(found[:60]).all()
    np.testing.assert_array_equal(found[80:], unmasked[80:])
