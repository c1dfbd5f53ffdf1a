"""Kernels of the foreground against their numpy twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import foreground as reference

from planview.foreground import _kernels as kernels
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams

SHAPE = (7, 31)
N = SHAPE[0] * SHAPE[1]
START = np.float32([[1, 1, 1, 0]])


def _frames(rng: np.random.Generator, colour: bool, depth: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """A background with noise, a blob of other colour and depth, clipped, dark and depthless pixels."""
    base = np.linspace(0, 300, N).clip(0, 255)[:, None] + rng.normal(0, 3, (N, 3)) + rng.choice([0, 0, 0, -60, 80])
    base[rng.integers(0, N) :][:40] += rng.normal(0, 60, 3)
    disparity = np.full(N, 20.0) + rng.normal(0, 0.3, N) + rng.choice([0, 0, 0, 8, -8], N)
    disparity[rng.random(N) < 0.3] = np.nan
    image = base.clip(0, 255).astype(np.uint8)
    return (image if colour else image[:, 0].copy()), (disparity.astype(np.float32) if depth else None)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    colour=st.booleans(),
    depth=st.booleans(),
    feedback=st.booleans(),
    k=st.integers(2, 5),
    shadows=st.booleans(),
)
def test_kernels_agree_with_numpy(seed, colour, depth, feedback, k, shadows):
    rng = np.random.default_rng(seed)
    params = ForegroundParams(gaussians=k, remove_colour_shadows=shadows)
    foreground = Foreground(params, SHAPE)
    model, constants, mask = foreground._model, foreground._constants(), np.empty(SHAPE, np.uint8)
    for frame in range(12):
        image, disparity = _frames(rng, colour, depth)
        known = rng.integers(0, 3, N).astype(np.uint8) if feedback and frame else np.zeros(N, np.uint8)
        rates = np.float32([0.1, 0.2, 0.3, 0.1] if frame % 3 else [0, 0, 0, 0])
        depths = np.full(N, np.nan, np.float32) if disparity is None else disparity
        images = kernels.FrameArrays(image.reshape(*SHAPE, -1), depths.reshape(SHAPE), known.reshape(SHAPE))
        pixels = reference.observe(image, disparity, constants)
        counted = kernels.count_shown(model, images, constants, 1)
        kernels.update(model, images, mask, constants, rates[None] if frame else START)
        if frame == 0:
            twin = reference.start(pixels, k, constants)
        else:
            assert counted == (N, *reference.count_shown(twin, pixels, constants))
            expected = reference.update(twin, pixels, known, constants, reference.Rates(*rates))
            np.testing.assert_array_equal(mask.reshape(N), expected)
        used = twin.gaussians["weight"] > 0
        for name in kernels.GAUSSIAN.names:
            got, want = (np.where(used, a[name].reshape(used.shape), 0) for a in (model.gaussians, twin.gaussians))
            np.testing.assert_allclose(got, want, rtol=2e-4, atol=2e-4, err_msg=f"frame {frame}: {name}")
        for got, want in zip(model[1:], twin[1:], strict=True):
            np.testing.assert_allclose(got.reshape(N), want, rtol=2e-4, atol=2e-4, err_msg=f"frame {frame}")
