"""Size of people learned from regions that move and stay together: a line of length against row, uncalibrated."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.types import F32, F64, Bool
from planview.tracking.ellipse_particle.camera_size import BREADTH_M, PERSON_M
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.regions import (
    AREA,
    BESIDE,
    CUT,
    JOINED,
    LENGTH,
    MAJOR,
    MINOR,
    ROW,
    TIME_S,
    WIDTH,
    RegionPairs,
)
from planview.tracking.ellipse_particle.size_lines import deviation, line, lines, log_density, over_centres
from planview.tracking.ellipse_particle.size_samples import FILLED, alone, as_discs, from_above, lasted_s, weights

FIRST_WHOLE = 4
"""Whole regions needed before a size is used. Our choice: one person in four frames, or two in two."""
SETTING_OUT_S = 3.0
"""Time from the first frame in which people who were in it set out [s]: as long as the background needs to be known."""
SETTLED = 40
"""Whole regions from which the size is settled. Our choice: two people who walk through the view at 12 frames per
second; until then a piece of a person may be as long as people are taken for: 200 people of 195 on 28 drawn views, 215
without it."""
FIRST_CUT = 15
"""Regions cut by the border that are enough where none is whole: people may be too large ever to show as a whole."""
PER_FRAME = 12
"""Largest regions kept of a frame; a frame full of specks must not outvote the others."""
KEPT = 600
"""Samples kept, evenly thinned; bounds time and memory."""
NARROWEST, BROADEST = 0.2, 1.3
"""Width over length of a person: 0.3 m of 1.7 m from the side, shoulders over depth from straight above."""
ASPECT, ASPECT_SPREAD = BREADTH_M / PERSON_M, 0.2
"""Width over length of a person seen from the side, and the deviation of its logarithm. Our choice: drawn people have
0.23 to 0.31 from the side, and 0.31 to 0.56 in malls, from above."""
OUTLINE = 1.0
"""Deviation of a measured width [cells]: an outline is known to half a cell on either side, and what blurs it makes
people broader. Our choice."""
SMALLEST, FEW = 0.8, 0.05
"""Nobody is expected who is shorter than this share of the shortest people seen; ``FEW`` of what moves may be shorter
than these. At the horizon of a low camera, where a line has no length left, are the heads of people. Our choice."""
CUT_OFTEN = 0.25
"""Share of people cut by the border above which width is learned from the others alone. Our choice."""
NEAR = 1 / 5
"""Share of the image's height from which on, as the diameter of a disc of their area, people under a camera straight
above are so near to it that they reach outwards in all directions, over twice as long as wide. Farther ones are
compact, and upright ellipses tell groups side by side from them. Our choice: on 72 drawn bus doors, doorways and malls
95.3 % of the crossings, as with 0.15; 94.6 with 0.25, 94.9 with 0."""
ALIKE = 1.2
"""Ratio of lengths up to which a new size only refines the old one. Our choice."""
AGREE = 1.5
"""Deviations within which a region is one person's."""


class SizeBelief(NamedTuple):
    """What is known of people's size.

    Attributes:
        prior: size expected [cells of the learner's grid].
        confidence: share of what moves, by area, that lies in regions of that size, 0 to 1.
        length: of people where they were seen, the median [cells].
    """

    prior: SizePrior
    confidence: float
    length: float


class SizeLearner:
    """Collects regions that stay together while they move, and fits the size prior of the paper's section II.

    A region is one sample when the frame before had it too, of nearly the same size: what belongs together stays
    together, while pieces of a person come and go. Lines through pairs of samples, and horizontal lines, are judged by
    the likelihood of all lengths: a whole region is one person (near the line), a group in depth (longer), a piece
    (shorter) or something else; one that the border cuts may be any part of a person, and speaks only against sizes
    much smaller than itself. Regions count by area, so that the pieces of large people, which are more, do not outvote
    them; where nothing tells, a region is one person. The same region again counts less than a new one (square root of
    the number alike). The width comes from the area that single people fill, which varies less over a step than the
    width of their boxes, and from what people are like, the more the fewer cells they are wide.

    ``update`` learns while people are tracked, from samples that grow rarer; ``collect`` and ``learn`` do it from all
    frames of a recording's beginning at once.
    """

    def __init__(self, learn_s: float) -> None:
        self._learn_s = learn_s
        self._pairs = RegionPairs()
        self._samples: F64 = np.zeros((0, TIME_S + 1))
        self._frames, self._first_s = 0, 0.0
        self._collected: list[F64] = []
        self._stride = 1
        self._taken = 0
        self._is_over = False
        self._next_fit = 0
        self.belief: SizeBelief | None = None

    def update(self, mask: F32, time_s: float, moving: Bool | None = None) -> SizeBelief | None:
        """Take the regions of one frame; returns the belief so far, None while there is too little.

        Args:
            mask: (R, C) float32 foreground share of each cell.
            time_s: of the frame [s].
            moving: (R, C) cells that move; None where that is not known.
        """
        self._is_over = self._frames > 0 and time_s - self._first_s > self._learn_s and self.belief is not None
        if self._is_over:
            return self.belief
        new = self._regions(mask, time_s, moving)
        if (self._frames - 1) % self._stride:
            return self.belief
        self._taken += len(new)
        self._samples = np.concatenate([self._samples, new])
        if len(self._samples) > KEPT:
            # From now on every second of the frames so far: old and new samples stay equally dense in time.
            self._samples, self._stride = self._samples[::2], 2 * self._stride
            self._taken, self._next_fit = self._taken // 2, self._next_fit // 2
        if self._taken >= self._next_fit and self._is_enough():
            # Fits grow rarer as the samples grow: each costs time, and changes less.
            self._next_fit = self._taken + max(4, self._taken // 6)
            self._revise(self._fit(mask.shape[0]), mask.shape[0])
        return self.belief

    def collect(self, mask: F32, time_s: float, moving: Bool | None = None) -> None:
        """Keep the regions of one frame for ``learn``; arguments as of ``update``."""
        self._collected.append(self._regions(mask, time_s, moving))

    def learn(self, n_rows: int) -> SizeBelief | None:
        """The size by all regions that were collected, on a grid of so many rows; None where they are too few."""
        self._samples = np.concatenate([self._samples, *self._collected])
        self._collected.clear()
        return self._fit(n_rows) if self._is_enough() else None

    def _regions(self, mask: F32, time_s: float, moving: Bool | None) -> F64:
        """The largest regions of a frame that the frame before had too."""
        if self._frames == 0:
            self._first_s = time_s
        self._frames += 1
        # Of people who set out both edges are foreground before the rest.
        beside = BESIDE if time_s - self._first_s > SETTING_OUT_S else JOINED
        new = self._pairs.update(mask, time_s, moving, beside)
        return np.asarray(new[np.argsort(-new[:, AREA], kind="stable")[:PER_FRAME]])

    def _revise(self, new: SizeBelief | None, n_rows: int) -> None:
        """Believe a new size; one that is quite different only where it accounts for more of what moves."""
        old = self.belief
        if new is None:
            return
        turned = old is not None and old.prior.any_direction != new.prior.any_direction
        if old is None or turned or alike(old.prior, new.prior, n_rows) or new.confidence >= self._share(old.prior):
            self.belief = new

    @property
    def settled(self) -> bool:
        """Whether the size will hardly change any more, or not at all."""
        return self._is_over or self._whole() * self._stride >= SETTLED

    def _whole(self) -> int:
        """Number of the samples that the border does not cut."""
        return int(np.count_nonzero(self._samples[:, CUT] == 0))

    def _share(self, prior: SizePrior) -> float:
        """Share of the samples, by area, that are single persons of a size."""
        above = prior.any_direction
        samples = as_discs(alone(self._samples, MAJOR, MINOR)) if above else alone(self._samples)
        length = samples[:, LENGTH]
        fitted = 2 * (prior.rounded() if above else prior).half_lengths_standing(samples[:, ROW] + length / 2)
        return share_of(samples, np.log(length / fitted) / deviation(fitted))

    def _is_enough(self) -> bool:
        return self._whole() >= FIRST_WHOLE or len(self._samples) >= FIRST_CUT

    def _fit(self, n_rows: int) -> SizeBelief | None:
        if from_above(self._samples):
            belief = self._fitted(as_discs(alone(self._samples, MAJOR, MINOR)), n_rows, level=True)
            if belief is not None and belief.prior.half_length(n_rows / 2) > NEAR / 2 * n_rows:
                aspect = float(np.median(self._samples[:, MINOR] / self._samples[:, MAJOR]))
                return belief._replace(prior=lengthened(belief.prior, aspect), length=belief.length / math.sqrt(aspect))
        return self._fitted(alone(self._samples), n_rows)

    def _fitted(self, samples: F64, n_rows: int, level: bool = False) -> SizeBelief | None:
        """The size by the best of all lines, or of the level ones: from straight above rows tell nothing of size."""
        length, cut = samples[:, LENGTH], samples[:, CUT] > 0
        foot, weight = samples[:, ROW] + length / 2, weights(samples)
        levels, slopes = lines(foot, length, cut | level, n_rows)
        fitted = np.maximum(levels[:, None] + slopes[:, None] * foot, 1.0)
        best = int(np.argmax(log_density(length, samples[:, WIDTH], fitted, cut, lasted_s(samples)) @ weight))
        away = np.log(length / fitted[best]) / deviation(fitted[best])
        inliers = np.abs(away) < AGREE
        if not inliers.any():
            return None
        x, y, tilted = foot[inliers], length[inliers], bool(slopes[best] > 0)
        start, slope = over_centres(*line(x, y, weight[inliers] * np.exp(-0.5 * away[inliers] ** 2), tilted))
        # Where the border cuts many, what it leaves of them, legs from above, is thinner than people are.
        uncut = inliers & ~cut
        sized = samples[uncut if uncut.any() and cut[inliers].mean() > CUT_OFTEN else inliers]
        aspect = float(np.median(sized[:, AREA] / (FILLED * math.pi / 4 * sized[:, LENGTH] ** 2)))
        aspect = likely_aspect(aspect, float(np.median(sized[:, LENGTH])))
        least = max(1.0, SMALLEST / 2 * smallest_of(y, weight[inliers]))
        prior = SizePrior(start / 2, slope / 2, float(np.clip(aspect, NARROWEST, BROADEST)), least)
        return SizeBelief(prior, share_of(samples, away), float(np.median(y)))


def smallest_of(length: F64, weight: F64) -> float:
    """Length (N,) below which lies ``FEW`` of the weight (N,); numpy has weighted quantiles from 2.0 on only."""
    order = np.argsort(length, kind="stable")
    share = np.cumsum(weight[order])
    return float(length[order][np.searchsorted(share, FEW * share[-1])])


def likely_aspect(measured: float, length: float) -> float:
    """The most probable width over length of people who were measured to be so many cells long.

    Of people a few cells wide an outline says little: blurred, without legs and beside one another they are twice as
    broad as people are, and two of them would be one.
    """
    known, told = 1.0 / ASPECT_SPREAD**2, (measured * length / OUTLINE) ** 2
    return math.exp((known * math.log(ASPECT) + told * math.log(measured)) / (known + told))


def alike(one: SizePrior, other: SizePrior, n_rows: int) -> bool:
    """Whether two priors have lengths within ``ALIKE`` in the middle of the upper and lower half."""
    rows = np.array([0.25, 0.75]) * n_rows
    ratio = np.abs(np.log(one.half_lengths(rows) / other.half_lengths(rows)))
    return bool((ratio < math.log(ALIKE)).all())


def share_of(samples: F64, away: F64) -> float:
    """Share of the samples, by area, that lie within ``AGREE`` deviations ``away`` (N,), or are cut and shorter."""
    weight = weights(samples, 1.0)
    agreeing = (np.abs(away) < AGREE) | ((samples[:, CUT] > 0) & (away < AGREE))
    return float(weight[agreeing].sum() / weight.sum())


def lengthened(disc: SizePrior, aspect: float) -> SizePrior:
    """Ellipses of an aspect that point anywhere and have the area of discs."""
    k = 1 / math.sqrt(aspect)
    lengths = k * disc.half_length_0, k * disc.half_length_slope
    return SizePrior(*lengths, aspect, k * disc.half_length_min, any_direction=True)
