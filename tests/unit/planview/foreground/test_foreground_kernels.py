"""Kernels of the foreground against their numpy twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import foreground as reference

from planview.foreground import _mixture_kernels as kernels
from planview.foreground._leader_kernels import BLOCK, N_FIELDS, N_LEAD, Rates
from planview.foreground.ghosts import moved_lately
from planview.foreground.mixture import TURNS, Foreground
from planview.foreground.params import ForegroundParams

SHAPE = (7, 31)  # more than one block, the last one not full
N = SHAPE[0] * SHAPE[1]


def _mixtures(foreground: Foreground) -> reference.Mixtures:
    """The state of the kernels as the twin has it."""
    k = foreground.params.gaussians
    lead = foreground._lead.reshape(-1, N_LEAD, BLOCK).transpose(1, 0, 2).reshape(N_LEAD, -1)
    rest = foreground._rest.reshape(N, k - 1, N_FIELDS).transpose(1, 2, 0)
    both = np.concatenate([lead[None, :N_FIELDS, :N], rest])
    both[1:, 0] *= 1 - both[0, 0]
    names = reference.Mixtures.NUMBERS
    return reference.Mixtures(
        **{name: both[:, f] for f, name in enumerate(names)}, activity=lead[10, :N], last_y=lead[11, :N]
    )


def _frames(rng: np.random.Generator, colour: bool, depth: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """A background with noise, a blob of other colour and depth, clipped, dark and depthless pixels."""
    base = np.linspace(0, 300, N).clip(0, 255)[:, None] + rng.normal(0, 3, (N, 3)) + rng.choice([0, 0, 0, -60, 80])
    base[rng.integers(0, N) :][:40] += rng.normal(0, 60, 3)
    disparity = np.full(N, 20.0) + rng.normal(0, 0.3, N) + rng.choice([0, 0, 0, 8, -8], N)
    disparity[rng.random(N) < 0.3] = np.nan
    image = base.clip(0, 255).astype(np.uint8)
    return (image if colour else image[:, 0].copy()), (disparity.astype(np.float32) if depth else None)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    colour=st.booleans(),
    depth=st.booleans(),
    feedback=st.booleans(),
    gated=st.booleans(),
    k=st.integers(2, 5),
    shadows=st.booleans(),
)
def test_kernels_agree_with_numpy(seed, colour, depth, feedback, gated, k, shadows):
    rng = np.random.default_rng(seed)
    params = ForegroundParams(gaussians=k, remove_colour_shadows=shadows)
    foreground = Foreground(params, SHAPE)
    constants = foreground._constants()
    image, disparity = _frames(rng, colour, depth)
    none = np.zeros(0, np.float32)
    kernels.start_blocks(
        foreground._lead, foreground._rest, image.reshape(-1), none if disparity is None else disparity, N, constants
    )
    twin = reference.start(reference.observe(image, disparity, constants), k, constants)
    for frame in range(12):
        image, disparity = _frames(rng, colour, depth)
        known = rng.integers(0, 3, N).astype(np.uint8) if feedback else np.zeros(0, np.uint8)
        rates = np.float32([0.1, 0.2, 0.3, 0.1] if frame % 3 else [0, 0, 0, 0])
        # The first block holds nothing that is measured.
        measured = (rng.random(N) < 0.5) & (np.arange(N) >= BLOCK) if gated else np.ones(N, bool)
        if disparity is not None:
            disparity[~measured] = np.nan
        looked = measured.astype(np.uint8) if gated else np.zeros(0, np.uint8)
        args = image.reshape(-1), none if disparity is None else disparity, known, looked, foreground._mask
        kernels.update_blocks(
            foreground._lead, foreground._rest, *args, 0, len(foreground._lead), constants, np.tile(rates, (TURNS, 1))
        )
        pixels = reference.observe(image, disparity, constants)
        expected = reference.update(
            twin, pixels, known if feedback else np.zeros(N, np.uint8), constants, Rates(*rates), measured
        )
        np.testing.assert_array_equal(foreground._mask, expected)
        state = _mixtures(foreground)
        for name in (*reference.Mixtures.NUMBERS, "activity", "last_y"):
            got, want = getattr(state, name), getattr(twin, name)
            np.testing.assert_allclose(got, want, rtol=2e-4, atol=2e-4, err_msg=f"frame {frame}: {name}")


@pytest.mark.parametrize("colour", [False, True])
def test_changes_agree_with_numpy_at_every_second_pixel(colour):
    rng = np.random.default_rng(1)
    foreground = Foreground(ForegroundParams(), SHAPE)
    frames = [_frames(rng, colour, True) for _ in range(4)]
    for n, (image, disparity) in enumerate(frames[:3]):
        foreground.update(image.reshape(*SHAPE, -1), np.reshape(disparity, SHAPE), 0.1 * n)
    found = foreground.changed(frames[3][0].reshape(*SHAPE, -1), 2)
    pixels = reference.observe(frames[3][0], None, foreground._constants())
    expected = reference.changes(_mixtures(foreground), pixels, foreground._constants()).reshape(SHAPE)[::2, ::2]
    np.testing.assert_array_equal(found, expected)
    assert 0 < (found > 0).mean() < 1


def test_blocks_learn_only_in_their_turn():
    foreground = Foreground(ForegroundParams(), (1, 3 * BLOCK))
    image = np.full((1, 3 * BLOCK), 100, np.uint8)
    foreground.update(image, None, 0.0)
    rates = np.zeros((TURNS, 4), np.float32)
    rates[1] = 0.5
    before = foreground._lead.copy()
    empty = np.zeros(0, np.uint8)
    kernels.update_blocks(
        foreground._lead, foreground._rest, (image + 2).reshape(-1), np.zeros(0, np.float32), empty, empty,
        foreground._mask, 0, 3, foreground._constants(), rates,
    )  # fmt: skip
    changed = (foreground._lead != before).any(axis=1)
    assert changed.tolist() == [False, True, False]


def test_rebase_brings_means_into_the_exposure_of_the_image():
    foreground = Foreground(ForegroundParams(), SHAPE)
    foreground.update(np.full(SHAPE, 100, np.uint8), None, 0.0)
    kernels.rebase(foreground._lead, foreground._rest, 2.0, 5.0)
    state = _mixtures(foreground)
    assert state.y[0] == pytest.approx(205) and state.var_y[0] == pytest.approx(4 * 64)


def test_motion_is_remembered_for_a_while() -> None:
    moved_s = np.array([[0.0, 1.0, 2.0]], np.float32)
    motion = np.array([[255, 0, 0]], np.uint8)
    np.testing.assert_array_equal(moved_lately(motion, 2.5, 1.0, moved_s), [[255, 0, 255]])
    np.testing.assert_array_equal(moved_s, [[2.5, 1.0, 2.0]])
