"""Arrays that the kernels of the joint explanation share: what is assumed, what a camera saw, pixels near people."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.types import F32, F64, I64, U8, AnyArray

PARTS = 3
LEGS_TO, TORSO_TO = 0.45, 0.85
"""Relative heights at which the hip and the shoulders are (Zhang et al. 2008, table 1)."""
LAYERS = 4
"""Other people on one ray, the nearest first."""
AT, THROUGH, BEFORE, REST, WHO = range(5)
"""Rows of ``SampleArrays.layers``."""
CX, CY, CZ, EX, EY, COS, SIN, ACROSS, UP, AHEAD = range(10)
"""Rows of ``SampleArrays.rays``."""
MAX_SAMPLES = 4000
TINY = 1e-12


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
of the ray [of TURNS], less an even spread over one of them, so that samples of a direction between two tables take both
in its proportion, and the share of a lean from which they lean; index of the depression in the body's table; whether
somebody else reaches there."""


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
    """One view as kernels take it: what ``PixelRays`` and ``View`` hold, and

    Attributes:
        std_per_m2: deviation of a range over its square, in the middle of the image [1/m].
    """

    centre_m: F64
    projection: F64
    distortion_k: float
    pixel_sr: float
    std_per_m2: float
    level: F32
    stretch: F32
    matched_m: F32
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
    """

    rays: F32
    pixels: AnyArray
    layers: F32
    counts: I64
    which: I64
    size: I64

    @staticmethod
    def of(people: int, n: int = MAX_SAMPLES) -> SampleArrays:
        """Room for n samples of each of some people, of which none is there."""
        return SampleArrays(
            np.empty((people, 10, n), np.float32), np.empty((people, n), PIXEL),
            np.empty((people, n, 5, LAYERS + 1), np.float32), np.empty((people, n), np.int64),
            np.empty((people, n), np.int64), np.zeros((people, 1), np.int64),
        )  # fmt: skip

    def person(self, k: int) -> SampleArrays:
        """Those of one person."""
        return SampleArrays._make(array[k] for array in self)
