import numpy as np
import pytest
from toy_stereo import ToyWorld, toy_rig

from stereo.row_offset import VerticalModel, VerticalParams, fit_affine, match_corners, measure_vertical


def matches_of(model: VerticalModel, count: int = 400, noise: float = 0.1, wrong: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(1)
    u, v = rng.uniform(0, 640, count), rng.uniform(0, 480, count)
    dv = model(u, v) + rng.normal(size=count) * noise
    bad = rng.uniform(size=count) < wrong
    return np.column_stack([u + 20.0, v, u, np.where(bad, rng.uniform(-6, 6, count), dv)])


def test_affine_fit_finds_offset_and_slopes_among_wrong_matches() -> None:
    truth = VerticalModel(0.8, 0.002, -0.001)
    fit = fit_affine(matches_of(truth, wrong=0.3))
    corners = np.array([0.0, 640.0, 0.0, 640.0]), np.array([0.0, 0.0, 480.0, 480.0])
    np.testing.assert_allclose(fit(*corners), truth(*corners), atol=0.08)


def test_offset_fit_is_the_median() -> None:
    assert fit_affine(matches_of(VerticalModel(-1.5)), slopes=False).offset_px == pytest.approx(-1.5, abs=0.05)


def test_matches_of_a_shifted_image_show_the_shift() -> None:
    left, _ = ToyWorld().pair(toy_rig())
    right = np.roll(left, (3, -20), axis=(0, 1))
    matches = match_corners(left, right, 40.0, VerticalParams())
    assert len(matches) > 60
    assert np.median(matches[:, 3]) == pytest.approx(3.0, abs=0.02)
    assert np.median(matches[:, 0] - matches[:, 2]) == pytest.approx(20.0, abs=0.02)


def test_shift_beyond_the_search_gives_no_correction() -> None:
    left, _ = ToyWorld().pair(toy_rig())
    fit = measure_vertical([(left, np.roll(left, (30, -20), axis=(0, 1)))], 40.0)
    assert fit.model == VerticalModel()


def test_unrelated_images_give_no_correction() -> None:
    left, _ = ToyWorld(seed=1).pair(toy_rig())
    right, _ = ToyWorld(seed=2).pair(toy_rig())
    assert measure_vertical([(left, right)], 40.0).model == VerticalModel()


def test_blank_and_saturated_images_give_no_matches() -> None:
    for value in (0, 128, 255):
        blank = np.full((240, 320), value, np.uint8)
        fit = measure_vertical([(blank, blank)], 40.0)
        assert len(fit.matches) == 0 and np.isnan(fit.before_px)


def test_few_matches_justify_no_correction() -> None:
    left = np.full((240, 320), 100, np.uint8)
    texture, _ = ToyWorld().pair(toy_rig())
    left[100:140, 100:140] = texture[100:140, 100:140]
    fit = measure_vertical([(left, np.roll(left, (2, -10), axis=(0, 1)))], 40.0)
    assert fit.model == VerticalModel()


def test_nothing_given_measures_nothing() -> None:
    assert measure_vertical([], 40.0).model == VerticalModel()
