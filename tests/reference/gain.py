"""What planview's gain kernels compute, in plain numpy."""

import numpy as np

from planview.foreground import gain as kernels


def weigh_inliers(
    model: np.ndarray, luma: np.ndarray, information: np.ndarray, gain: float, offset: float, clip: float,
    tolerance: float, step: int,
) -> tuple[int, float]:  # fmt: skip
    """Number of the pixels, of every step-th, within the tolerance of the line (clipped at both ends), and what they
    weigh."""
    expected = np.clip(gain * model[::step].astype(float) + offset, 0, clip)
    near = np.abs(np.minimum(luma[::step], clip) - expected) <= tolerance
    return int(near.sum()), float(information[::step][near].sum())


def consensus_scale(
    model: np.ndarray, luma: np.ndarray, information: np.ndarray, clip: float, tolerance: float
) -> float:
    """The smallest gain of the ladder with the largest evidence."""
    gains = np.exp(kernels.LADDER_STEP * np.arange(-kernels.LADDER_STEPS, kernels.LADDER_STEPS + 1))
    printed = [weigh_inliers(model, luma, information, g, 0.0, clip, tolerance, kernels.THINNING)[1] for g in gains]
    return float(gains[int(np.argmax(printed))]) if max(printed) > 0 else 1.0


def refine_gain(
    model: np.ndarray, luma: np.ndarray, gain: float, offset: float, clip: float, tolerance: float
) -> tuple[float, float]:
    """Least squares over the inliers, with a tolerance of three mean deviations, repeated."""
    reach = tolerance
    for _ in range(kernels.ROUNDS):
        expected = gain * model.astype(float) + offset
        inside = (expected > tolerance) & (expected < clip - tolerance) & (np.abs(luma - expected) <= reach)
        m, y, n = model[inside].astype(float), luma[inside].astype(float), int(inside.sum())
        if n < kernels.PIXELS_MIN:
            break
        a = np.array([[(m * m).sum(), m.sum()], [m.sum(), n * (1 + kernels.OFFSET_PRIOR)]])
        if np.linalg.det(a) <= 0:
            break
        rest = np.abs(y - expected[inside]).mean()
        gain, offset = np.linalg.solve(a, [(m * y).sum(), y.sum()])
        reach = min(max(3 * rest, kernels.TOLERANCE_MIN), tolerance)
    return float(gain), float(offset)
