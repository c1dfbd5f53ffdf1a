"""The gain of the exposure, found from all pixels and followed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import gain as reference

from planview.foreground import gain as kernels
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams

CLIP, TOLERANCE = 250.0, 12.0


def _lumas(seed: int, gain: float, offset: float, outliers: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    model = rng.uniform(10, 300, 2000).astype(np.float32)
    luma = gain * model + offset + rng.normal(0, 2, 2000)
    wrong = rng.random(2000) < outliers
    luma[wrong] = 90 + rng.normal(0, 5, wrong.sum())
    return model, luma.clip(0, 255).astype(np.float32)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    gain=st.floats(0.3, 3),
    offset=st.floats(-40, 40),
    outliers=st.floats(0, 0.4),
    start=st.floats(0.3, 3),
)
def test_gain_kernels_agree_with_numpy(seed, gain, offset, outliers, start):
    model, luma = _lumas(seed, gain, offset, outliers)
    information = kernels.information_of(luma, TOLERANCE)
    most = float(information.max())
    for step in (1, kernels.THINNING):
        args = model, luma, information, start, offset, CLIP, TOLERANCE, step
        ours, theirs = kernels.weigh_inliers(*args), reference.weigh_inliers(*args)
        # A pixel on the edge of the tolerance may fall on either side.
        assert abs(ours[0] - theirs[0]) <= 2
        assert ours[1] == pytest.approx(theirs[1], rel=1e-4, abs=2 * most)
    line = kernels.refine_gain(model, luma, start, offset, CLIP, TOLERANCE)
    assert line == pytest.approx(reference.refine_gain(model, luma, start, offset, CLIP, TOLERANCE), rel=1e-2, abs=0.1)
    scale = kernels.consensus_scale(model, luma, information, CLIP, TOLERANCE)
    expected = reference.consensus_scale(model, luma, information, CLIP, TOLERANCE)
    last = 0.0, CLIP, TOLERANCE, kernels.THINNING
    printed = [kernels.weigh_inliers(model, luma, information, gain, *last)[1] for gain in (scale, expected)]
    assert printed[0] == pytest.approx(printed[1], abs=2 * most)


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.6, 20.0), (1.8, -40.0), (0.9, -80.0)])
def test_line_is_found_from_nowhere_with_forty_percent_outliers(gain, offset):
    model, luma = _lumas(3, gain, offset, 0.4)
    found = kernels.consensus_line(model, luma, kernels.information_of(luma, TOLERANCE), 1.0, 0.0, CLIP, TOLERANCE)
    refined = kernels.refine_gain(model, luma, *found, CLIP, TOLERANCE)
    levels = np.array([60.0, 150.0])
    assert refined[0] * levels + refined[1] == pytest.approx(gain * levels + offset, abs=3)


def test_scale_is_found_on_an_image_that_is_nearly_all_clipped():
    rng = np.random.default_rng(0)
    model = rng.uniform(100, 200, 2000).astype(np.float32)
    luma = np.minimum(2.4 * model + rng.normal(0, 2, 2000), 255).astype(np.float32)
    information = kernels.information_of(luma, TOLERANCE)
    gain = kernels.consensus_scale(model, luma, information, CLIP, TOLERANCE)
    assert kernels.weigh_inliers(model, luma, information, gain, 0.0, CLIP, TOLERANCE, 1)[0] > 1900


def test_pixel_tells_the_less_the_more_of_the_image_has_its_luma():
    luma = np.array([100.0] * 90 + [200.0] * 10, np.float32)
    by_chance = np.array([0.9 * 0.9, 0.9 * 0.1]) + 0.1 * 25 / 256
    assert kernels.information_of(luma, TOLERANCE)[[0, -1]] == pytest.approx(-np.log(by_chance), rel=1e-5)


WALL = np.random.default_rng(0).uniform(40, 160, (60, 80))


def _watch(images: list[np.ndarray]) -> tuple[Foreground, list[np.ndarray]]:
    """The foreground stage after some images, to which noise is added, and its masks."""
    rng, foreground = np.random.default_rng(1), Foreground(ForegroundParams(), WALL.shape)
    noisy = [(image + rng.normal(0, 2, WALL.shape)).clip(0, 255).astype(np.uint8) for image in images]
    return foreground, [foreground.update(image, None, i / 10) for i, image in enumerate(noisy)]


def _follow(gains: list[float]) -> Foreground:
    foreground, masks = _watch([gain * WALL for gain in gains])
    assert max((mask > 0).mean() for mask in masks) < 0.02
    return foreground


def test_gain_is_followed():
    foreground = _follow([1.0] * 10 + [1.3])
    assert foreground._exposure.gain == pytest.approx(1.3, abs=0.03)


def test_model_moves_to_a_gain_that_is_far_away():
    foreground = _follow([1.0] * 10 + [0.4, 0.4])
    assert foreground._exposure.gain == pytest.approx(1.0, abs=0.05)


def test_plain_shirt_over_most_or_all_of_the_image_is_no_gain():
    """A line almost without slope would fit, and the model in that exposure would have forgotten the scene."""
    shirt = 1.1 * WALL
    shirt[:, 28:] = 105
    assert _watch([WALL] * 10 + [shirt])[0].exposure.gain == pytest.approx(1.1, abs=0.03)
    wall = 80 + WALL / 2
    foreground, masks = _watch([wall] * 10 + [np.full_like(wall, 120)] * 2 + [wall])
    assert foreground.exposure.gain == pytest.approx(1.0, abs=0.02)
    assert (masks[-1] > 0).mean() < 0.01


def test_drifting_light_does_not_run_away():
    rng = np.random.default_rng(5)
    drift = np.exp(np.cumsum(rng.normal(0, 0.02, 1000)))
    foreground = _follow(list(np.clip(drift, 0.4, 1.5)))
    assert 0.4 < foreground._exposure.gain < 2.5


def test_another_scene_is_no_gain():
    rng = np.random.default_rng(5)
    foreground, _ = _watch([rng.integers(0, 255, WALL.shape) for _ in range(10)])
    assert foreground._exposure.gain == pytest.approx(1.0, abs=0.3)
