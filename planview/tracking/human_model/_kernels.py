"""Compiled kernels of the human-model tracker; ``tests/reference/human_model.py`` defines them in plain numpy.

A model is rasterised as row spans ``left[y] <= x < right[y]`` for ``top <= y < bottom``.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I32, I64, U8

TAKEN_BIT, HIDDEN_BIT = 20, 40
"""Three running sums share an int64, since they are always read together: their differences along a row do not borrow
from one another. Rows are shorter than 2^19 pixels."""
LOW_BITS = (1 << TAKEN_BIT) - 1


class MapArrays(NamedTuple):
    """Columns of a human model map (see ``model_map.HumanModelMap``).

    Attributes:
        entries: (rows, cols) entry of a node, -1 where no person is possible.
        origin_u, origin_v: pixel of node (0, 0); step: distance of nodes [px].
        foot: (N, 2) foot pixels; hull: (N, K, 2) outlines [px].
    """

    entries: I32
    origin_u: int
    origin_v: int
    step: int
    foot: F32
    hull: F32


class Spans(NamedTuple):
    """Workspace for one model: (H,) first column and the one after the last of every row."""

    left: I32
    right: I32


class Window(NamedTuple):
    """Columns x0 <= x < x1 and rows y0 <= y < y1 [px]."""

    x0: int
    x1: int
    y0: int
    y1: int


class MatchCounts(NamedTuple):
    """What a model covers: its area, twice its free foreground, pixels taken by others, twice the ring's foreground,
    free pixels hidden by the scene."""

    area: int
    free: int
    taken: int
    ring: int
    hidden: int


class Weights(NamedTuple):
    """Of the matching score: width of the ring, price of a pixel covered twice, price of a squared deviation."""

    ring: float
    overlap: float
    prior: float


class Predictions(NamedTuple):
    """Targets to be matched.

    Attributes:
        foot: (N, 2) predicted foot pixels; scale: (N,) heights over the average.
        information: (N, 3) inverse covariance (uu, uv, vv) [1/px^2]; radius: (N, 2) search [px].
        order: (N,) which target claims pixels first.
    """

    foot: F64
    scale: F64
    information: F64
    radius: F64
    order: I64


@njit(cache=True, nogil=True)
def fill_spans(people: MapArrays, u: float, v: float, scale: float, width: int, spans: Spans) -> tuple[int, int]:
    """Rows of the model with its foot at (u, v): the nearest map entry, moved and scaled about the foot.

    Fills ``spans`` and returns (top, bottom), (0, 0) where no person is possible.
    """
    left, right = spans.left, spans.right
    col = math.floor((u - people.origin_u) / people.step + 0.5)
    row = math.floor((v - people.origin_v) / people.step + 0.5)
    if (
        row < 0
        or col < 0
        or row >= people.entries.shape[0]
        or col >= people.entries.shape[1]
        or people.entries[row, col] < 0
    ):
        return 0, 0
    entry = people.entries[row, col]
    shape = people.hull[entry]
    du, dv = u - scale * people.foot[entry, 0], v - scale * people.foot[entry, 1]
    n = shape.shape[0]
    low, high = shape[0, 1], shape[0, 1]
    for k in range(n):
        low = min(low, shape[k, 1])
        high = max(high, shape[k, 1])
    top = max(0, math.ceil(scale * low + dv))
    bottom = min(left.shape[0], math.floor(scale * high + dv) + 1)
    if top >= bottom:
        return 0, 0
    for y in range(top, bottom):
        left[y] = width
        right[y] = 0
    for k in range(n):
        after = k + 1 if k + 1 < n else 0
        x0, y0 = scale * shape[k, 0] + du, scale * shape[k, 1] + dv
        x1, y1 = scale * shape[after, 0] + du, scale * shape[after, 1] + dv
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        first, last = max(top, math.ceil(y0)), min(bottom - 1, math.floor(y1))
        slope = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
        for y in range(first, last + 1):
            x = x0 + slope * (y - y0)
            left[y] = min(left[y], max(0, math.ceil(x)))
            right[y] = max(right[y], min(width, math.floor(x) + 1))
    return top, bottom


@njit(cache=True, nogil=True)
def paint(image: U8, spans: Spans, top: int, bottom: int, amount: int) -> None:
    """Add ``amount`` to the pixels of a model."""
    for y in range(top, bottom):
        for x in range(spans.left[y], spans.right[y]):
            image[y, x] += amount


@njit(cache=True, nogil=True)
def row_prefix(foreground: U8, cover: U8, hiding: U8, window: Window, sums: I64) -> int:
    """Running sums along the rows of a window, from its first column; returns how many pixels models cover there.

    ``foreground`` is 2 where salient, 1 where less salient, 0 where background; ``hiding`` is not 0 where the scene
    hides people. ``sums[y, x]`` (H, W + 1) sums the columns x0 to x - 1: in its low bits the foreground that no model
    covers, from ``TAKEN_BIT`` pixels that one covers, from ``HIDDEN_BIT`` the others that the scene hides.
    """
    n_taken = 0
    for y in range(window.y0, window.y1):
        total = 0
        sums[y, window.x0] = 0
        for x in range(window.x0, window.x1):
            if cover[y, x] > 0:
                total += 1 << TAKEN_BIT
            elif foreground[y, x] > 0:
                total += foreground[y, x]
            elif hiding[y, x] > 0:
                total += 1 << HIDDEN_BIT
            sums[y, x + 1] = total
        n_taken += (total >> TAKEN_BIT) & LOW_BITS
    return n_taken


@njit(cache=True, nogil=True)
def span_counts(sums: I64, spans: Spans, top: int, bottom: int, x0: int, x1: int, ring: float) -> MatchCounts:
    """What a model covers within columns x0 to x1.

    The ring continues each row by ``ring`` times the model's mean width on both sides.
    """
    area, n_rest, n_taken, n_ring, n_hidden = 0, 0, 0, 0, 0
    for y in range(top, bottom):
        area += max(0, spans.right[y] - spans.left[y])
    margin = int(ring * area / max(1, bottom - top) + 0.5)
    for y in range(top, bottom):
        l, r = max(spans.left[y], x0), min(spans.right[y], x1)  # noqa: E741
        if l >= r:
            continue
        within = sums[y, r] - sums[y, l]
        inner = within & LOW_BITS
        n_rest += inner
        n_taken += (within >> TAKEN_BIT) & LOW_BITS
        n_hidden += within >> HIDDEN_BIT
        n_ring += ((sums[y, min(r + margin, x1)] - sums[y, max(l - margin, x0)]) & LOW_BITS) - inner
    return MatchCounts(area, n_rest, n_taken, n_ring, n_hidden)


@njit(cache=True, nogil=True)
def matching_score(counts: MatchCounts, reference: float, overlap: float) -> float:
    """M of equation 1 for one model, up to constants, in units of a reference area [px^2].

    Free foreground raises recall and precision, background lowers precision, pixels of others are overlap, and
    foreground in the ring counts half: it is the part of a person that is wider than the cylinders (our addition).
    Where the scene hides people, nothing is told either way (our addition).
    """
    background = counts.area - counts.taken - counts.hidden - 0.5 * counts.free
    return (0.5 * counts.free + 0.25 * counts.ring - background - overlap * counts.taken) / reference


@njit(cache=True, nogil=True)
def match_models(
    foreground: U8, cover: U8, hiding: U8, sums: I64, spans: Spans, people: MapArrays, targets: Predictions,
    position: F64, sweeps: int, weights: Weights,
) -> None:  # fmt: skip
    """Move all models until their joint matching score is highest (coordinate ascent, coarse to fine).

    Fills ``position`` (N, 2), and ``cover`` with the number of models on each pixel; the models that it holds already
    stay where they are.
    """
    height, width = foreground.shape
    alone = np.zeros(len(targets.scale), np.bool_)
    for t in range(len(targets.scale)):
        position[t, 0], position[t, 1] = targets.foot[t, 0], targets.foot[t, 1]
        top, bottom = fill_spans(people, position[t, 0], position[t, 1], targets.scale[t], width, spans)
        paint(cover, spans, top, bottom, 1)
    for sweep in range(sweeps):
        for t in targets.order:
            top, bottom = fill_spans(people, position[t, 0], position[t, 1], targets.scale[t], width, spans)
            paint(cover, spans, top, bottom, -1)
            window = _search_window(spans, top, bottom, position[t], targets, t, weights.ring, width, height)
            was_alone, alone[t] = alone[t], row_prefix(foreground, cover, hiding, window, sums) == 0
            # Away from all others, another sweep finds the same place.
            if sweep == 0 or not (was_alone and alone[t]):
                _search(sums, spans, people, targets, t, position[t], window, weights)
            top, bottom = fill_spans(people, position[t, 0], position[t, 1], targets.scale[t], width, spans)
            paint(cover, spans, top, bottom, 1)


@njit(cache=True, nogil=True)
def _search_window(
    spans: Spans, top: int, bottom: int, position: F64, targets: Predictions, t: int, ring: float, width: int,
    height: int,
) -> Window:  # fmt: skip
    """Columns and rows that any candidate of target t may touch."""
    x0, x1 = width, 0
    for y in range(top, bottom):
        x0 = min(x0, spans.left[y])
        x1 = max(x1, spans.right[y])
    grow_u = targets.radius[t, 0] + abs(position[0] - targets.foot[t, 0]) + (0.3 + ring) * max(0, x1 - x0) + 2
    grow_v = targets.radius[t, 1] + abs(position[1] - targets.foot[t, 1]) + 0.3 * (bottom - top) + 2
    low_u, high_u = max(0, int(x0 - grow_u)), min(width, int(x1 + grow_u))
    return Window(low_u, high_u, max(0, int(top - grow_v)), min(height, int(bottom + grow_v)))


@njit(cache=True, nogil=True)
def _search(
    sums: I64, spans: Spans, people: MapArrays, targets: Predictions, t: int, position: F64, window: Window,
    weights: Weights,
) -> None:  # fmt: skip
    """Best position of target t around its prediction: a 7x7 grid, then halved steps down to half a pixel."""
    width = sums.shape[1] - 1
    predicted, radius, scale = targets.foot[t], targets.radius[t], targets.scale[t]
    inform = targets.information[t]
    top, bottom = fill_spans(people, predicted[0], predicted[1], scale, width, spans)
    reference = 1.0
    for y in range(top, bottom):
        reference += max(0, spans.right[y] - spans.left[y])
    best, best_u, best_v = -1e9, predicted[0], predicted[1]
    du, dv = max(0.5, radius[0] / 3), max(0.5, radius[1] / 3)
    centre_u, centre_v, reach = predicted[0], predicted[1], 3
    while True:
        for i in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                if reach == 1 and i == 0 and j == 0:
                    continue
                u, v = centre_u + i * du, centre_v + j * dv
                top, bottom = fill_spans(people, u, v, scale, width, spans)
                top, bottom = max(top, window.y0), min(bottom, window.y1)
                if top >= bottom:
                    continue
                counts = span_counts(sums, spans, top, bottom, window.x0, window.x1, weights.ring)
                eu, ev = u - predicted[0], v - predicted[1]
                off = inform[0] * eu * eu + 2 * inform[1] * eu * ev + inform[2] * ev * ev
                score = matching_score(counts, reference, weights.overlap) - weights.prior * off
                if score > best:
                    best, best_u, best_v = score, u, v
        if du <= 0.5 and dv <= 0.5:
            break
        du, dv = max(0.5, du / 2), max(0.5, dv / 2)
        centre_u, centre_v, reach = best_u, best_v, 1
    position[0], position[1] = best_u, best_v


@njit(cache=True, nogil=True)
def score_candidates(
    sums: I64, spans: Spans, people: MapArrays, candidates: F64, ring: float, area: I64, free: I64, taken: I64,
    in_ring: I64, hidden: I64,
) -> None:  # fmt: skip
    """``MatchCounts`` of models at (N, 3) foot pixels and scales, filled into five (N,) columns."""
    width = sums.shape[1] - 1
    for i in range(len(candidates)):
        top, bottom = fill_spans(people, candidates[i, 0], candidates[i, 1], candidates[i, 2], width, spans)
        found = span_counts(sums, spans, top, bottom, 0, width, ring)
        area[i], free[i], taken[i], in_ring[i] = found.area, found.free, found.taken, found.ring
        hidden[i] = found.hidden
