"""What the kernels of the joint explanation share: what is assumed, what a camera saw, and the samples of a frame:
pixels near people, and those that lack an explanation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.kernels import kernel
from calib.types import F32, F64, I64, U8, AnyArray, Bool
from planview.maps.view import SURFACE, UNKNOWN, PixelRays
from planview.tracking.body import FACINGS_PER_RAD

PARTS = 3
LEGS_TO, TORSO_TO = 0.45, 0.85
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


class Known(NamedTuple):
    """What is known of a pose before the frame.

    Attributes:
        xx, xy, yy, height: inverse covariance of place and height [1/m^2].
        turn, back: concentration of the facing about the predicted one, and how probably this is back to front.
        walk, heading: concentration of the facing about the direction of walking, and that direction [rad].
    """

    xx: float
    xy: float
    yy: float
    height: float
    turn: float = 0.0
    back: float = 0.0
    walk: float = 0.0
    heading: float = 0.0


KNOWN = np.dtype([(name, np.float64) for name in Known._fields])
PIXEL = np.dtype(
    [(name, np.float32) for name in ("range_m", "sharp", "matched_m", "weight", "turn", "slant")]
    + [(name, np.uint8) for name in ("kind", "code", "angle", "near")],
    align=True,
)
"""A sample's pixel: as in a view, and the weight in patches; 1 / deviation of a body's surface there [1/m]; direction
of the ray [of FACINGS], less an even spread over one of them, so that samples of a direction between two tables take
both in its proportion, and the share of a lean from which they lean; index of the depression in the body's table;
whether somebody else reaches there."""


class Model(NamedTuple):
    """What is assumed of sensors and bodies, as kernels take it.

    Attributes:
        body, background: pF and pB, shares of a body's and of the background's pixels that are foreground.
        near_people: pB within ``reach_m`` of a person.
        hidden, hidden_sitting: how probably unseen furniture hides a pixel below ``hidden_to`` (relative height) of
            somebody who stands, or who is lower than ``sitting_from`` of the own height.
        no_depth, outliers, range_m: share of a body's foreground without depth, share of wrong depths, and how far
            these spread [m].
        unknown: kappa, share of surface before which something unknown stands.
        surface_var: of a body's surface about its table [m^2].
        colour: weight of the colours.
        low_share, sits, sitting: shares of people who are of any lower height, and who sit at ``sitting`` of theirs.
        masks: 1 where no pixel has a range.
        patch_m, patch_px, spacing_m: errors of nearer pixels are one error; distance of samples on a body.
        body_m: height of the table's body [m]; ``apart_m``: least distance of two axes [m].
        height_min_m, height_max_m: of people [m].
    """

    body: float
    background: float
    near_people: float
    hidden: float
    hidden_sitting: float
    hidden_to: float
    sitting_from: float
    no_depth: float
    outliers: float
    range_m: float
    unknown: float
    surface_var: float
    colour: float
    low_share: float
    sits: float
    sitting: float
    masks: float
    patch_m: float
    patch_px: float
    spacing_m: float
    body_m: float
    reach_m: float
    apart_m: float
    height_min_m: float
    height_max_m: float
    lean_std_m: float


class Seen(NamedTuple):
    """One view as kernels take it: of a ``View``, and

    Attributes:
        std_per_m2: deviation of a range over its square, in the middle of the image [1/m].
    """

    rays: PixelRays
    std_per_m2: float
    kind: U8
    range_m: F32
    colour: U8


class SampleArrays(NamedTuple):
    """Pixels near a person, of which the first ``size[0]`` hold; or those of several people, by person.

    Attributes:
        rays: (10, N) the camera [m], level direction of the ray, cosine and sine of its depression; of the body that is
            being tried, columns across and up in its table, and the range at its centre [m].
        pixels: (N,) of PIXEL.
        layers: (N, 5, LAYERS + 1), ``counts`` (N,): other people on the ray, see ``lay_others``.
        which: (N,) samples on the body that is being tried.
        size: (3,) how many hold; of the camera that gives most of them, the first and how many.
    """

    rays: F32
    pixels: AnyArray
    layers: F32
    counts: I64
    which: I64
    size: I64

    @staticmethod
    def of(people: int, n: int) -> SampleArrays:
        """Room for n samples of each of some people, of which none is there."""
        return SampleArrays(
            np.empty((people, 10, n), np.float32), np.empty((people, n), PIXEL),
            np.empty((people, n, 5, LAYERS + 1), np.float32), np.empty((people, n), np.int64),
            np.empty((people, n), np.int64), np.zeros((people, 3), np.int64),
        )  # fmt: skip

    def person(self, k: int) -> SampleArrays:
        """Those of one person."""
        return SampleArrays._make(array[k] for array in self)


@kernel
def boxes(poses: F64, half_m: float, seen, out: F64) -> None:  # type: ignore[no-untyped-def]
    """Left, top, right, bottom (N, 4) [px] of boxes around bodies: ``half_m`` to each side, 0.1 m above their heads;
    beyond the lens's reach a box is the whole image."""
    projection, k = seen.rays.projection, seen.rays.distortion_k
    middle_u, middle_v = 0.5 * (seen.kind.shape[1] - 1), 0.5 * (seen.kind.shape[0] - 1)
    for a in range(len(poses)):
        out[a, :2], out[a, 2:] = 1e4, -1e4
        for corner in range(8):
            x = poses[a, 0] + (half_m if corner & 1 else -half_m)
            y = poses[a, 1] + (half_m if corner & 2 else -half_m)
            z = poses[a, 2] + 0.1 if corner & 4 else 0.0
            depth = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
            depth = max(depth, NEAREST_M)
            u = (projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]) / depth
            v = (projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]) / depth
            if k != 0.0:
                r = math.hypot(u - middle_u, v - middle_v)
                if 1.0 + 2.0 * k * r <= 0.0:
                    out[a, :2], out[a, 2:] = -1e4, 1e4
                    break
                u, v = middle_u + (u - middle_u) * (1.0 + k * r), middle_v + (v - middle_v) * (1.0 + k * r)
            u, v = min(max(u, -1e4), 1e4), min(max(v, -1e4), 1e4)
            out[a, 0], out[a, 1] = min(out[a, 0], u), min(out[a, 1], v)
            out[a, 2], out[a, 3] = max(out[a, 2], u), max(out[a, 3], v)


@kernel
def mark_touching(poses: F64, half_m: float, seen, touch: Bool) -> None:  # type: ignore[no-untyped-def]
    """Mark the (N, N) pairs of people who may be on one ray of a camera."""
    box = np.empty((len(poses), 4))
    boxes(poses, half_m, seen, box)
    box = np.trunc(box)
    for i in range(len(poses)):
        for j in range(len(poses)):
            apart = box[i, 0] - GAP_PX > box[j, 2] or box[j, 0] - GAP_PX > box[i, 2]
            apart = apart or box[i, 1] - GAP_PX > box[j, 3] or box[j, 1] - GAP_PX > box[i, 3]
            touch[i, j] = touch[i, j] or not apart


@njit(inline="always")
def _take(n, r, c, weight, spread, seen, samples, table, model):  # type: ignore[no-untyped-def]
    """A pixel becomes the n-th sample; ``spread``: of the ray's direction and of the lean."""
    rays, p, m, of = samples.rays, samples.pixels[n], model[0], seen.rays
    for axis in range(3):
        rays[CX + axis, n] = of.centre_m[axis]
    for k in range(4):
        rays[EX + k, n] = of.level[r, c, k]
    far, std = seen.range_m[r, c], seen.std_per_m2 / of.stretch[r, c]
    p.kind, p.code, p.range_m, p.matched_m = seen.kind[r, c], seen.colour[r, c], far, of.matched_m[r, c]
    # A range errs as one of what it shows; what it does not show, the body's own surface errs.
    p.sharp = 1.0 / math.sqrt(max(m.surface_var + (std * far * far) ** 2, 1e-12))
    angle = int((of.level[r, c, 4] - table.angle_min_rad) / table.angle_step_rad + 0.5)
    p.angle = min(max(angle, 0), table.cover.shape[1] - 1)
    p.turn, p.slant, p.weight, p.near = of.level[r, c, 5] * FACINGS_PER_RAD - spread[0], spread[1], weight, 0


@kernel
def _gather(pose: F64, reach_m: float, seen, samples, table, model) -> None:  # type: ignore[no-untyped-def]
    """Append the samples of one camera within ``reach_m`` of a body."""
    m, centre, projection, level = model[0], seen.rays.centre_m, seen.rays.projection, seen.rays.level
    rows, cols = seen.rays.stretch.shape
    half, box = reach_m + AROUND_M, np.empty((1, 4))
    boxes(pose.reshape(1, -1), half, seen, box)
    x0, y0, x1, y1 = box[0]
    if x1 < 0 or y1 < 0 or x0 > cols - 1 or y0 > rows - 1:
        return
    c0, c1, r0, r1 = max(0, int(x0)), min(cols - 1, int(x1) + 1), max(0, int(y0)), min(rows - 1, int(y1) + 1)
    dx, dy, dz = pose[0] - centre[0], pose[1] - centre[1], 0.5 * pose[2] - centre[2]
    step = max(1, int(m.spacing_m / math.sqrt((dx * dx + dy * dy + dz * dz) * seen.rays.pixel_sr) + 0.5))
    while ((c1 - c0) // step + 1) * ((r1 - r0) // step + 1) > SAMPLES_OF_VIEW:
        step += 1
    depth = projection[2, 0] * pose[0] + projection[2, 1] * pose[1] + 0.5 * projection[2, 2] * pose[2]
    depth = max(depth + projection[2, 3], NEAREST_M)
    weight = (step / max(m.patch_m / (depth * math.sqrt(seen.rays.pixel_sr)), m.patch_px)) ** 2
    first = n = samples.size[0]
    for r in range(r0 + (-r0) % step, r1 + 1, step):
        # In masks every other row half a step aside: edges of bodies are upright.
        shift = (r // step % 2) * (step // 2) if m.masks > 0.0 else 0
        for c in range(c0 + (shift - c0) % step, c1 + 1, step):
            ex, ey, cos, sin = level[r, c, 0], level[r, c, 1], level[r, c, 2], level[r, c, 3]
            far = (dx * ex + dy * ey) * cos - dz * sin
            if n < len(samples.pixels) and abs(dy * ex - dx * ey) <= half and far >= NEAREST_M:
                spread = GOLDEN[0] * (n - first) % 1.0, GOLDEN[1] * (n - first) % 1.0
                _take(n, r, c, weight, spread, seen, samples, table, model)
                n += 1
    samples.size[0] = n
    if n > first:
        rays, main, more = samples.rays, samples.size[1], n - first - samples.size[2]
        here = rays[CX, first], rays[CY, first], rays[CZ, first]
        there = rays[CX, main], rays[CY, main], rays[CZ, main]
        if more > 0 or (more == 0 and here < there):  # of equally many one, whichever head is listed first
            samples.size[1], samples.size[2] = first, n - first


@njit(inline="always")
def samples_of(samples, k):  # type: ignore[no-untyped-def]
    """Those of one person."""
    rays, pixels, layers = samples.rays[k], samples.pixels[k], samples.layers[k]
    return SampleArrays(rays, pixels, layers, samples.counts[k], samples.which[k], samples.size[k])


@kernel
def gather(poses: F64, reach_m: float, seen, samples, table, model) -> None:  # type: ignore[no-untyped-def]
    """Append the samples of one camera within ``reach_m`` of each body to those of that body."""
    for k in range(len(poses)):
        _gather(poses[k], reach_m, seen, samples_of(samples, k), table, model)


@kernel
def take_pixels(pixels: I64, seen, samples, table, model) -> None:  # type: ignore[no-untyped-def]
    """Some pixels of a view become the samples, each weighted by its patches at a range of 1 m."""
    m, cols = model[0], seen.kind.shape[1]
    for n in range(len(pixels)):
        r, c = pixels[n] // cols, pixels[n] % cols
        weight = seen.rays.pixel_sr / (seen.rays.stretch[r, c] * m.patch_m) ** 2
        _take(n, r, c, weight, (0.5, 0.5), seen, samples, table, model)
    samples.size[0] = len(pixels)


@kernel
def map_lacking(points: F32, low_m: F64, cell_m: float, out: F32) -> None:
    """Add what points lack of an explanation, as ``assign_pixels`` gives it, to the cells of a map of the floor."""
    for i in range(points.shape[1]):
        row, col = int((points[0, i] - low_m[0]) / cell_m), int((points[1, i] - low_m[1]) / cell_m)
        out[row, col] += points[3, i]


@kernel
def fresh_points(pixels: I64, lacking: F32, codes: U8, seen, tried_m: F32, deviations, which: I64, out: F32) -> int:  # type: ignore[no-untyped-def]
    """Points of the pixels whose surface is not where it has been tried: x, y, z [m], what they lack of an explanation
    and the colour, in ``out`` (5, M); their indices in ``which``; their number. Forgets what has been tried where
    there is no surface any more.

    ``deviations``: of a body's surface [m], and how many of them make another surface.
    """
    surface_m, changed = deviations
    centre, level, (rows, cols), n = seen.rays.centre_m, seen.rays.level, seen.range_m.shape, 0
    for r in range(rows):
        for c in range(cols):
            if seen.kind[r, c] != SURFACE and seen.kind[r, c] != UNKNOWN:
                tried_m[r, c] = 0.0
    for i in range(len(pixels)):
        r, c = pixels[i] // cols, pixels[i] % cols
        far = seen.range_m[r, c]
        if abs(far - tried_m[r, c]) < changed * math.hypot(surface_m, seen.std_per_m2 * far * far):
            continue
        ex, ey, cos, sin = level[r, c, 0], level[r, c, 1], level[r, c, 2], level[r, c, 3]
        out[0, n], out[1, n] = centre[0] + ex * cos * far, centre[1] + ey * cos * far
        out[2, n], out[3, n], out[4, n], which[n] = centre[2] - sin * far, lacking[i], codes[i], i
        n += 1
    return n
