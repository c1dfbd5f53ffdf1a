"""Compiled kernels of what a placed model covers; ``tests/reference/human_model.py`` defines them in plain numpy."""

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


class Columns(NamedTuple):
    """Columns of a model in one row, left <= x < right, and of the model with its ring, x0 <= x < x1."""

    left: int
    right: int
    x0: int
    x1: int


@njit(cache=True, nogil=True)
def measure_models(
    images: Images, spans: Spans, people: MapArrays, position: F64, scale: F64, ring: float, claim: float, claimed: U8,
    votes: I64, found: Coverage,
) -> None:  # fmt: skip
    """What each placed model covers; fills ``found``, zero before.

    Marks the model and ``claim`` times its mean width beside it in ``claimed``. ``votes`` is a workspace with one cell
    per label.
    """
    evidence, cover, left, right = images.evidence, images.cover, spans.left, spans.right
    width = evidence.shape[1]
    for t in range(len(scale)):
        top, bottom, _ = fill_spans(people, position[t, 0], position[t, 1], scale[t], width, spans)
        area = 0
        for y in range(top, bottom):
            area += max(0, right[y] - left[y])
        margin = int(ring * area / max(1, bottom - top) + 0.5)
        near = int(claim * area / max(1, bottom - top) + 0.5)
        for y in range(top, bottom):
            if left[y] < right[y]:
                x0, x1 = max(0, left[y] - margin), min(width, right[y] + margin)
                claimed[y, max(x0, left[y] - near) : min(x1, right[y] + near)] = 1
                _measure_breadth(evidence[y], cover[y], Columns(left[y], right[y], x0, x1), t, found)
                _measure_row(images, y, left[y], right[y], t, found)
        found.area[t] = area
        found.blob[t] = _most_of(evidence, images.labels, spans, top, bottom, votes)


@njit(cache=True, nogil=True)
def _measure_breadth(evidence: U8, cover: U8, columns: Columns, t: int, found: Coverage) -> None:
    """Add a row of model t and of the ring, where foreground is the model's or no model's."""
    left, right, x0, x1 = columns
    on, models = evidence[x0:x1], cover[x0:x1]
    # Twice the distance from the middle is whole: sums of whole numbers are found on vector registers.
    squares, n, first = np.int64(0), np.int64(0), np.int64(2 * x0 - (left + right - 1))
    for i in range(np.uintp(len(on))):
        inside = (np.int64(i) >= left - x0) & (np.int64(i) < right - x0)
        counts = (on[i] > 1) & ((models[i] == 0) | (inside & (models[i] == 1)))
        off = first + np.int64(2) * np.int64(i)
        squares += off * off if counts else np.int64(0)
        n += np.int64(counts)
    found.breadth_px2[t] += 0.25 * squares
    found.breadth_n[t] += n


@njit(cache=True, nogil=True)
def _measure_row(images: Images, y: int, left: int, right: int, t: int, found: Coverage) -> None:
    """Add what a row of model t covers."""
    on, models = images.evidence[y, left:right], images.cover[y, left:right]
    motion, scene = images.motion[y, left:right], images.hiding[y, left:right]
    shared, moving, evidence, alone, hidden = np.int64(0), np.int64(0), np.int64(0), np.int64(0), np.int64(0)
    for i in range(np.uintp(len(on))):
        shared += np.int64(models[i] > 1)
        moving += np.int64(motion[i] > 0)
        evidence += np.int64(on[i])
        alone += np.int64(on[i]) if models[i] == 1 else np.int64(0)
        hidden += np.int64((on[i] == 0) & (scene[i] > 0) & (models[i] == 1))
    found.shared[t] += shared
    found.moving[t] += moving
    found.evidence[t] += evidence
    found.alone[t] += alone
    found.hidden[t] += hidden


@njit(cache=True, nogil=True)
def _most_of(evidence: U8, labels: I32, spans: Spans, top: int, bottom: int, votes: I64) -> int:
    """The blob that a model covers most; of two, the one that was so first. ``votes`` has a cell per label."""
    votes[:] = 0
    best = 0
    for y in range(top, bottom):
        on, row = evidence[y], labels[y]
        for x in range(spans.left[y], spans.right[y]):
            if on[x] > 0:
                label = row[x]
                votes[label] += 1
                if best == 0 or votes[label] > votes[best]:
                    best = label
    return best


@njit(cache=True, nogil=True)
def count_covered(cover: U8, hiding: U8, spans: Spans, top: int, bottom: int) -> tuple[int, int]:
    """Pixels of a model, and those of them that more than one model covers or where the scene hides people."""
    area, covered = 0, 0
    for y in range(top, bottom):
        for x in range(spans.left[y], spans.right[y]):
            area += 1
            if cover[y, x] > 1 or hiding[y, x] > 0:
                covered += 1
    return area, covered


@njit(cache=True, nogil=True)
def learn_hiding(
    evidence: U8, cover: U8, spans: Spans, top: int, bottom: int, dt_s: float, limits: HidingLimits, expected_s: F32,
    shown_s: F32, hiding: U8,
) -> None:  # fmt: skip
    """Add ``dt_s`` to the times for which only one model covered each pixel, and for which it then was foreground.

    ``hiding`` becomes 1 where that was too seldom, else 0. Beyond ``limits.memory_s`` the older times count less.
    """
    fading = np.float32(1.0 - dt_s / limits.memory_s)
    for y in range(top, bottom):
        left, right = spans.left[y], max(spans.left[y], spans.right[y])
        expected, shown, hidden = expected_s[y, left:right], shown_s[y, left:right], hiding[y, left:right]
        on, models = evidence[y, left:right], cover[y, left:right]
        # Without branches, on vector registers.
        for i in range(np.uintp(len(on))):
            alone = models[i] == 1
            keep = fading if alone & (expected[i] >= limits.memory_s) else np.float32(1.0)
            added = dt_s if alone else 0.0
            expected[i] = expected[i] * keep + added
            shown[i] = shown[i] * keep + (added if on[i] > 0 else 0.0)
            hides = (expected[i] >= limits.expected_s) & (shown[i] < limits.shown * expected[i])
            hidden[i] = np.uint8(hides) if alone else hidden[i]


@njit(cache=True, nogil=True)
def learn_open(evidence: U8, cover: U8, spans: Spans, top: int, bottom: int, away_m: float, open_m: F32) -> None:
    """Remember the greatest distance at which a person has been observed at each pixel: nothing nearer hides it."""
    away = np.float32(away_m)
    for y in range(top, bottom):
        left, right = spans.left[y], max(spans.left[y], spans.right[y])
        known, on, models = open_m[y, left:right], evidence[y, left:right], cover[y, left:right]
        for i in range(np.uintp(len(on))):
            known[i] = max(known[i], away) if (models[i] == 1) & (on[i] > 0) else known[i]


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
        some = False
        for x in range(np.uintp(width)):
            still = (evidence[x] > 1) & (motion[x] == 0) & (row[x] == 0)
            times[x] = times[x] + step if still else np.float32(0.0)
            some |= still
        if some:
            for x in range(np.uintp(width)):
                if times[x] > 0 and claimed_blob[labels[x]]:
                    times[x] = np.float32(0.0)


@njit(cache=True, nogil=True)
def largest(row: U8) -> int:
    """Largest value of a row of pixels: found on vector registers, so that empty rows cost little."""
    value = np.uint8(0)
    for x in range(np.uintp(len(row))):
        value = max(value, row[x])
    return int(value)


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
