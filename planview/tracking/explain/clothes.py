"""Colours of the clothes that people wear, learned and compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.types import F32, F64, I64, U8
from planview.maps.view import CODES, smoothing
from planview.tracking.explain.explanation import Owners
from planview.tracking.explain.samples import LEGS_TO, PARTS, TINY, TORSO_TO

SMOOTHING = smoothing()
PRIOR_FRAMES = 2.0
"""Weight of anybody's colours compared with those seen [frames]."""
COLOURED_FRAMES_MIN = 5
"""Frames from which on colours distinguish people."""
RATIO_MAX = 20.0
"""Largest ratio of a person's colours to anybody's."""
PART_PIXELS_MIN = 5
"""A part of the body with no more pixels than this shows no colour."""
PART_MAX = 2.0
"""Largest evidence of the colours of one part of a body, as log-odds: light differs within a room."""
PART_SAMPLES = 10.0
"""Independent samples that the colours of a part are worth when people are recognised (our choice)."""
OTHERS_SHARE = 0.8
"""Share of the others seen so far in the colours of a stranger; the rest is any colour alike."""
DOUBT_FRAMES = 0.5
"""Weight of a stranger's colours compared with those seen of a person: one frame shows most of the clothes."""


@dataclass(eq=False)
class Clothes:
    """Colours of a person's legs, torso and head.

    Attributes:
        histograms: (PARTS, CODES) float32, sums of normalised histograms.
        densities: (PARTS, CODES) float32 of colours, with those of neighbouring codes and of anybody.
        frames: number of frames in which colours were learned.
    """

    histograms: F32 = field(default_factory=lambda: np.zeros((PARTS, CODES), np.float32))
    densities: F32 = field(default_factory=lambda: np.full((PARTS, CODES), 1 / CODES, np.float32))
    frames: int = 0

    @property
    def distinguish(self) -> bool:
        """True once enough colours are learned to distinguish people."""
        return self.frames >= COLOURED_FRAMES_MIN

    def learn(self, counts: F32) -> None:
        """Add the (PARTS, CODES) colours of a frame's pixels that the person surely owns."""
        pixels = counts.sum(axis=1, keepdims=True)
        seen = pixels[:, 0] > PART_PIXELS_MIN
        self.histograms[seen] += counts[seen] / pixels[seen]
        self.frames += bool(seen.any())
        mass = self.histograms @ SMOOTHING + PRIOR_FRAMES / CODES
        self.densities = mass / mass.sum(axis=1, keepdims=True)

    def log_odds_same(self, other: Clothes, stranger: F64) -> float:
        """Log-odds that two tracks show the clothes of one person rather than of two; 0 where there are none.

        The overlap of their colours is compared with that of either with the colours of a stranger (PARTS, CODES).
        """
        own_colours, own_weight = self._blend(stranger)
        other_colours, other_weight = other._blend(stranger)
        samples = PART_SAMPLES * (own_weight * other_weight)
        both = _log_overlap(own_colours, other_colours)
        apart = 0.5 * (_log_overlap(own_colours, stranger) + _log_overlap(other_colours, stranger))
        return float(np.clip(samples * (both - apart), -PART_MAX, PART_MAX).sum())

    def _blend(self, stranger: F64) -> tuple[F64, F64]:
        """(PARTS, CODES) shares of the colours, and (PARTS,) how much of them was seen; the rest is a stranger's."""
        seen = self.histograms @ SMOOTHING
        frames = seen.sum(axis=1)
        colours = (seen + DOUBT_FRAMES * stranger) / (frames[:, None] + DOUBT_FRAMES)
        return colours, frames / (frames + DOUBT_FRAMES)


def _log_overlap(one: F64, other: F64) -> F64:
    """(PARTS,) logarithm of the Bhattacharyya coefficient of two (PARTS, CODES) densities."""
    return np.asarray(np.log(np.sqrt(one * other).sum(axis=1)))


def stranger_colours(others: Sequence[Clothes]) -> F64:
    """(PARTS, CODES) shares of the colours of a stranger, who dresses as the others seen so far."""
    histograms = np.array([clothes.histograms for clothes in others], np.float64).reshape(-1, PARTS, CODES)
    seen = histograms @ SMOOTHING
    frames = seen.sum(axis=2, keepdims=True)
    wearers = (frames > 0).sum(axis=0)
    mean = (seen / np.maximum(frames, TINY)).sum(axis=0) / np.maximum(wearers, 1)
    share = OTHERS_SHARE * (wearers > 0)
    return np.asarray(share * mean + (1.0 - share) / CODES)


def colour_counts(n: int, owner: I64, heights: F64 | F32, codes: U8) -> F32:
    """(n, PARTS, CODES) float32: number of pixels by owner, part of the body and colour; ``heights`` are relative."""
    part = (heights >= LEGS_TO).astype(np.int64) + (heights >= TORSO_TO)
    counts = np.bincount((owner * PARTS + part) * CODES + codes, minlength=n * PARTS * CODES)
    return counts.reshape(n, PARTS, CODES).astype(np.float32)


def owned_colours(person: int, owners: Sequence[Owners]) -> tuple[F64, float]:
    """(PARTS, CODES) shares of the colours of a person's pixels, and how many patches these pixels are."""
    total = np.zeros((PARTS, CODES))
    patches = 0.0
    for in_view in owners:
        pixels = np.flatnonzero((in_view.owner == person) & (in_view.share > 0.3))
        one = np.zeros_like(pixels)
        total += colour_counts(1, one, in_view.height[pixels], in_view.colours[pixels])[0]
        patches += float(in_view.patches[pixels].sum())
    return total / max(total.sum(), 1.0), patches


def colour_ratios(wardrobe: Sequence[Clothes]) -> F32:
    """(N, PARTS, CODES) float32: colours of each person's clothes over those of anybody."""
    if not wardrobe:
        return np.ones((0, PARTS, CODES), np.float32)
    densities = np.stack([clothes.densities for clothes in wardrobe])
    anybody = 0.5 * densities.mean(axis=0) + 0.5 / CODES
    return np.asarray(np.clip(densities / anybody, 1 / RATIO_MAX, RATIO_MAX), dtype=np.float32)
