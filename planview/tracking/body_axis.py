"""Where a body's axis is, given that only its near side faces the camera.

A camera sees the near half of a head or torso, so the centroid of what is visible lies nearer than the body's axis. For
a sphere of radius r, weighted by the image area that each point takes (which is how a camera samples it), the mean of
the visible half lies 2/3 r in front of the centre along the viewing ray; under a depression angle e, that is
2/3 r cos(e) on the floor. A vertical cylinder gives pi/4 r (for horizontal rays). The head is a sphere to within a
centimetre or two but small, so that depth noise and what the matcher draws in from behind it move it; the whole body is
large, but sways about its axis. Both are measured and averaged, each weighted by its variance. All of this is ours; the
paper reports the template's centre (18 cm mean error).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F64
from planview.maps.builder import FloorPoints, Viewpoint
from planview.tracking._axis_kernels import body_and_head, height_histograms, tops

_BIN_M = 0.02
HEAD_STD_M, BODY_STD_M = 0.02, 0.05
"""Deviations of the centroids of head and body from where a sphere and a cylinder have them [m]: a nod; a stride."""
HEAD_NOISE, BODY_NOISE = 0.7, 0.2
"""Shares of a pixel's depth deviation that are left in the centroids: errors of a matcher that smooths agree over about
a head, and a body has a dozen such patches."""


class BodyAxisParams(Params):
    """Sizes of a body, from anthropometric tables (adults, both sexes); our choice."""

    head_radius_m: float = Field(0.095, gt=0.0, le=0.3)
    """Mean horizontal radius of a head with hair [m]: breadth 0.155 m, length 0.195 m, hair and stereo borders 1 cm."""
    head_height_m: float = Field(0.23, gt=0.0, le=0.5)
    """Vertex to chin [m]."""
    body_radius_m: float = Field(0.085, gt=0.0, le=0.5)
    """Mean radius of legs, trunk and head, each weighted by its height [m]: legs 7 cm, half of the trunk's depth of
    24 cm less its rounded sides, head 9.5 cm."""
    cap_m: float = Field(0.04, gt=0.0, le=0.15)
    """The top is found from the area that a head shows in its uppermost part, this high [m]: a few centimetres hold
    enough pixels that one stray match does not decide."""
    area_min: float = Field(0.25, gt=0.0, le=1.0)
    """Share of a whole head's visible area from which its centroid is trusted."""


@dataclass(frozen=True)
class AxisMeasurement:
    """The axis of one person's body on the floor [m]; NaN where nothing of it was visible.

    Attributes:
        x_m, y_m: floor position of the axis.
        visible_m: (x, y) of the centroid of what is visible of the body.
        height_m: top of the head above the floor.
        from_head: False where too little of the head is visible to be measured.
    """

    x_m: float
    y_m: float
    visible_m: tuple[float, float]
    height_m: float
    from_head: bool


UNOBSERVED = AxisMeasurement(math.nan, math.nan, (math.nan, math.nan), math.nan, False)


class BodyAxis:
    """Measures axis and height of people from the points around them.

    Args:
        view: the camera that measured the points.
        height_max_m: H_max [m].
    """

    def __init__(self, view: Viewpoint, height_max_m: float, params: BodyAxisParams | None = None) -> None:
        self.params = params or BodyAxisParams()
        self._view = view
        self._bins = math.ceil(height_max_m / _BIN_M) + 1

    def __call__(self, points: FloorPoints, people_m: F64, radius_m: float) -> list[AxisMeasurement]:
        """Measure all people at once, each point counting for the nearest person.

        Args:
            points: foreground points, world frame.
            people_m: (K, 2) tracked floor positions [m].
            radius_m: how far from them a body reaches [m].
        """
        k = len(people_m)
        if k == 0 or len(points.xyz) == 0:
            return [UNOBSERVED] * k
        p = self.params
        label = np.empty(len(points.xyz), dtype=np.int32)
        histogram = np.empty((k, self._bins))
        height_histograms(points.xyz, points.area, people_m, radius_m, _BIN_M, label, histogram)
        away, depression = self._view.viewing(people_m)
        top = self._top(histogram, depression)
        body, head = np.empty((k, 3)), np.empty((k, 3))
        body_and_head(
            points.xyz, points.area, label, people_m, radius_m,
            top - p.head_height_m, p.head_radius_m, body, head,
        )  # fmt: skip
        whole = p.area_min * math.pi * p.head_radius_m * p.head_height_m / 2
        people = zip(body.tolist(), head.tolist(), away.tolist(), depression.tolist(), top.tolist(), strict=True)
        return [self._measured(*one, whole) for one in people]

    def _measured(
        self, body: list[float], head: list[float], away: list[float], depression: float, top: float, whole: float
    ) -> AxisMeasurement:
        """One person, of centroids and areas of body and head; from ``whole`` on a head's is trusted [m^2]."""
        p = self.params
        from_head = head[2] >= whole
        share = self._head_share(body[0], body[1]) if from_head else 0.0
        x, y = body[0], body[1]
        if from_head:
            x, y = share * head[0] + (1 - share) * x, share * head[1] + (1 - share) * y
        offset = share * (2 / 3) * p.head_radius_m + (1 - share) * (math.pi / 4) * p.body_radius_m
        ahead = offset * math.cos(depression)
        return AxisMeasurement(x + ahead * away[0], y + ahead * away[1], (x, y), top, from_head)

    def _head_share(self, x_m: float, y_m: float) -> float:
        """Weight of the head in the mean of head and body, by their variances there."""
        _, noise_m, _ = self._view.footprint(x_m, y_m, 0.0, sigmas=1.0)
        head, body = HEAD_STD_M**2 + (HEAD_NOISE * noise_m) ** 2, BODY_STD_M**2 + (BODY_NOISE * noise_m) ** 2
        return body / (head + body)

    def _top(self, histogram: F64, depression: F64) -> F64:
        """Height (K,) above which just as much area is visible as a head's cap shows."""
        p = self.params
        # The cap of a sphere under a depression angle: half an ellipse up to the silhouette, and half of its base.
        base = math.sqrt(p.cap_m * (2 * p.head_radius_m - p.cap_m))
        rise = p.head_radius_m - (p.head_radius_m - p.cap_m) * np.cos(depression)
        cap_area = math.pi / 2 * base * (np.minimum(rise, base) + base * np.sin(depression))
        top = np.empty(len(histogram))
        tops(histogram, cap_area, _BIN_M, p.cap_m, top)
        return top
