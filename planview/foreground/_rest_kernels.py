"""Pixels whose leading Gaussian does not match, without checks; tests/reference/foreground.py defines them.

People cover few pixels, but each costs a test of all its Gaussians. They are gathered side by side, so that loops over
them run on vector registers. Loops run over all places, taken or not: a fixed number leaves no rest to be done one by
one. Indices are unsigned, which spares the test for negative ones.

Numba's cache of this file does not notice changes of the other kernel files here: change or touch all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import F32, U64
from planview.foreground._block_kernels import BLOCK, N_SCRATCH, load, observed
from planview.foreground._gaussian_kernels import (
    DEPTH_FRACTION,
    N_FIELDS,
    NO_MATCH,
    ONE,
    WEIGHT,
    ZERO,
    D,
    F,
    Real,
    UpdateConstants,
    is_nearer,
    is_other_light,
    match_kind,
)
from planview.foreground.masks import FOREGROUND, NEARER, SHADOW

# Planes of the gathered pixels: those of the scratch block, what is found, then the Gaussians, the leader first.
FAST, FOUND, KIND, BEFORE, IS_BACKGROUND, UNCLIPPED, BEHIND, MASK = range(N_SCRATCH, N_SCRATCH + 8)
FOUND_WEIGHT, FOUND_FRACTION, FOUND_D, KIND_NOW = range(MASK + 1, MASK + 5)
LEADER = KIND_NOW + 1
OTHERS = LEADER + N_FIELDS


@njit(cache=True, nogil=True)
def pick(source: F32, plane: int, places: U64, side: F32, target: int, taken: int) -> None:
    """Put the numbers of a block's plane that stand at some places beside those gathered so far."""
    values = source[plane * BLOCK : (plane + 1) * BLOCK]
    picked = side[target * BLOCK + taken : (target + 1) * BLOCK]
    for j in range(np.uintp(len(places))):
        picked[j] = values[places[j]]


@njit(cache=True, nogil=True)
def gather(lead: F32, obs: F32, places: U64, start: int, fast: Real, side: F32, chosen: U64, taken: int) -> None:
    """Put pixels of one block beside those gathered so far, which are ``taken``.

    Args:
        lead: the block's leading Gaussians. obs: its observations. start: its first pixel. fast: its fastest rate.
        places: of the pixels in the block; their pixels go to ``chosen``.
    """
    for j in range(len(places)):
        chosen[taken + j] = start + places[j]
    side[FAST * BLOCK + taken : FAST * BLOCK + taken + len(places)] = fast
    for plane in range(N_SCRATCH):
        pick(obs, plane, places, side, plane, taken)
    for f in range(N_FIELDS):
        pick(lead, f, places, side, LEADER + f, taken)


@njit(cache=True, nogil=True)
def gather_others(rest: F32, chosen: U64, taken: int, side: F32) -> None:
    """Add the other Gaussians of the gathered pixels."""
    size = len(side) // BLOCK - OTHERS
    for f in range(size):
        picked = side[(OTHERS + f) * BLOCK : (OTHERS + f + 1) * BLOCK]
        for j in range(np.uintp(taken)):
            picked[j] = rest[chosen[j] * np.uintp(size) + np.uintp(f)]


@njit(cache=True, nogil=True, error_model="numpy")
def begin_search(side: F32, s: UpdateConstants) -> None:
    """Whether what the leader does not match is (unclipped, behind) it.

    Both are background not observed so far. A surface that was clipped may turn out brighter than that; what
    appears behind the background was hidden by a person or a thing before: none can stand there.
    """
    for j in range(BLOCK):
        g, o = load(side, LEADER * BLOCK + j, BLOCK), observed(side, j)
        dd = o.d - g.d
        both = (o.d == o.d) & (g.depth_fraction >= s.min_depth_fraction)
        agree = dd * dd < s.beta * g.var_d
        unclipped = (g.var_y < ZERO) & (o.y > g.y) & (agree | (not both))
        behind = both & (not agree) & (dd < ZERO)
        side[UNCLIPPED * BLOCK + j] = ONE if unclipped else ZERO
        side[BEHIND * BLOCK + j] = ONE if behind else ZERO
        side[FOUND * BLOCK + j] = ZERO
        side[KIND * BLOCK + j] = NO_MATCH
        side[BEFORE * BLOCK + j] = side[(LEADER + WEIGHT) * BLOCK + j]
        side[IS_BACKGROUND * BLOCK + j] = ZERO


@njit(cache=True, nogil=True, error_model="numpy")
def test_other(side: F32, other: int, s: UpdateConstants) -> None:
    """How pixels match their Gaussian number ``other``, from 1: KIND_NOW."""
    others = side[(LEADER + other * N_FIELDS) * BLOCK :]
    for j in range(BLOCK):
        side[KIND_NOW * BLOCK + j] = match_kind(load(others, j, BLOCK), observed(side, j), s)


@njit(cache=True, nogil=True)
def keep_first(side: F32, other: int, s: UpdateConstants) -> None:
    """Where Gaussian ``other`` is the first one that matches it is FOUND.

    It is in the background set if those before it have at most the weight T together.
    """
    others = side[(LEADER + other * N_FIELDS) * BLOCK :]
    number = F(other)
    for j in range(BLOCK):
        kind, weight = side[KIND_NOW * BLOCK + j], others[WEIGHT * BLOCK + j]
        before, left = side[BEFORE * BLOCK + j], ONE - side[(LEADER + WEIGHT) * BLOCK + j]
        # All is read before it is chosen from: a branch that reads would not run on vectors.
        found, old_kind, is_background = (
            side[FOUND * BLOCK + j],
            side[KIND * BLOCK + j],
            side[IS_BACKGROUND * BLOCK + j],
        )
        old_weight, old_fraction = side[FOUND_WEIGHT * BLOCK + j], side[FOUND_FRACTION * BLOCK + j]
        old_d, share = side[FOUND_D * BLOCK + j], left * weight
        fraction, d = others[DEPTH_FRACTION * BLOCK + j], others[D * BLOCK + j]
        hit = (found == ZERO) & (weight > ZERO) & (kind != NO_MATCH)
        first = ONE if before <= s.background_weight else ZERO
        side[FOUND * BLOCK + j] = number if hit else found
        side[KIND * BLOCK + j] = kind if hit else old_kind
        side[IS_BACKGROUND * BLOCK + j] = first if hit else is_background
        side[FOUND_WEIGHT * BLOCK + j] = share if hit else old_weight
        side[FOUND_FRACTION * BLOCK + j] = fraction if hit else old_fraction
        side[FOUND_D * BLOCK + j] = d if hit else old_d
        side[BEFORE * BLOCK + j] = before + share


@njit(cache=True, nogil=True)
def keep_deepest(side: F32, other: int, s: UpdateConstants) -> None:
    """Take the mark of the deepest, in MASK, from pixels whose Gaussian ``other`` has depth, weight and is deeper."""
    gaussian = side[(LEADER + other * N_FIELDS) * BLOCK :]
    for j in range(BLOCK):
        lead_weight = side[(LEADER + WEIGHT) * BLOCK + j]
        share = (ONE - lead_weight) * gaussian[WEIGHT * BLOCK + j]
        weight = lead_weight if other == 0 else share
        deep = (weight > s.deepest_weight) & (gaussian[DEPTH_FRACTION * BLOCK + j] >= s.min_depth_fraction)
        deeper = deep & (gaussian[D * BLOCK + j] < side[FOUND_D * BLOCK + j])
        mark = side[MASK * BLOCK + j]
        side[MASK * BLOCK + j] = ZERO if deeper else mark


@njit(cache=True, nogil=True)
def find_deepest(side: F32, gaussians: int, s: UpdateConstants) -> None:
    """Add to the background set what is found and is the deepest Gaussian with depth and a weight above T_D."""
    for j in range(BLOCK):
        deep = side[FOUND_WEIGHT * BLOCK + j] > s.deepest_weight
        deep &= side[FOUND_FRACTION * BLOCK + j] >= s.min_depth_fraction
        side[MASK * BLOCK + j] = ONE if deep & (side[FOUND * BLOCK + j] > ZERO) else ZERO
    for other in range(gaussians):
        keep_deepest(side, other, s)
    for j in range(BLOCK):
        side[IS_BACKGROUND * BLOCK + j] = max(side[IS_BACKGROUND * BLOCK + j], side[MASK * BLOCK + j])


@njit(cache=True, nogil=True, error_model="numpy")
def classify(side: F32, s: UpdateConstants) -> None:
    """MASK of pixels: FOREGROUND, NEARER, SHADOW or 0."""
    darkest = s.colour_shadow_ratio
    for j in range(BLOCK):
        g, o = load(side, LEADER * BLOCK + j, BLOCK), observed(side, j)
        value = F(NEARER) if is_nearer(g, o, s) else F(FOREGROUND)
        dim = (o.d != o.d) & (o.y < g.y) & (darkest > ZERO)
        value = F(SHADOW) if dim & is_other_light(g, o, o.chroma > ZERO, darkest, s) else value
        background = (side[UNCLIPPED * BLOCK + j] > ZERO) | (side[IS_BACKGROUND * BLOCK + j] > ZERO)
        side[MASK * BLOCK + j] = ZERO if background else value


@njit(cache=True, nogil=True)
def find_matches(side: F32, s: UpdateConstants) -> None:
    """Which of their other Gaussians the gathered pixels match, and what they are."""
    gaussians = (len(side) // BLOCK - LEADER) // N_FIELDS
    begin_search(side, s)
    for other in range(1, gaussians):
        test_other(side, other, s)
        keep_first(side, other, s)
    find_deepest(side, gaussians, s)
    classify(side, s)
