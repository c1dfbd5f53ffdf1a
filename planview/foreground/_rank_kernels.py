"""Order of a mixture's Gaussians, without checks; tests/reference/foreground.py defines it."""

from __future__ import annotations

from numba import njit

from calib.types import F32
from planview.foreground._block_kernels import BLOCK
from planview.foreground._gaussian_kernels import N_FIELDS, ONE, VAR_Y, WEIGHT, ZERO, Real


@njit(cache=True, nogil=True)
def outranks(weight: Real, var: Real, other_weight: Real, other_var: Real) -> bool:
    """Whether weight / sigma exceeds that of another Gaussian, without square roots."""
    return bool(weight * weight * abs(other_var) > other_weight * other_weight * abs(var))


@njit(cache=True, nogil=True)
def sort_rest(rest: F32, first: int, end: int) -> None:
    """Sort Gaussians by decreasing weight / luma deviation (insertion sort, stable)."""
    for start in range(first + N_FIELDS, end, N_FIELDS):
        b = start
        while b > first and outranks(
            rest[b + WEIGHT], rest[b + VAR_Y], rest[b - N_FIELDS + WEIGHT], rest[b - N_FIELDS + VAR_Y]
        ):
            for f in range(b, b + N_FIELDS):
                rest[f], rest[f - N_FIELDS] = rest[f - N_FIELDS], rest[f]
            b -= N_FIELDS


@njit(cache=True, nogil=True, error_model="numpy")
def settle_order(lead: F32, i: int, rest: F32, first: int, end: int) -> None:
    """Normalise the true weights, put the mixture in order and turn the weights of the rest into shares."""
    total = lead[WEIGHT * BLOCK + i]
    for b in range(first, end, N_FIELDS):
        total += rest[b + WEIGHT]
    scale = ONE / total
    lead[WEIGHT * BLOCK + i] *= scale
    for b in range(first, end, N_FIELDS):
        rest[b + WEIGHT] *= scale
    sort_rest(rest, first, end)
    if outranks(rest[first + WEIGHT], rest[first + VAR_Y], lead[WEIGHT * BLOCK + i], lead[VAR_Y * BLOCK + i]):
        for f in range(N_FIELDS):
            rest[first + f], lead[f * BLOCK + i] = lead[f * BLOCK + i], rest[first + f]
        sort_rest(rest, first, end)
    left = ONE - lead[WEIGHT * BLOCK + i]
    inv_left = ONE / left if left > ZERO else ZERO
    for b in range(first, end, N_FIELDS):
        rest[b + WEIGHT] *= inv_left
