"""Input of the kernels: assumptions, what a camera saw, and the samples of a frame, which are pixels near people."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from calib.kernels import inlined, kernel
from calib.types import F32, F64, I64, U8, AnyArray, Bool
from planview.maps.view import SURFACE, UNKNOWN, PixelRays
from planview.tracking.body import FACINGS_PER_RAD

PARTS = 3
"""Legs, torso and head."""
LEGS_TO = 0.45
TORSO_TO = 0.85
"""Relative heights at which the hip and the shoulders are (Zhang et al. 2008, table 1)."""
LAYERS = 4
"""Other people on one ray, the nearest first."""
AT, THROUGH, BEFORE, REST, WHO = range(5)
"""Rows of ``SampleArrays.layers``."""
CX, CY, CZ, EX, EY, COS, SIN, ACROSS, UP, AHEAD = range(10)
"""Rows of ``SampleArrays.rays``."""
TINY = 1e-12
AROUND_M = 0.25
"""Margin of samples beyond a body's reach [m]."""
NEAREST_M = 0.15
"""Bodies nearer to a camera's plane are as far as this [m]."""
SAMPLES_OF_VIEW = 3000
"""Most samples of a person in one view."""
GAP_PX = 6
"""People whose boxes are nearer than this in an image are explained together [px]."""
GOLDEN = 0.6180339887498949, 0.7548776662466927
"""Shares whose multiples spread evenly: which of two neighbouring tables a sample takes."""


class PosePrior(NamedTuple):
    """Precision of a predicted pose before the frame.

    Attributes:
        xx, xy, yy, height: inverse covariance of place and height [1/m^2].
        facing, back: concentration of the facing about the predicted one, and probability that this is back to front.
        walk, heading: concentration of the facing about the direction of walking, and that direction [rad].
    """

    xx: float
    xy: float
    yy: float
    height: float
    facing: float = 0.0
    back: float = 0.0
    walk: float = 0.0
    heading: float = 0.0


POSE_PRIOR = np.dtype([(name, np.float64) for name in PosePrior._fields])
PIXEL = np.dtype(
    [(name, np.float32) for name in ("range_m", "sharp", "matched_m", "weight", "turn", "slant")]
    + [(name, np.uint8) for name in ("kind", "code", "angle", "near")],
    align=True,
)
"""A sample's pixel: ``kind``, ``code``, ``range_m`` and ``matched_m`` are as in a view; ``weight`` is in patches;
``sharp`` is 1 / deviation of a body's surface there [1/m]; ``turn`` is the direction of the ray [of FACINGS] less an
even spread over one of them, so that samples of a direction between two tables take both in proportion; ``slant`` is
the share of a lean from which the sample takes the table of a lean; ``angle`` is the index of the depression in the
body's table; ``near`` is 1 where somebody else reaches."""


class Model(NamedTuple):
    """Assumptions about a sensor and people, as kernels take them. A default means that the sensor has no such thing.

    Attributes:
        body, background: pF and pB, shares of a body's and of the background's pixels that are foreground.
        near_people: pB within ``reach_m`` of a person.
        patch_m, patch_px: errors of nearer pixels are one error.
        spacing_m: distance of samples on a body.
        colour: weight of the colours.
        range_m: depth over which wrong ranges spread.
        no_depth, outliers: share of a body's foreground without depth, and share of wrong depths.
        unknown: kappa, share of surface before which something unknown stands.
        surface_var: of a body's surface about its table [m^2].
        low_share: share of people who are of any lower height.
        masks: 1 where no pixel has a range.
        hidden, hidden_sitting: probability that unseen furniture hides a pixel below ``hidden_to`` (relative height) of
            somebody who stands, or who is lower than ``sitting_from`` of the own height.
        sits, sitting: share of people who sit, at ``sitting`` of their height.
    """

    body: float
    background: float
    near_people: float
    reach_m: float
    patch_m: float
    spacing_m: float
    colour: float
    range_m: float = 1.0
    no_depth: float = 0.0
    outliers: float = 0.0
    unknown: float = 0.0
    surface_var: float = 0.0
    low_share: float = 0.0
    masks: float = 0.0
    patch_px: float = 0.0
    hidden: float = 0.0
    hidden_sitting: float = 0.0
    hidden_to: float = 0.0
    sitting_from: float = 0.0
    sits: float = 0.0
    sitting: float = 1.0


class ViewArrays(NamedTuple):
    """One view as kernels take it.

    Attributes:
        std_per_m2: deviation of a range over its square, in the middle of the image [1/m].
        rays, kind, range_m, colour: of the ``View``.
    """

    rays: PixelRays
    std_per_m2: float
    kind: U8
    range_m: F32
    colour: U8


class Appearance(NamedTuple):
    """Looks of a person, wherever it stands.

    Attributes:
        stature_m, stature_std_m: height when upright and its deviation.
        ratios: (PARTS, CODES) float32 colours over those of anybody.
    """

    stature_m: float
    stature_std_m: float
    ratios: F32


class Others(NamedTuple):
    """The others on the rays: all people, and which of them."""

    people: Any
    which: I64


class Search(NamedTuple):
    """A search for the pose that explains best.

    Attributes:
        predicted, prior, steps: (5,) predicted pose, (1,) of POSE_PRIOR, and steps of the ascent.
    """

    predicted: F64
    prior: AnyArray
    steps: F64


class Searches(NamedTuple):
    """Searches of N people together.

    Attributes:
        predicted, priors: (N, 5) predicted poses, and (N,) of POSE_PRIOR.
        steps, first_step: (K,) steps of the ascent, and (N,) index of the first one that each person takes.
    """

    predicted: F64
    priors: AnyArray
    steps: F64
    first_step: I64


class SampleArrays(NamedTuple):
    """Pixels near a person, of which the first ``size[0]`` hold; or those of several people, by person.

    Attributes:
        rays: (10, N) the camera [m], level direction of the ray, cosine and sine of its depression; of the body that is
            being tried, columns across and up in its table, and the range at its centre [m].
        pixels: (N,) of PIXEL.
        layers, counts: (N, 5, LAYERS + 1), (N,): other people on the ray, see ``lay_others``.
        which: (N,) samples on the body that is being tried.
        size: (3,) how many hold; of the main camera, which gives most of them, the first and how many.
    """

    rays: F32
    pixels: AnyArray
    layers: F32
    counts: I64
    which: I64
    size: I64

    @staticmethod
    def empty(people: int, n: int) -> SampleArrays:
        """Room for n samples of each of some people, of which none is there."""
        return SampleArrays(
            np.empty((people, 10, n), np.float32), np.empty((people, n), PIXEL),
            np.empty((people, n, 5, LAYERS + 1), np.float32), np.empty((people, n), np.int64),
            np.empty((people, n), np.int64), np.zeros((people, 3), np.int64),
        )  # fmt: skip

    def person(self, k: int) -> SampleArrays:
        """Samples of one person."""
        return SampleArrays._make(array[k] for array in self)


@inlined
def _row_of(row, x, y, z):  # type: ignore[no-untyped-def]
    """Product of a row of a projection and a point."""
    return row[0] * x + row[1] * y + row[2] * z + row[3]


@kernel
def boxes(poses: F64, half_m: float, view, out: F64) -> None:  # type: ignore[no-untyped-def]
    """Left, top, right, bottom (N, 4) [px] of boxes around bodies: ``half_m`` to each side, 0.1 m above their heads;
    beyond the lens's reach a box is the whole image."""
    projection = view.rays.projection
    k = view.rays.distortion_k
    middle_u = 0.5 * (view.kind.shape[1] - 1)
    middle_v = 0.5 * (view.kind.shape[0] - 1)
    for a in range(len(poses)):
        out[a, :2] = 1e4
        out[a, 2:] = -1e4
        for corner in range(8):
            x = poses[a, 0] + (half_m if corner & 1 else -half_m)
            y = poses[a, 1] + (half_m if corner & 2 else -half_m)
            z = poses[a, 2] + 0.1 if corner & 4 else 0.0
            depth = max(_row_of(projection[2], x, y, z), NEAREST_M)
            u = _row_of(projection[0], x, y, z) / depth
            v = _row_of(projection[1], x, y, z) / depth
            if k != 0.0:
                r = math.hypot(u - middle_u, v - middle_v)
                if 1.0 + 2.0 * k * r <= 0.0:
                    out[a, :2] = -1e4
                    out[a, 2:] = 1e4
                    break
                u = middle_u + (u - middle_u) * (1.0 + k * r)
                v = middle_v + (v - middle_v) * (1.0 + k * r)
            u = min(max(u, -1e4), 1e4)
            v = min(max(v, -1e4), 1e4)
            out[a, 0] = min(out[a, 0], u)
            out[a, 1] = min(out[a, 1], v)
            out[a, 2] = max(out[a, 2], u)
            out[a, 3] = max(out[a, 3], v)


@kernel
def mark_shared_rays(poses: F64, half_m: float, view, shared: Bool) -> None:  # type: ignore[no-untyped-def]
    """Mark the (N, N) pairs of people who may be on one ray of a camera."""
    box = np.empty((len(poses), 4))
    boxes(poses, half_m, view, box)
    box = np.trunc(box)
    for i in range(len(poses)):
        for j in range(len(poses)):
            aside = box[i, 0] - GAP_PX > box[j, 2] or box[j, 0] - GAP_PX > box[i, 2]
            above = box[i, 1] - GAP_PX > box[j, 3] or box[j, 1] - GAP_PX > box[i, 3]
            if not (aside or above):
                shared[i, j] = True


@inlined
def _take(n, row, col, weight, spread, view, samples, table, model):  # type: ignore[no-untyped-def]
    """Make a pixel the n-th sample; ``spread``: of the ray's direction and of the lean."""
    rays = samples.rays
    pixel = samples.pixels[n]
    level = view.rays.level[row, col]
    for axis in range(3):
        rays[CX + axis, n] = view.rays.centre_m[axis]
    for k in range(4):
        rays[EX + k, n] = level[k]
    far = view.range_m[row, col]
    std = view.std_per_m2 / view.rays.stretch[row, col]
    pixel.kind = view.kind[row, col]
    pixel.code = view.colour[row, col]
    pixel.range_m = far
    pixel.matched_m = view.rays.matched_m[row, col]
    # A range errs as one of what it shows; what it does not show, the body's own surface errs.
    pixel.sharp = 1.0 / math.sqrt(max(model[0].surface_var + (std * far * far) ** 2, 1e-12))
    angle = int((level[4] - table.angle_min_rad) / table.angle_step_rad + 0.5)
    pixel.angle = min(max(angle, 0), table.cover.shape[1] - 1)
    pixel.turn = level[5] * FACINGS_PER_RAD - spread[0]
    pixel.slant = spread[1]
    pixel.weight = weight
    pixel.near = 0


@kernel
def _gather(pose: F64, reach_m: float, view, samples, table, model) -> None:  # type: ignore[no-untyped-def]
    """Append the samples of one camera within ``reach_m`` of a body."""
    m = model[0]
    level = view.rays.level
    pixel_m = math.sqrt(view.rays.pixel_sr)
    rows, cols = view.rays.stretch.shape
    half = reach_m + AROUND_M
    box = np.empty((1, 4))
    boxes(pose.reshape(1, -1), half, view, box)
    left, top, right, bottom = box[0]
    if right < 0 or bottom < 0 or left > cols - 1 or top > rows - 1:
        return
    col_from = max(0, int(left))
    col_to = min(cols - 1, int(right) + 1)
    row_from = max(0, int(top))
    row_to = min(rows - 1, int(bottom) + 1)
    dx = pose[0] - view.rays.centre_m[0]
    dy = pose[1] - view.rays.centre_m[1]
    dz = 0.5 * pose[2] - view.rays.centre_m[2]
    step = max(1, int(m.spacing_m / math.sqrt((dx * dx + dy * dy + dz * dz) * view.rays.pixel_sr) + 0.5))
    while ((col_to - col_from) // step + 1) * ((row_to - row_from) // step + 1) > SAMPLES_OF_VIEW:
        step += 1
    to_depth = view.rays.projection[2]
    depth = to_depth[0] * pose[0] + to_depth[1] * pose[1] + 0.5 * to_depth[2] * pose[2]
    depth = max(depth + to_depth[3], NEAREST_M)
    weight = (step / max(m.patch_m / (depth * pixel_m), m.patch_px)) ** 2
    first = samples.size[0]
    n = first
    for row in range(row_from + (-row_from) % step, row_to + 1, step):
        # In masks every other row half a step aside: edges of bodies are upright.
        shift = (row // step % 2) * (step // 2) if m.masks > 0.0 else 0
        for col in range(col_from + (shift - col_from) % step, col_to + 1, step):
            ray = level[row, col]
            far = (dx * ray[0] + dy * ray[1]) * ray[2] - dz * ray[3]
            if n < len(samples.pixels) and abs(dy * ray[0] - dx * ray[1]) <= half and far >= NEAREST_M:
                spread = GOLDEN[0] * (n - first) % 1.0, GOLDEN[1] * (n - first) % 1.0
                _take(n, row, col, weight, spread, view, samples, table, model)
                n += 1
    samples.size[0] = n
    if n > first:
        _choose_main(first, n - first, samples)


@inlined
def _choose_main(first, count, samples):  # type: ignore[no-untyped-def]
    """Take the camera of some samples for the main one if it gives more than the main one so far."""
    rays = samples.rays
    main = samples.size[1]
    more = count - samples.size[2]
    here = rays[CX, first], rays[CY, first], rays[CZ, first]
    there = rays[CX, main], rays[CY, main], rays[CZ, main]
    if more > 0 or (more == 0 and here < there):  # of equally many one, whichever sensor is listed first
        samples.size[1] = first
        samples.size[2] = count


@inlined
def pose_tuple(pose):  # type: ignore[no-untyped-def]
    """Pose (5,) as a tuple."""
    return pose[0], pose[1], pose[2], pose[3], pose[4]


@inlined
def samples_of_person(samples, k):  # type: ignore[no-untyped-def]
    """Samples of one of several people."""
    return SampleArrays(
        samples.rays[k], samples.pixels[k], samples.layers[k], samples.counts[k], samples.which[k], samples.size[k]
    )


@kernel
def gather(poses: F64, reach_m: float, view, samples, table, model) -> None:  # type: ignore[no-untyped-def]
    """Append the samples of one camera within ``reach_m`` of each body to those of that body."""
    for k in range(len(poses)):
        _gather(poses[k], reach_m, view, samples_of_person(samples, k), table, model)


@kernel
def take_pixels(pixels: I64, view, samples, table, model) -> None:  # type: ignore[no-untyped-def]
    """Make some pixels of a view the samples, each weighted by its patches at a range of 1 m."""
    cols = view.kind.shape[1]
    for n in range(len(pixels)):
        row = pixels[n] // cols
        col = pixels[n] % cols
        weight = view.rays.pixel_sr / (view.rays.stretch[row, col] * model[0].patch_m) ** 2
        _take(n, row, col, weight, (0.5, 0.5), view, samples, table, model)
    samples.size[0] = len(pixels)


@kernel
def map_lacking(points: F32, low_m: F64, cell_m: float, out: F32) -> None:
    """Add what points lack of an explanation, as ``assign_pixels`` gives it, to the cells of a map of the floor."""
    for i in range(points.shape[1]):
        row = int((points[0, i] - low_m[0]) / cell_m)
        col = int((points[1, i] - low_m[1]) / cell_m)
        out[row, col] += points[3, i]


@kernel
def find_fresh(pixels: I64, lacking: F32, codes: U8, view, tried_m: F32, deviations, which: I64, out: F32) -> int:  # type: ignore[no-untyped-def]
    """Find the pixels whose surface is not where it has been tried; return their number.

    Forgets what has been tried where there is no surface now.

    Args:
        tried_m: (H, W) ranges that have been tried; 0 for none.
        deviations: of a body's surface [m], and how many of them make another surface.
        which: (M,) takes their indices.
        out: (5, M) takes x, y, z [m], what they lack of an explanation, and the colour.
    """
    surface_m, changed = deviations
    centre = view.rays.centre_m
    rows, cols = view.range_m.shape
    for row in range(rows):
        for col in range(cols):
            if view.kind[row, col] != SURFACE and view.kind[row, col] != UNKNOWN:
                tried_m[row, col] = 0.0
    n = 0
    for i in range(len(pixels)):
        row = pixels[i] // cols
        col = pixels[i] % cols
        far = view.range_m[row, col]
        if abs(far - tried_m[row, col]) < changed * math.hypot(surface_m, view.std_per_m2 * far * far):
            continue
        ray = view.rays.level[row, col]
        out[0, n] = centre[0] + ray[0] * ray[2] * far
        out[1, n] = centre[1] + ray[1] * ray[2] * far
        out[2, n] = centre[2] - ray[3] * far
        out[3, n] = lacking[i]
        out[4, n] = codes[i]
        which[n] = i
        n += 1
    return n
