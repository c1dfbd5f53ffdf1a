"""Compiled kernels of what a placed model covers; ``tests/reference/human_model.py`` defines them in plain numpy."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I32, I64, U8, Bool
from planview.tracking.human_model._kernels import MapArrays, Spans, fill_spans


class Images(NamedTuple):
    """One frame: evidence 2 where salient, 1 where less salient; motion not 0; number of models; blob labels; not 0
    where the scene hides people."""

    evidence: U8
    motion: U8
    cover: U8
    labels: I32
    hiding: U8


class HidingLimits(NamedTuple):
    """Where the scene hides people: a model was there for ``expected_s`` [s] and showed for less than the share
    ``shown`` of it [1]; ``memory_s`` is the time after which older ones count less [s]."""

    expected_s: float
    shown: float
    memory_s: float


class Coverage(NamedTuple):
    """What each of N placed models covers, one row per model.

    Attributes:
        area: pixels of the model.
        evidence: evidence on it; alone: evidence that no other model covers.
        shared: pixels that another model covers too.
        hidden: pixels that no other model covers, without evidence, where the scene hides people.
        moving: pixels in motion.
        blob: label of the blob it covers most, 0 for none.
        breadth_px2, breadth_n: sum over model and ring of the foreground's squared distance from the model's middle
            column [px^2], and how many pixels that is.
    """

    area: I64
    evidence: I64
    alone: I64
    shared: I64
    hidden: I64
    moving: I64
    blob: I64
    breadth_px2: F64
    breadth_n: I64


@njit(cache=True, nogil=True)
def measure_models(
    images: Images, spans: Spans, people: MapArrays, position: F64, scale: F64, ring: float, claim: float, claimed: U8,
    votes: I64, found: Coverage,
) -> None:  # fmt: skip
    """What each placed model covers; fills ``found``, zero before.

    Marks the model and ``claim`` times its mean width beside it in ``claimed``. ``votes``
    is a zeroed workspace with one cell per label.
    """
    evidence, cover, left, right = images.evidence, images.cover, spans.left, spans.right
    width = evidence.shape[1]
    for t in range(len(scale)):
        top, bottom = fill_spans(people, position[t, 0], position[t, 1], scale[t], width, spans)
        area = 0
        for y in range(top, bottom):
            area += max(0, right[y] - left[y])
        margin = int(ring * area / max(1, bottom - top) + 0.5)
        near = int(claim * area / max(1, bottom - top) + 0.5)
        best = 0
        for y in range(top, bottom):
            if left[y] >= right[y]:
                continue
            middle = 0.5 * (left[y] + right[y] - 1)
            for x in range(max(0, left[y] - margin), min(width, right[y] + margin)):
                if left[y] - near <= x < right[y] + near:
                    claimed[y, x] = 1
                inside = left[y] <= x < right[y]
                if evidence[y, x] > 1 and (cover[y, x] == 0 or (inside and cover[y, x] == 1)):
                    found.breadth_px2[t] += (x - middle) ** 2
                    found.breadth_n[t] += 1
                if not inside:
                    continue
                if cover[y, x] > 1:
                    found.shared[t] += 1
                if images.motion[y, x] > 0:
                    found.moving[t] += 1
                if evidence[y, x] > 0:
                    found.evidence[t] += evidence[y, x]
                    if cover[y, x] == 1:
                        found.alone[t] += evidence[y, x]
                    label = images.labels[y, x]
                    votes[label] += 1
                    if best == 0 or votes[label] > votes[best]:
                        best = label
                elif images.hiding[y, x] > 0 and cover[y, x] == 1:
                    found.hidden[t] += 1
        found.area[t] = area
        found.blob[t] = best
        for y in range(top, bottom):
            for x in range(left[y], right[y]):
                votes[images.labels[y, x]] = 0


@njit(cache=True, nogil=True)
def learn_hiding(
    evidence: U8, cover: U8, spans: Spans, top: int, bottom: int, dt_s: float, limits: HidingLimits, expected_s: F32,
    shown_s: F32, hiding: U8,
) -> None:  # fmt: skip
    """Add ``dt_s`` to the times for which only one model covered each pixel, and for which it then was foreground.

    ``hiding`` becomes 1 where that was too seldom, else 0. Beyond ``limits.memory_s`` the older times count less.
    """
    for y in range(top, bottom):
        for x in range(spans.left[y], spans.right[y]):
            if cover[y, x] != 1:
                continue
            if expected_s[y, x] >= limits.memory_s:
                keep = np.float32(1.0 - dt_s / limits.memory_s)
                expected_s[y, x] *= keep
                shown_s[y, x] *= keep
            expected_s[y, x] += dt_s
            if evidence[y, x] > 0:
                shown_s[y, x] += dt_s
            long = expected_s[y, x] >= limits.expected_s
            hiding[y, x] = long and shown_s[y, x] < limits.shown * expected_s[y, x]


@njit(cache=True, nogil=True)
def watch_still(
    images: Images, claimed: U8, claimed_blob: Bool, dt_s: float, still_s: F32
) -> None:  # fmt: skip
    """Time for which each pixel has been foreground without motion, in no claimed pixel nor blob; others become 0."""
    height, width = still_s.shape
    step = np.float32(dt_s)
    for y in range(height):
        row, labels = claimed[y], images.labels[y]
        if largest(row) > 0:
            for x in range(np.uintp(width)):
                if row[x] > 0:
                    claimed_blob[labels[x]] = True
    for y in range(height):
        row, labels, times = claimed[y], images.labels[y], still_s[y]
        evidence, motion = images.evidence[y], images.motion[y]
        if largest(evidence) < 2:
            times[:] = np.float32(0.0)
            continue
        for x in range(np.uintp(width)):
            still = evidence[x] > 1 and motion[x] == 0 and row[x] == 0 and not claimed_blob[labels[x]]
            times[x] = times[x] + step if still else np.float32(0.0)


@njit(cache=True, nogil=True)
def largest(row: U8) -> int:
    """Largest value of a row of pixels: found on vector registers, so that empty rows cost little."""
    value = np.uint8(0)
    for x in range(np.uintp(len(row))):
        value = max(value, row[x])
    return int(value)


class Axis(NamedTuple):
    """A body's axis in the image [px]: the foot, the way from foot to head, half the body's width."""

    foot_u: float
    foot_v: float
    along_u: float
    along_v: float
    half_width: float


class BodyLine(NamedTuple):
    """A body's axis, its length [px], and where the ends of the outline lie along it: the foot 0 and the head 1."""

    axis: Axis
    length: float
    low: float
    high: float


@njit(cache=True, nogil=True)
def line_of(foot: F32, head: F32, hull: F32, scale: float, position: F64) -> BodyLine:
    """Axis of a scaled model that stands at a (2,) foot pixel.

    foot, head: (2,) of the map's entry; hull: (K, 2) its outline [px].
    """
    along_u, along_v = scale * np.float64(head[0] - foot[0]), scale * np.float64(head[1] - foot[1])
    length = math.hypot(along_u, along_v)
    low, high, across = math.inf, -math.inf, 0.0
    for k in range(len(hull)):
        u, v = scale * np.float64(hull[k, 0] - foot[0]), scale * np.float64(hull[k, 1] - foot[1])
        share = (u * along_u + v * along_v) / length**2 if length > 0.0 else 0.0
        low, high = min(low, share), max(high, share)
        across = max(across, abs(u * along_v - v * along_u))
    half_width = across / length if length > 0.0 else 0.0
    return BodyLine(Axis(position[0], position[1], along_u, along_v, half_width), length, low, high)


@njit(cache=True, nogil=True)
def body_extent(evidence: U8, cover: U8, axis: Axis, bins: I64) -> tuple[float, float]:
    """How far evidence that no other model covers reaches along a body's axis: (low, high), foot 0 and head 1.

    Pixels within ``half_width`` of the axis are counted in ``bins`` from -0.4 to 1.4 of the axis; from the middle
    outwards, the body ends where two bins in a row hold less than a tenth of its width. (0, 0) where there is none.
    """
    n = len(bins)
    bins[:] = 0
    foot_u, foot_v, axis_u, axis_v, half_width = axis
    height, width = evidence.shape
    length2 = axis_u * axis_u + axis_v * axis_v
    length = math.sqrt(length2)
    reach_u, reach_v = 0.5 * half_width + half_width, 1.5 * half_width
    x0 = max(0, math.floor(min(foot_u - 0.4 * axis_u, foot_u + 1.4 * axis_u) - reach_u))
    x1 = min(width, math.ceil(max(foot_u - 0.4 * axis_u, foot_u + 1.4 * axis_u) + reach_u) + 1)
    y0 = max(0, math.floor(min(foot_v - 0.4 * axis_v, foot_v + 1.4 * axis_v) - reach_v))
    y1 = min(height, math.ceil(max(foot_v - 0.4 * axis_v, foot_v + 1.4 * axis_v) + reach_v) + 1)
    for y in range(y0, y1):
        for x in range(x0, x1):
            if evidence[y, x] == 0 or cover[y, x] > 1:
                continue
            du, dv = x - foot_u, y - foot_v
            if abs(du * axis_v - dv * axis_u) > half_width * length:
                continue
            k = math.floor(((du * axis_u + dv * axis_v) / length2 + 0.4) / 1.8 * n)
            if 0 <= k < n:
                bins[k] += evidence[y, x]
    minimum = 0.1 * 2.0 * (2.0 * half_width) * (1.8 * length / n)
    middle = int(0.9 / 1.8 * n)
    if bins[middle] < minimum and bins[middle - 1] < minimum:
        return 0.0, 0.0
    low = middle
    while low > 0 and (bins[low - 1] >= minimum or (low > 1 and bins[low - 2] >= minimum)):
        low -= 1
    high = middle
    while high < n - 1 and (bins[high + 1] >= minimum or (high < n - 2 and bins[high + 2] >= minimum)):
        high += 1
    while low < high and bins[low] < minimum:
        low += 1
    while high > low and bins[high] < minimum:
        high -= 1
    return low / n * 1.8 - 0.4, (high + 1) / n * 1.8 - 0.4


@njit(cache=True, nogil=True)
def colour_histogram(
    image: U8, evidence: U8, cover: U8, spans: Spans, top: int, bottom: int, level: U8, n_levels: int, histogram: F32
) -> None:  # fmt: skip
    """Colours of the foreground that only this model covers, per horizontal part of the body.

    ``level`` (256,) quantises a channel to ``n_levels``. Fills ``histogram`` (parts, n_levels^3), each part summing to
    one (zero if nothing of it is visible).
    """
    parts, n_bins = histogram.shape
    histogram[:, :] = 0.0
    for y in range(top, bottom):
        part = min(parts - 1, (y - top) * parts // max(1, bottom - top))
        for x in range(spans.left[y], spans.right[y]):
            if evidence[y, x] > 0 and cover[y, x] == 1:
                b = (level[image[y, x, 0]] * n_levels + level[image[y, x, 1]]) * n_levels + level[image[y, x, 2]]
                histogram[part, b] += 1.0
    for part in range(parts):
        total = np.float32(0.0)
        for b in range(n_bins):
            total += histogram[part, b]
        if total > 0:
            for b in range(n_bins):
                histogram[part, b] /= total
