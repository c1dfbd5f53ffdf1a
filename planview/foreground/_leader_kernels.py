"""Blocks of pixels against their leading Gaussians, without checks; tests/reference/foreground.py defines them.

Numba's cache of this file does not notice changes of the other kernel files here: change or touch all.
"""

from __future__ import annotations

from numba import njit

from calib.types import F32
from planview.foreground._block_kernels import (
    ACTIVITY,
    BLOCK,
    FEEDBACK,
    KIND_LEADER,
    LAST_Y,
    MEASURED,
    RATE_M,
    RATE_W,
    UNMATCHED,
    load,
    observed,
    store,
)
from planview.foreground._gaussian_kernels import (
    NO_MATCH,
    ONE,
    SAME,
    VAR_U,
    VAR_V,
    VAR_Y,
    WEIGHT,
    ZERO,
    F,
    Rates,
    U,
    UpdateConstants,
    V,
    Y,
    colour_distance,
    learned,
    match_kind,
)
from planview.foreground.masks import BACKGROUND, PERSON


@njit(cache=True, nogil=True, error_model="numpy")
def match_leaders(lead: F32, obs: F32, s: UpdateConstants) -> None:
    """Test a block of pixels against their leading Gaussian: no branches, so that it vectorises."""
    for i in range(BLOCK):
        kind = match_kind(load(lead, i, BLOCK), observed(obs, i), s)
        obs[KIND_LEADER * BLOCK + i] = kind
        obs[UNMATCHED * BLOCK + i] = obs[MEASURED * BLOCK + i] if kind == NO_MATCH else ZERO


@njit(cache=True, nogil=True)
def set_rates(lead: F32, obs: F32, s: UpdateConstants, rates: Rates) -> None:
    """How much each pixel of a block learns.

    Activity slows learning (Harville et al. 2001), a person stops it, and known background learns fast (Harville 2002,
    ECCV).
    """
    for i in range(BLOCK):
        y = obs[Y * BLOCK + i]
        before = lead[ACTIVITY * BLOCK + i]
        activity = before + rates.activity * (abs(y - lead[LAST_Y * BLOCK + i]) - before)
        lead[ACTIVITY * BLOCK + i] = activity
        lead[LAST_Y * BLOCK + i] = y
        feedback = obs[FEEDBACK * BLOCK + i]
        slow = s.slow_active if activity > s.active else ONE
        slow = ZERO if feedback == F(PERSON) else slow
        known = feedback == F(BACKGROUND)
        obs[RATE_W * BLOCK + i] = rates.fast if known else rates.weight * slow
        obs[RATE_M * BLOCK + i] = rates.fast if known else rates.mean * slow


@njit(cache=True, nogil=True, error_model="numpy")
def learn_leaders(lead: F32, obs: F32, s: UpdateConstants, rates: Rates, depth: bool) -> None:
    """Test a block of pixels against their leading Gaussian and learn where it matches.

    No branches, so that it vectorises, and several short loops, since more of a short one is under way at a time.
    Without depth a Gaussian's disparity, its fraction and its variance stay what they are.
    """
    set_rates(lead, obs, s, rates)
    if not depth:
        match_colours(lead, obs, s)
        learn_colours(lead, obs, s)
        return
    match_leaders(lead, obs, s)
    for i in range(BLOCK):
        kind, rate_w = obs[KIND_LEADER * BLOCK + i], obs[RATE_W * BLOCK + i]
        weight = lead[WEIGHT * BLOCK + i]
        lead[WEIGHT * BLOCK + i] = weight + (rate_w * (ONE - weight) if kind != NO_MATCH else ZERO)
        g = learned(load(lead, i, BLOCK), observed(obs, i), kind, obs[RATE_M * BLOCK + i], s)
        store(lead, i, BLOCK, g)


@njit(cache=True, nogil=True, error_model="numpy")
def match_colours(lead: F32, obs: F32, s: UpdateConstants) -> None:
    """As ``match_leaders``, where no pixel has depth: colour alone decides, and fewer planes are read."""
    for i in range(BLOCK):
        g, o = load(lead, i, BLOCK), observed(obs, i)
        kind = SAME if colour_distance(g, o, s) < s.beta else NO_MATCH
        obs[KIND_LEADER * BLOCK + i] = kind
        obs[UNMATCHED * BLOCK + i] = obs[MEASURED * BLOCK + i] if kind == NO_MATCH else ZERO


@njit(cache=True, nogil=True, error_model="numpy")
def learn_colours(lead: F32, obs: F32, s: UpdateConstants) -> None:
    """What ``learn_leaders`` teaches leaders that match, where no pixel has depth."""
    for i in range(BLOCK):
        kind, rate_w = obs[KIND_LEADER * BLOCK + i], obs[RATE_W * BLOCK + i]
        weight = lead[WEIGHT * BLOCK + i]
        lead[WEIGHT * BLOCK + i] = weight + (rate_w * (ONE - weight) if kind != NO_MATCH else ZERO)
        g = learned(load(lead, i, BLOCK), observed(obs, i), kind, obs[RATE_M * BLOCK + i], s)
        lead[Y * BLOCK + i], lead[VAR_Y * BLOCK + i] = g.y, g.var_y
        lead[U * BLOCK + i], lead[VAR_U * BLOCK + i] = g.u, g.var_u
        lead[V * BLOCK + i], lead[VAR_V * BLOCK + i] = g.v, g.var_v
