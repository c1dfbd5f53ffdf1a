"""Compiled kernels of the human-model tracker; ``tests/reference/human_model.py`` defines them in plain numpy.

A model is drawn as row spans ``left[y] <= x < right[y]`` for ``top <= y < bottom``. The map's columns (see
``planview.tracking.human_model.model_map``) come as ``index, origin_u, origin_v, step, foot, hull``.
"""

import math

from numba import njit

from calib.types import F32, F64, I32, I64, U8


@njit(cache=True, nogil=True)
def fill_spans(  # type: ignore[no-untyped-def]
    index: I32, origin_u: int, origin_v: int, step: int, foot: F32, hull: F32,
    u: float, v: float, scale: float, width: int, left: I32, right: I32,
):  # fmt: skip
    """Rows of the model with its foot at (u, v): the nearest map entry, moved and scaled about the foot.

    Fills ``left`` and ``right`` (H,) and returns (top, bottom), (0, 0) where no person is possible.
    """
    col = math.floor((u - origin_u) / step + 0.5)
    row = math.floor((v - origin_v) / step + 0.5)
    if row < 0 or col < 0 or row >= index.shape[0] or col >= index.shape[1] or index[row, col] < 0:
        return 0, 0
    entry = index[row, col]
    shape = hull[entry]
    du, dv = u - scale * foot[entry, 0], v - scale * foot[entry, 1]
    low, high = shape[0, 1], shape[0, 1]
    for k in range(1, shape.shape[0]):
        low = min(low, shape[k, 1])
        high = max(high, shape[k, 1])
    top = max(0, math.ceil(scale * low + dv))
    bottom = min(left.shape[0], math.floor(scale * high + dv) + 1)
    if top >= bottom:
        return 0, 0
    for y in range(top, bottom):
        left[y] = width
        right[y] = 0
    n = shape.shape[0]
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
def paint(image: U8, left: I32, right: I32, top: int, bottom: int, amount: int) -> None:
    """Add ``amount`` to the pixels of a model."""
    for y in range(top, bottom):
        for x in range(left[y], right[y]):
            image[y, x] += amount


@njit(cache=True, nogil=True)
def row_prefix(foreground: U8, cover: U8, top: int, bottom: int, x0: int, x1: int, rest: I32, taken: I32) -> None:
    """Running sums along rows, from column x0: foreground that no model covers, and pixels that one covers.

    ``foreground`` is 2 where salient, 1 where less salient, 0 where background. ``rest[y, x]`` and ``taken[y, x]``
    (H, W + 1) sum the columns x0 to x - 1.
    """
    for y in range(top, bottom):
        n_rest, n_taken = 0, 0
        rest[y, x0] = 0
        taken[y, x0] = 0
        for x in range(x0, x1):
            if cover[y, x] > 0:
                n_taken += 1
            else:
                n_rest += foreground[y, x]
            rest[y, x + 1] = n_rest
            taken[y, x + 1] = n_taken


@njit(cache=True, nogil=True)
def span_counts(  # type: ignore[no-untyped-def]
    rest: I32, taken: I32, left: I32, right: I32, top: int, bottom: int, x0: int, x1: int, ring: float,
):  # fmt: skip
    """(area, twice free foreground, taken pixels, twice free foreground in the ring), within columns x0 to x1.

    The ring continues each row by ``ring`` times the model's mean width on both sides.
    """
    area, n_rest, n_taken, n_ring = 0, 0, 0, 0
    for y in range(top, bottom):
        area += max(0, right[y] - left[y])
    margin = int(ring * area / max(1, bottom - top) + 0.5)
    for y in range(top, bottom):
        l, r = max(left[y], x0), min(right[y], x1)  # noqa: E741
        if l >= r:
            continue
        inner = rest[y, r] - rest[y, l]
        n_rest += inner
        n_taken += taken[y, r] - taken[y, l]
        n_ring += rest[y, min(r + margin, x1)] - rest[y, max(l - margin, x0)] - inner
    return area, n_rest, n_taken, n_ring


@njit(cache=True, nogil=True)
def gain(area: int, n_rest: int, n_taken: int, n_ring: int, reference: float, overlap: float) -> float:
    """Matching score of one model up to constants, in units of its area (equation 1).

    Free foreground raises recall and precision, background lowers precision, and foreground in the ring is half
    explained: it is the part of a person that is wider than the cylinders.
    """
    background = area - n_taken - 0.5 * n_rest
    return (0.5 * n_rest + 0.25 * n_ring - background - overlap * n_taken) / reference


@njit(cache=True, nogil=True)
def match_models(
    foreground: U8, cover: U8, rest: I32, taken: I32, left: I32, right: I32,
    index: I32, origin_u: int, origin_v: int, step: int, foot: F32, hull: F32,
    predicted: F64, scale: F64, information: F64, radius: F64, order: I64, position: F64,
    sweeps: int, ring: float, overlap: float, prior: float,
) -> None:  # fmt: skip
    """Move all models until their joint matching score is highest (coordinate ascent, coarse to fine).

    ``predicted`` (N, 2) foot pixels; ``information`` (N, 3) inverse covariance (uu, uv, vv) [1/px^2]; ``radius`` (N, 2)
    search [px]. Fills ``position`` (N, 2), and ``cover`` with the number of models on each pixel; the
    models that it holds already stay where they are.
    """
    height, width = foreground.shape
    for t in range(len(scale)):
        position[t, 0], position[t, 1] = predicted[t, 0], predicted[t, 1]
        top, bottom = fill_spans(
            index, origin_u, origin_v, step, foot, hull, position[t, 0], position[t, 1], scale[t], width, left, right
        )
        paint(cover, left, right, top, bottom, 1)
    for _ in range(sweeps):
        for t in order:
            top, bottom = fill_spans(
                index, origin_u, origin_v, step, foot, hull, position[t, 0], position[t, 1], scale[t], width,
                left, right,
            )  # fmt: skip
            paint(cover, left, right, top, bottom, -1)
            x0, x1, y0, y1 = _search_window(
                left, right, top, bottom, position[t], predicted[t], radius[t], ring, width, height
            )
            row_prefix(foreground, cover, y0, y1, x0, x1, rest, taken)
            _search(
                rest, taken, left, right, index, origin_u, origin_v, step, foot, hull, predicted[t], scale[t],
                information[t], radius[t], position[t], x0, x1, y0, y1, ring, overlap, prior,
            )  # fmt: skip
            top, bottom = fill_spans(
                index, origin_u, origin_v, step, foot, hull, position[t, 0], position[t, 1], scale[t], width,
                left, right,
            )  # fmt: skip
            paint(cover, left, right, top, bottom, 1)


@njit(cache=True, nogil=True)
def _search_window(  # type: ignore[no-untyped-def]
    left: I32, right: I32, top: int, bottom: int, position: F64, predicted: F64, radius: F64, ring: float,
    width: int, height: int,
):  # fmt: skip
    """Columns and rows that any candidate may touch."""
    x0, x1 = width, 0
    for y in range(top, bottom):
        x0 = min(x0, left[y])
        x1 = max(x1, right[y])
    grow_u = radius[0] + abs(position[0] - predicted[0]) + (0.3 + ring) * max(0, x1 - x0) + 2
    grow_v = radius[1] + abs(position[1] - predicted[1]) + 0.3 * (bottom - top) + 2
    low_u, high_u = max(0, int(x0 - grow_u)), min(width, int(x1 + grow_u))
    return low_u, high_u, max(0, int(top - grow_v)), min(height, int(bottom + grow_v))


@njit(cache=True, nogil=True)
def _search(
    rest: I32, taken: I32, left: I32, right: I32,
    index: I32, origin_u: int, origin_v: int, step: int, foot: F32, hull: F32,
    predicted: F64, scale: float, information: F64, radius: F64, position: F64,
    x0: int, x1: int, y0: int, y1: int, ring: float, overlap: float, prior: float,
) -> None:  # fmt: skip
    """Best position of one model around its prediction: a 7x7 grid, then halved steps down to half a pixel."""
    width = rest.shape[1] - 1
    top, bottom = fill_spans(
        index, origin_u, origin_v, step, foot, hull, predicted[0], predicted[1], scale, width, left, right
    )
    reference = 1.0
    for y in range(top, bottom):
        reference += max(0, right[y] - left[y])
    best, best_u, best_v = -1e9, predicted[0], predicted[1]
    du, dv = max(0.5, radius[0] / 3), max(0.5, radius[1] / 3)
    centre_u, centre_v, reach = predicted[0], predicted[1], 3
    while True:
        for i in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                u, v = centre_u + i * du, centre_v + j * dv
                top, bottom = fill_spans(index, origin_u, origin_v, step, foot, hull, u, v, scale, width, left, right)
                top, bottom = max(top, y0), min(bottom, y1)
                if top >= bottom:
                    continue
                counts = span_counts(rest, taken, left, right, top, bottom, x0, x1, ring)
                eu, ev = u - predicted[0], v - predicted[1]
                off = information[0] * eu * eu + 2 * information[1] * eu * ev + information[2] * ev * ev
                score = gain(counts[0], counts[1], counts[2], counts[3], reference, overlap) - prior * off
                if score > best:
                    best, best_u, best_v = score, u, v
        if du <= 0.5 and dv <= 0.5:
            break
        du, dv = max(0.5, du / 2), max(0.5, dv / 2)
        centre_u, centre_v, reach = best_u, best_v, 1
    position[0], position[1] = best_u, best_v


@njit(cache=True, nogil=True)
def score_candidates(
    rest: I32, taken: I32, left: I32, right: I32,
    index: I32, origin_u: int, origin_v: int, step: int, foot: F32, hull: F32,
    candidates: F64, ring: float, counts: I64,
) -> None:  # fmt: skip
    """Counts (see ``span_counts``) of models at (N, 3) foot pixels and scales, for new targets: fills (N, 4)."""
    width = rest.shape[1] - 1
    for i in range(len(candidates)):
        top, bottom = fill_spans(
            index, origin_u, origin_v, step, foot, hull, candidates[i, 0], candidates[i, 1], candidates[i, 2], width,
            left, right,
        )  # fmt: skip
        found = span_counts(rest, taken, left, right, top, bottom, 0, width, ring)
        for k in range(4):
            counts[i, k] = found[k]
