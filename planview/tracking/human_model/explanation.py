"""How well people at some places explain every pixel of a mask: the joint explanation of pixels without ranges.

A person is the human model's soft silhouette (Zhang et al. 2008, section 3.1).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from pydantic import Field

from calib.types import F32, F64, I64, U8
from planview.foreground.gain import Exposure
from planview.maps.view import COLOURED, NO_DEPTH, SURFACE, PixelRays, View, colour_codes
from planview.tracking import body
from planview.tracking.body import BodyTable, Part, table_of
from planview.tracking.detections import common
from planview.tracking.explain.explanation import ANYBODY, Explanation, Likelihood, Owned, People, about
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.samples import Model
from planview.tracking.human_model.model_map import HumanModelMapParams

SPACING_M = 0.05
"""Distance of samples on a body [m]."""
PATCH_PX = 3.0
"""Errors of pixels nearer than this in the image are one error, however far away people are [px]."""
MASK_REACH_M = 0.6
"""From the body's axis to hands and feet that the silhouette does not expect, and to shadows [m]."""
HIDDEN_TO = 0.6
"""Relative height below which furniture may hide people."""
RIVAL_OVERLAP = 0.3
"""Share of the smaller of two boxes that they have in common when two people are rivals for the same foreground."""
TOGETHER = 4.0
"""Price of a second person in a first one's outline [log-odds]: that one walks half hidden by another all the time is
seldom (section 4: merging)."""


SILHOUETTE_PARTS = (
    (0.00, 0.27, 0.28, 1.0, 0.3),
    (0.00, 0.27, 0.13, 1.0, 0.5),
    (0.27, 0.48, 0.17, 0.8, 0.85),
    (0.45, 0.82, 0.23, 0.65, 1.0),
    (0.42, 0.80, 0.29, 0.8, 0.5),
    (0.82, 0.86, 0.16, 0.65, 1.0),
    (0.86, 0.98, 0.10, 1.0, 1.0),
    (0.98, 1.00, 0.07, 1.0, 1.0),
)
"""Striding legs, shins, thighs, torso, arms, shoulders, head, crown: from and to [of the height], half breadth [m] of a
body of 1.76 m, depth over breadth, and how often it covers (Zhang's cylinders, as wide as arms and a stride)."""
SILHOUETTE_BLUR_M = 0.035
"""Deviation of the outline [m]: clothes and posture."""
SUREST = 0.999
"""No part covers for certain: in a mask the seams between parts are as unsure as the outline."""


class HumanModelParams(PeopleParams):
    """Assumptions about masks, bodies and walking, and how people come and go (Zhang et al. 2008; values are ours)."""

    map: HumanModelMapParams = HumanModelMapParams()
    """Where people are expected."""
    seen_on_body: float = Field(0.8, gt=0.5, lt=1)
    """pF, share of a body's pixels that are foreground."""
    seen_on_background: float = Field(0.03, gt=0, lt=0.5)
    """pB, share of the background's pixels that are foreground."""
    seen_near_people: float = Field(0.2, gt=0, lt=1)
    """The same within an arm's reach of a person: arms, shadows and what is carried."""
    hidden: float = Field(0.05, ge=0, lt=1)
    """How probably furniture hides a pixel on the lower part of somebody who stands."""
    hidden_sitting: float = Field(0.5, ge=0, lt=1)
    """The same of somebody who sits."""
    patch_m: float = Field(0.2, gt=0.01, le=1)
    """Errors of pixels nearer than this on a body are one error [m]."""
    sitting: float = Field(0.77, gt=0.3, lt=0.95)
    """Height of a person who sits over the height when standing: from the seat to the top of the head 0.52 of the
    stature, and a seat 0.45 m high."""
    birth_visible: float = Field(0.3, gt=0, le=1)
    """Visibility ratio from which newcomers are looked for (section 4: visibility criterion), and below which a person
    has left: whoever shows there next is a stranger."""
    walked_m: float = Field(0.4, ge=0, le=5)
    """Distance that a newcomer must walk to count as a person [m] (section 4: motion salience): a torso's width."""
    inanimate_s: float = Field(20.0, gt=0, le=600)
    """Time without any motion after which something that has moved by a metre is a thing [s] (section 4: the chair);
    a person who walked farther is kept for longer in proportion."""
    window_s: float = Field(0.8, gt=0, le=10)
    """Time over which motion and trends are judged [s]: one and a half steps."""
    moving_mps: float = Field(0.25, gt=0, le=3)
    """Speed from which a person is moving [m/s]: swaying is slower."""
    internal_motion: float = Field(0.04, gt=0, lt=1)
    """Share of a body in motion that is internal motion: a hand or the head."""
    trend: float = Field(0.1, gt=0, lt=1)
    """Change of the visible share within the window that is appearing or disappearing."""
    still_s: float = Field(3.0, gt=0, le=600)
    """Time without motion after which foreground that nobody explains is background [s], and a newcomer a thing."""


@lru_cache(maxsize=1)
def silhouette() -> BodyTable:
    """The table of all depression angles; its ``front`` is not known from a mask, and 0."""
    table = table_of(
        [
            Part(((low, high, half_m, depth),), SILHOUETTE_BLUR_M, min(covers, SUREST))
            for low, high, half_m, depth, covers in SILHOUETTE_PARTS
        ]
    )
    return table._replace(front=np.zeros_like(table.front))


def likelihood_of_masks(p: HumanModelParams) -> Likelihood:
    """For pixels without ranges."""
    model = Model(
        body=p.seen_on_body, background=p.seen_on_background, near_people=p.seen_near_people, hidden=p.hidden,
        hidden_sitting=p.hidden_sitting, hidden_to=HIDDEN_TO, sitting_from=0.5 * (1.0 + p.sitting), no_depth=0.0,
        outliers=0.0, range_m=1.0, unknown=0.0, surface_var=0.0, colour=p.colour_weight, low_share=0.0,
        sits=p.low_share, sitting=p.sitting, masks=1.0, patch_m=p.patch_m, patch_px=PATCH_PX, spacing_m=SPACING_M,
        body_m=body.TORSO.height_m, reach_m=MASK_REACH_M, apart_m=body.APART_M,
        height_min_m=body.HEIGHT_MIN_M, height_max_m=body.HEIGHT_MAX_M, lean_std_m=body.LEAN_STD_M,
    )  # fmt: skip
    return Likelihood.of(model, silhouette())


class MaskExplanation(Explanation):
    """One frame of one camera.

    Args:
        rays: of the camera.
        view: of its mask.

    Attributes:
        kind: (H, W) uint8 of BACKGROUND_SEEN, SHADED, SURFACE and UNKNOWN.
        pixels: (K,) int64, those of SURFACE.
    """

    def __init__(self, rays: PixelRays, view: View, likelihood: Likelihood) -> None:
        image, coloured = view.image, likelihood.model[0]["colour"] > 0
        self.kind: U8 = np.where(view.kind == NO_DEPTH, np.uint8(SURFACE), view.kind)
        self.pixels: I64 = np.flatnonzero(self.kind == SURFACE)
        code: U8 | None = None
        if image is not None and image.ndim == 3 and coloured:
            codes = colour_codes(image, self.pixels.astype(np.int32), Exposure())
            if COLOURED[codes].any():  # else by night: no colours, which is not grey clothes
                code = np.zeros(self.kind.shape, np.uint8)
                code.reshape(-1)[self.pixels] = codes
        super().__init__((View(rays, self.kind, view.range_m, code),), likelihood)

    def residual(self, owned: Owned) -> F32:
        """(H, W) float32: what one more person behind all others would gain at some pixels, 0 elsewhere."""
        residual: F32 = np.zeros(self.kind.shape, np.float32)
        residual.reshape(-1)[owned.pixels] = owned.lacking
        return residual

    def rivals(self, people: People, standing: F64) -> I64:
        """(N,) the person of better (N,) standing who may account for the foreground of each; -1 for none."""
        boxes = self.boxes(0, people.poses, body.TORSO.torso_radius_m).astype(np.float64)
        boxes[:, 2:] -= boxes[:, :2]
        area = boxes[:, 2:].prod(axis=1)
        shared = common(boxes, boxes) / np.maximum(np.minimum(area[:, None], area), 1.0)
        shared[standing <= standing[:, None]] = 0.0
        return np.where(shared.max(axis=1, initial=0.0) > RIVAL_OVERLAP, shared.argmax(axis=1), -1)

    def pair(self, i: int, j: int, people: People, refit: bool = False) -> tuple[float, F64, float]:
        """Evidence for two people against the second alone, who may be anywhere near either; the (5,) pose of this one
        alone, and how much that gains on its present pose. ``refit`` moves both to where they explain most together."""
        poses, tall, ratios = people.poses, people.tall.copy(), people.ratios
        if refit:
            tall[j] = ANYBODY
        touch = self.touching(poses)
        touch[:, [i, j]] = False
        rest = np.flatnonzero(touch[i] | touch[j])
        # The same pixels with the same weights for one and for two.
        samples = self.around(0.5 * (poses[i] + poses[j]), 0.4 + 0.5 * math.dist(poses[i, :2], poses[j, :2]))
        samples.layer(people, rest)
        here, information = samples.evidence(poses[j], tall[j], ratios[j]), about(MASK_REACH_M, body.HEIGHT_STD_M)
        fits: list[tuple[float, F64]] = []
        for start in (poses[j], np.array([*poses[i, :2], *poses[j, 2:]])):
            moved = start.copy()
            # How tall the one is may have been learned without what the other covers.
            fits.append((samples.ascend(moved, start, information, ANYBODY, ratios[j])[0], moved))
        value, alone = max(fits, key=lambda fit: fit[0])
        for a, b in ((j, i), (i, j)) if refit else ():
            samples.layer(people, np.append(rest, b))
            samples.ascend(poses[a], poses[a].copy(), information, tall[a], ratios[a])
        samples.layer(people, rest)
        both = samples.log_ratio(poses[i], tall[i], ratios[i]) + samples.log_prior(poses[j], tall[j])
        both += samples.log_prior(poses[i], tall[i], np.append(rest, j))
        samples.layer(people, np.append(rest, i))
        both += samples.log_ratio(poses[j], tall[j], ratios[j])
        return both - value - TOGETHER, alone, value - here
