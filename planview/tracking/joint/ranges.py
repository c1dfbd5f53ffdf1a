"""What the joint tracker assumes of pixels with ranges."""

from __future__ import annotations

from pydantic import Field

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


class JointParams(PeopleParams):
    """Of pixels with ranges; all values are physical."""

    disparity_std_px: float = Field(0.35, gt=0, le=5)
    """Deviation of a disparity on a body [px of the matched image]: matching noise and its bias to whole pixels."""
    floor_m2: float = Field(20.0, gt=0.1, le=10000)
    """Area of the floor over which strangers may appear [m^2]."""


def likelihood_of_ranges(p: JointParams) -> Likelihood:
    """For pixels with ranges."""
    table = body.body_table()
    model = Model(
        body=SEEN_ON_BODY, background=SEEN_ON_BACKGROUND, near_people=p.seen_near_people, hidden=0.0,
        hidden_sitting=0.0, hidden_to=0.0, sitting_from=0.0, no_depth=NO_DEPTH_SHARE, outliers=OUTLIERS,
        range_m=RANGE_M, unknown=UNKNOWN_SHARE, surface_var=body.SURFACE_STD_M**2, colour=p.colour_weight,
        low_share=p.low_share, sits=0.0, sitting=1.0, masks=0.0, patch_m=p.patch_m, patch_px=0.0,
        spacing_m=SPACING * p.patch_m, body_m=body.TORSO.height_m, reach_m=body.REACH_M, apart_m=body.APART_M,
        height_min_m=body.HEIGHT_MIN_M, height_max_m=body.HEIGHT_MAX_M, lean_std_m=body.LEAN_STD_M,
    )  # fmt: skip
    return Likelihood.of(model, table, p.disparity_std_px)
