"""Which set of ellipses explains foreground best: how many there are, and whether known objects account for them.

The paper's measurements have their number estimated, and so have ours: by the largest posterior. One more ellipse must
explain more than its share of structure in residuals (limbs, holes), over what the others explain without it once they
have moved; a known object needs less for that than a newcomer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.types import F32, F64, I64, Bool
from planview.tracking.ellipse_particle.fit import _area as kernels
from planview.tracking.ellipse_particle.fit._evidence import explained
from planview.tracking.ellipse_particle.fit._lm import Match, Prior, refine
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.groups import group, half_extents

SWEEPS = 3
"""Rounds of Levenberg-Marquardt over all ellipses. Our choice."""
ALIKE = 0.5
"""A measured ellipse may be a known object when its centre is within this share of the object's length and width of the
object's: beyond it, more of it is outside than inside. Our choice."""
REACH = 3.0
"""Ellipses farther apart than this [cells] do not share cells: a soft edge on either side. Our choice."""

CLEAR = 0.4
"""An ellipse with this gain over the others, as a share of its area, is not tried without: a silhouette with nothing
before it has 0.53. Our choice; it bounds the time."""


class Explanation(NamedTuple):
    """Ellipses (N, 5) of one group, and the logarithm of their posterior."""

    ellipses: F64
    evidence: float


class Judge(NamedTuple):
    """What sets of ellipses are judged by.

    Attributes:
        mask: (R, C) foreground share of each cell.
        prefix: its row sums (``row_prefix``).
        prior, about, match: size expected, deviations from it, how foreground is compared.
        new_gain, known_gain: least gain of an ellipse over the others, as a share of its area; that of known objects.
        known: (K, 5) where known objects are expected.
    """

    mask: F32
    prefix: F64
    prior: SizePrior
    about: Prior
    match: Match
    new_gain: float
    known_gain: float
    known: F64

    def refine(self, ellipses: F64, members: I64) -> None:
        """Levenberg-Marquardt of the members (K,) of (N, 5) ellipses against the mask, in place."""
        refine(self.mask, ellipses, members, self.prior.law, self.about, self.match, SWEEPS)

    def areas(self, ellipses: F64) -> F64:
        """(N,) area inside the grid [cells], or half of it all where less is inside."""
        inside = [kernels.ellipse_sum(self.prefix, *ellipse)[1] for ellipse in ellipses]
        return np.maximum(inside, 0.5 * np.pi * ellipses[:, 2] * ellipses[:, 3])

    def least_gains(self, ellipses: F64) -> F64:
        """(N,) gain over the others, as a share of its area, that pays for an ellipse."""
        least = np.full(len(ellipses), self.new_gain)
        least[matched(ellipses, self.known)] = self.known_gain
        return least

    def gains(self, ellipses: F64) -> F64:
        """(N,) gain of each ellipse over the others where they are, as a share of its area."""
        return own_shares(self.prefix, ellipses, self.match.background)

    def evidence(self, ellipses: F64) -> float:
        """Logarithm of the posterior of (N, 5) ellipses against none: what they explain, less what they cost."""
        if not len(ellipses):
            return 0.0
        half = self.prior.half_lengths(ellipses[:, 1])
        sizes = np.log(ellipses[:, 2:4] / np.column_stack([half, half * self.prior.aspect])) / self.about.size_spread
        unlikely = 0.5 * float((sizes**2).sum() - self.about.common * (sizes.sum(axis=1) ** 2).sum())
        unlikely += 0.5 * float(((ellipses[:, 4] / self.about.angle_spread) ** 2).sum())
        needed = 0.5 * float(self.least_gains(ellipses) @ self.areas(ellipses))
        return (explained(self.mask, ellipses, self.match) - needed) / self.match.deviation**2 - unlikely


def best_of(judge: Judge, starts: Sequence[F64]) -> F64:
    """Of several fits (N, 5) of the same mask the one that explains most, region by region, none with one too many."""
    found = np.concatenate(starts)
    origin = np.repeat(np.arange(len(starts)), [len(start) for start in starts])
    best = [found[:0]]
    for members in _regions(found):
        tried = [without_needless(judge, found[members[origin[members] == i]]) for i in range(len(starts))]
        best.append(max(tried, key=lambda explanation: explanation.evidence).ellipses)
    return np.concatenate(best)


def without_needless(judge: Judge, ellipses: F64) -> Explanation:
    """Drop, one at a time, the ellipse without which the others, moved to make up for it, explain most.

    While that is more than with it; what is clearly needed is not tried.
    """
    ellipses = _paying(judge, ellipses)
    best = Explanation(ellipses, judge.evidence(ellipses))
    while True:
        doubtful = np.flatnonzero(judge.gains(best.ellipses) < CLEAR)
        tried = [_without(judge, best, int(k)) for k in doubtful]
        next_best = max(tried, key=lambda explanation: explanation.evidence, default=best)
        if next_best.evidence <= best.evidence:
            return best
        best = next_best


def _paying(judge: Judge, ellipses: F64) -> F64:
    """Drop, one at a time, the ellipse that lacks most of its least gain: others need not even move for that."""
    while len(ellipses):
        excess = judge.gains(ellipses) - judge.least_gains(ellipses)
        worst = int(np.argmin(excess))
        if excess[worst] >= 0:
            break
        ellipses = np.delete(ellipses, worst, axis=0)
    return ellipses


def _without(judge: Judge, explanation: Explanation, k: int) -> Explanation:
    """Only ellipses near the dropped one move, so only they and their neighbours explain more or less."""
    one, rest = explanation.ellipses[k : k + 1], np.delete(explanation.ellipses, k, axis=0)
    near = np.flatnonzero(near_each_other(one, rest)[0])
    around = near_each_other(np.concatenate([one, rest[near]]), rest).any(axis=0)
    before = judge.evidence(np.concatenate([one, rest[around]]))
    judge.refine(rest, near)
    return Explanation(rest, explanation.evidence + judge.evidence(rest[around]) - before)


def _regions(ellipses: F64) -> list[I64]:
    """Indices of ellipses that may share cells, region by region."""
    near, none = near_each_other(ellipses, ellipses), np.zeros((len(ellipses), 0), np.bool_)
    return [members for members, _ in group(near, none, joint=False)]


def near_each_other(ellipses: F64, others: F64) -> Bool:
    """(N, M) whether ellipses (N, 5) may share cells with others (M, 5)."""
    offset = np.abs(ellipses[:, None, :2] - others[None, :, :2])
    reach = half_extents(ellipses)[:, None] + half_extents(others)[None] + REACH
    return np.asarray(((offset / reach) ** 2).sum(axis=-1) < 1.0)


def matched(ellipses: F64, known: F64) -> I64:
    """Indices of (N, 5) ellipses that are known objects (K, 5), one each, at the smallest distances in all."""
    offset = ellipses[:, None, :2] - known[None, :, :2]
    away = np.hypot(offset[..., 0] / (2 * known[:, 3]), offset[..., 1] / (2 * known[:, 2]))
    rows, columns = linear_sum_assignment(np.minimum(away, ALIKE))
    return np.asarray(rows[away[rows, columns] < ALIKE], dtype=np.int64)


def own_shares(prefix: F64, ellipses: F64, background_weight: float) -> F64:
    """Gain of each ellipse over the union of the others, as a share of its area, (N,) float64.

    Of an object that is cut by the border only the part inside counts, or half where less is inside.
    """
    out = np.zeros((len(ellipses), 4))
    kernels.exclusive(prefix, ellipses, out)
    value, cells = out[:, kernels.OWN_VALUE], out[:, kernels.OWN_AREA]
    area = np.clip(out[:, kernels.AREA], 0.5 * np.pi * ellipses[:, 2] * ellipses[:, 3], None)
    return np.asarray((value - background_weight * (cells - value)) / np.maximum(area, 1e-9))
