"""Assumptions of the joint tracker about pixels with ranges."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from pydantic import Field

from planview.maps.view import SURFACE, UNKNOWN, View
from planview.tracking import body
from planview.tracking.explain.explanation import Likelihood
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.samples import Model

OUTLIERS = 0.08
"""Share of a body's disparities that are wrong."""
SEEN_ON_BODY = 0.93
"""pF, share of a body's pixels that are foreground."""
SEEN_ON_BACKGROUND = 0.03
"""pB, share of the background's pixels that are foreground."""
NO_DEPTH_SHARE = 0.15
"""Share of a body's foreground without disparity."""
RANGE_M = 6.0
"""Depth over which wrong disparities spread [m]."""
UNKNOWN_SHARE = 0.02
"""kappa, share of the pixels before which something unknown stands."""
SPACING = 0.7
"""Distance of samples on a body [patches]."""
OUTLINE = np.ones((5, 5), np.uint8)
"""Pixels around one that may be on the other side of an outline: colour and depth mislay it by two."""


class JointParams(PeopleParams):
    """Assumptions about people and pixels with ranges; all values are physical."""

    disparity_std_px: float = Field(0.35, gt=0, le=5)
    """Deviation of a disparity on a body [px of the matched image]: matching noise and its bias to whole pixels."""
    floor_m2: float = Field(20.0, gt=0.1, le=10000)
    """Area of the floor over which strangers may appear [m^2]."""


def likelihood_of_ranges(p: JointParams) -> Likelihood:
    """Likelihood of pixels with ranges."""
    model = Model(
        body=SEEN_ON_BODY,
        background=SEEN_ON_BACKGROUND,
        near_people=p.seen_near_people,
        reach_m=body.REACH_M,
        patch_m=p.patch_m,
        spacing_m=SPACING * p.patch_m,
        colour=p.colour_weight,
        range_m=RANGE_M,
        no_depth=NO_DEPTH_SHARE,
        outliers=OUTLIERS,
        unknown=UNKNOWN_SHARE,
        surface_var=body.SURFACE_STD_M**2,
        low_share=p.low_share,
    )
    return Likelihood.of(model, body.body_table(), p.disparity_std_px)


def hide_outlines(view: View) -> View:
    """The view without the surfaces next to what is more than an arm's length nearer: they show where its outline was
    mislaid as often as somebody behind it."""
    is_surface = view.kind == SURFACE
    away_m = np.where(is_surface, view.range_m * view.rays.level[..., 2], np.inf)
    is_behind = is_surface & (away_m > cv2.erode(away_m, OUTLINE) + body.REACH_M)
    return replace(view, kind=np.where(is_behind, np.uint8(UNKNOWN), view.kind))
