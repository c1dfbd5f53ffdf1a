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
WAIST = 0.5
"""Share of a model's rows that are below the waist: tables and backs of chairs reach up to there (our choice)."""
LEGS_COST = 0.8
"""Price of background below the waist, over that above it (our choice): legs are hidden by furniture, or show the floor
between them, and heads are not."""
CLOSEST = 0.25
"""Least distance of a head from the camera's plane, over that of the average person's head there (our choice): where a
camera hangs as low as heads are, outlines would have no bounds."""
ZERO = np.int64(0)
KIND_TAKEN, KIND_HIDDEN = np.uint8(255), np.uint8(254)
"""Of pixels; the others are of the kind of their foreground."""
SUMMANDS: I64 = np.arange(256, dtype=np.int64)
"""(256,) what a pixel of each kind adds to the running sums."""
SUMMANDS[KIND_TAKEN], SUMMANDS[KIND_HIDDEN] = 1 << TAKEN_BIT, 1 << HIDDEN_BIT


class MapArrays(NamedTuple):
    """Columns of a human model map (see ``model_map.HumanModelMap``).

    Attributes:
        entries: (rows, cols) entry of a node, -1 where no person is possible.
        origin_u, origin_v: pixel of node (0, 0); step: distance of nodes [px].
        foot: (N, 2) foot pixels; hull: (N, K, 2) outlines [px].
        upright: (N,) not 0 where the head is above the foot in the image.
        nearer: (N,) how much nearer to the camera's plane the head is than the foot, over the foot's distance.
    """

    entries: I32
    origin_u: int
    origin_v: int
    step: int
    foot: F32
    hull: F32
    upright: U8
    nearer: F64


class Rows(NamedTuple):
    """Rows top <= y < bottom of a model; those from ``legs`` on are below the waist."""

    top: int
    bottom: int
    legs: int


class Spans(NamedTuple):
    """Workspace for one model: (H,) first column and the one after the last of every row, and its edges there."""

    left: I32
    right: I32
    low: F64
    high: F64

    @staticmethod
    def of(height: int) -> "Spans":
        """For images of so many rows."""
        return Spans(np.zeros(height, np.int32), np.zeros(height, np.int32), np.zeros(height), np.zeros(height))


class Window(NamedTuple):
    """Columns x0 <= x < x1 and rows y0 <= y < y1 [px]."""

    x0: int
    x1: int
    y0: int
    y1: int


class MatchCounts(NamedTuple):
    """What a model covers: its area, twice its free foreground, pixels taken by others, twice the ring's foreground,
    free pixels hidden by the scene, twice the background below the waist of a model that is upright in the image."""

    area: int
    free: int
    taken: int
    ring: int
    hidden: int
    legs: int


@njit(cache=True, nogil=True)
def image_size(nearer: float, scale: float) -> float:
    """Size in the image of a person of ``scale`` times the average height, over the average person's at that place.

    A foot at depth Z and a head at depth Z - s h cos(tilt) are apart by s / (1 - s nearer), nearer = h cos(tilt) / Z.
    """
    return scale * (1.0 - nearer) / max(1.0 - scale * nearer, CLOSEST * (1.0 - nearer))


@njit(cache=True, nogil=True)
def image_sizes(nearer: F64, scale: F64, out: F64) -> None:
    """``image_size`` of many people, into (N,) ``out``."""
    for i in range(np.uintp(len(out))):
        out[i] = image_size(nearer[i], scale[i])


@njit(cache=True, nogil=True)
def fill_spans(people: MapArrays, u: float, v: float, scale: float, width: int, spans: Spans) -> Rows:
    """Rows of the model with its foot at (u, v): the nearest map entry, moved, and of the person's size about the foot.

    Fills ``spans``; no rows where no person is possible.
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
        return Rows(0, 0, 0)
    entry = people.entries[row, col]
    shape = people.hull[entry]
    scale = image_size(people.nearer[entry], scale)
    du, dv = u - scale * people.foot[entry, 0], v - scale * people.foot[entry, 1]
    n = shape.shape[0]
    low, high = shape[0, 1], shape[0, 1]
    for k in range(n):
        low = min(low, shape[k, 1])
        high = max(high, shape[k, 1])
    top = max(0, math.ceil(scale * low + dv))
    bottom = min(left.shape[0], math.floor(scale * high + dv) + 1)
    if top >= bottom:
        return Rows(0, 0, 0)
    waist = math.ceil(scale * (high - WAIST * (high - low)) + dv) if people.upright[entry] > 0 else bottom
    lows, highs = spans.low[: bottom - top], spans.high[: bottom - top]
    _trace_edges(shape, scale, du, dv - top, lows, highs)
    lefts, rights = left[top:bottom], right[top:bottom]
    for i in range(np.uintp(bottom - top)):
        lefts[i] = np.int32(np.ceil(min(max(lows[i], 0.0), np.float64(width))))
        rights[i] = np.int32(np.floor(min(max(highs[i], -1.0), width - 1.0))) + np.int32(1)
    return Rows(top, bottom, waist)


@njit(cache=True, nogil=True)
def _trace_edges(shape: F32, scale: float, du: float, dv: float, lows: F64, highs: F64) -> None:
    """Columns of a scaled and moved outline's left and right edges in rows 0, 1, ...

    An outline is in order of angle, from +u to +v: its edges go down on the right and up on the left.
    """
    rows = len(lows)
    lows[:] = np.inf
    highs[:] = -1.0
    x1, y1 = scale * shape[-1, 0] + du, scale * shape[-1, 1] + dv
    for k in range(shape.shape[0]):
        x0, y0 = x1, y1
        x1, y1 = scale * shape[k, 0] + du, scale * shape[k, 1] + dv
        if y0 == y1:
            continue
        slope = (x1 - x0) / (y1 - y0)
        if y1 > y0:
            for y in range(max(0, math.ceil(y0)), min(rows - 1, math.floor(y1)) + 1):
                highs[np.uintp(y)] = x0 + slope * (y - y0)
        else:
            for y in range(max(0, math.ceil(y1)), min(rows - 1, math.floor(y0)) + 1):
                lows[np.uintp(y)] = x0 + slope * (y - y0)


@njit(cache=True, nogil=True)
def paint(image: U8, spans: Spans, top: int, bottom: int, amount: int) -> None:
    """Add ``amount`` to the pixels of a model."""
    change = np.uint8(amount)
    for y in range(top, bottom):
        row = image[y, spans.left[y] : max(spans.left[y], spans.right[y])]
        for i in range(np.uintp(len(row))):
            row[i] += change


@njit(cache=True, nogil=True)
def row_prefix(foreground: U8, cover: U8, hiding: U8, window: Window, sums: I64) -> int:
    """Running sums along the rows of a window, from its first column; returns how many pixels models cover there.

    ``foreground`` is 2 where salient, 1 where less salient, 0 where background; ``hiding`` is not 0 where the scene
    hides people. ``sums[y, x]`` (H, W + 1) sums the columns x0 to x - 1: in its low bits the foreground that no model
    covers, from ``TAKEN_BIT`` pixels that one covers, from ``HIDDEN_BIT`` the others that the scene hides.
    """
    n_taken = 0
    n = np.uintp(max(0, window.x1 - window.x0))
    kinds = np.empty(n, np.uint8)
    for y in range(window.y0, window.y1):
        on = foreground[y, window.x0 : window.x1]
        models = cover[y, window.x0 : window.x1]
        scene = hiding[y, window.x0 : window.x1]
        # Kinds first, since they are found on vector registers and running sums are not.
        for i in range(n):
            free = on[i] if on[i] > 0 else (KIND_HIDDEN if scene[i] > 0 else np.uint8(0))
            kinds[i] = KIND_TAKEN if models[i] > 0 else free
        row = sums[y, window.x0 : window.x1 + 1]
        row[0] = 0
        total = ZERO
        for i in range(n):
            total += SUMMANDS[kinds[i]]
            row[i + np.uintp(1)] = total
        n_taken += int((total >> TAKEN_BIT) & LOW_BITS)
    return n_taken


@njit(cache=True, nogil=True)
def span_counts(sums: I64, spans: Spans, rows: Rows, x0: int, x1: int, ring: float) -> MatchCounts:
    """What a model covers within columns x0 to x1.

    The ring continues each row by ``ring`` times the model's mean width on both sides.
    """
    top, bottom, legs_from = rows
    lefts, rights = spans.left[top:bottom], spans.right[top:bottom]
    n = np.uintp(bottom - top)
    area = 0
    for i in range(n):
        area += int(max(0, rights[i] - lefts[i]))
    margin = int(ring * area / max(1, bottom - top) + 0.5)
    n_free, n_taken, n_wide, n_hidden, n_legs = 0, 0, 0, 0, 0
    for i in range(n):
        l, r = max(int(lefts[i]), x0), min(int(rights[i]), x1)  # noqa: E741
        if l >= r:
            continue
        row = sums[top + int(i)]
        within = row[np.uintp(r)] - row[np.uintp(l)]
        free, taken, hidden = within & LOW_BITS, (within >> TAKEN_BIT) & LOW_BITS, within >> HIDDEN_BIT
        n_free += free
        n_taken += taken
        n_hidden += hidden
        if top + int(i) >= legs_from:
            n_legs += 2 * (r - l - taken - hidden) - free
        n_wide += (row[np.uintp(min(r + margin, x1))] - row[np.uintp(max(l - margin, x0))]) & LOW_BITS
    return MatchCounts(area, n_free, n_taken, n_wide - n_free, n_hidden, n_legs)


@njit(cache=True, nogil=True)
def matching_score(counts: MatchCounts, reference: float, overlap: float) -> float:
    """M of equation 1 for one model, up to constants, in units of a reference area [px^2].

    Free foreground raises recall and precision, background lowers precision, pixels of others are overlap, and
    foreground in the ring counts half: it is the part of a person that is wider than the cylinders (our addition).
    Where the scene hides people, nothing is told either way (our addition).
    """
    background = counts.area - counts.taken - counts.hidden - 0.5 * counts.free - 0.5 * (1.0 - LEGS_COST) * counts.legs
    return (0.5 * counts.free + 0.25 * counts.ring - background - overlap * counts.taken) / reference


@njit(cache=True, nogil=True)
def score_candidates(
    sums: I64, spans: Spans, people: MapArrays, candidates: F64, ring: float, area: I64, free: I64, taken: I64,
    in_ring: I64, hidden: I64, legs: I64,
) -> None:  # fmt: skip
    """``MatchCounts`` of models at (N, 3) foot pixels and scales, filled into six (N,) columns."""
    width = sums.shape[1] - 1
    for i in range(len(candidates)):
        rows = fill_spans(people, candidates[i, 0], candidates[i, 1], candidates[i, 2], width, spans)
        found = span_counts(sums, spans, rows, 0, width, ring)
        area[i], free[i], taken[i], in_ring[i] = found.area, found.free, found.taken, found.ring
        hidden[i], legs[i] = found.hidden, found.legs
