"""Compiled joint matching of models to foreground; ``tests/reference/human_model.py`` defines what it scores.

Numba's cache of this file does not notice changes of the other kernel files here: change or touch all.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F64, I64, U8, Bool
from planview.tracking.human_model._kernels import (
    MapArrays,
    Rows,
    Spans,
    Window,
    fill_spans,
    matching_score,
    paint,
    row_prefix,
    span_counts,
)


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
def match_models(
    foreground: U8, cover: U8, hiding: U8, sums: I64, spans: Spans, people: MapArrays, targets: Predictions,
    position: F64, sweeps: int, weights: Weights,
) -> None:  # fmt: skip
    """Move all models until their joint matching score is highest (coordinate ascent, coarse to fine).

    Fills ``position`` (N, 2), and ``cover`` with the number of models on each pixel; the models that it holds already
    stay where they are.
    """
    height, width = foreground.shape
    n = len(targets.scale)
    alone, stale, seen = np.zeros(n, np.bool_), np.ones(n, np.bool_), np.zeros((n, 4), np.int64)
    for t in range(n):
        position[t, 0], position[t, 1] = targets.foot[t, 0], targets.foot[t, 1]
        top, bottom, _ = fill_spans(people, position[t, 0], position[t, 1], targets.scale[t], width, spans)
        paint(cover, spans, top, bottom, 1)
    for sweep in range(sweeps):
        for t in targets.order:
            # Where no other model has changed since, another search finds the same place.
            if sweep > 0 and not stale[t]:
                continue
            u, v = position[t]
            top, bottom, _ = fill_spans(people, u, v, targets.scale[t], width, spans)
            paint(cover, spans, top, bottom, -1)
            before = _box(spans, top, bottom, width)
            window = _search_window(before, position[t], targets, t, weights.ring, width, height)
            was_alone, alone[t] = alone[t], row_prefix(foreground, cover, hiding, window, sums) == 0
            if sweep == 0 or not (was_alone and alone[t]):
                _search(sums, spans, people, targets, t, position[t], window, weights)
            top, bottom, _ = fill_spans(people, position[t, 0], position[t, 1], targets.scale[t], width, spans)
            paint(cover, spans, top, bottom, 1)
            stale[t] = False
            seen[t, 0], seen[t, 1], seen[t, 2], seen[t, 3] = window.x0, window.x1, window.y0, window.y1
            if position[t, 0] != u or position[t, 1] != v:
                _mark_stale(seen, t, before, stale)
                _mark_stale(seen, t, _box(spans, top, bottom, width), stale)


@njit(cache=True, nogil=True)
def _box(spans: Spans, top: int, bottom: int, width: int) -> Window:
    """Columns and rows of a model."""
    x0, x1 = width, 0
    for y in range(top, bottom):
        x0 = min(x0, spans.left[y])
        x1 = max(x1, spans.right[y])
    return Window(x0, x1, top, bottom)


@njit(cache=True, nogil=True)
def _mark_stale(seen: I64, moved: int, box: Window, stale: Bool) -> None:
    """Note for which targets the pixels that they were searched in, (N, 4) windows, overlap a box that changed."""
    for t in range(len(seen)):
        apart = box.x0 >= seen[t, 1] or box.x1 <= seen[t, 0] or box.y0 >= seen[t, 3] or box.y1 <= seen[t, 2]
        stale[t] |= t != moved and not apart


@njit(cache=True, nogil=True)
def _search_window(
    box: Window, position: F64, targets: Predictions, t: int, ring: float, width: int, height: int
) -> Window:
    """Columns and rows that any candidate of target t may touch."""
    x0, x1, top, bottom = box
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
    top, bottom, _ = fill_spans(people, predicted[0], predicted[1], scale, width, spans)
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
                top, bottom, legs = fill_spans(people, u, v, scale, width, spans)
                rows = Rows(max(top, window.y0), min(bottom, window.y1), legs)
                if rows.top >= rows.bottom:
                    continue
                counts = span_counts(sums, spans, rows, window.x0, window.x1, weights.ring)
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
