"""The joint explanation of pixels without ranges: how well people at some places explain every pixel of a mask.

A person is the human model's soft silhouette (Zhang et al. 2008, section 3.1).
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from pydantic import Field

from calib.types import F32, F64, I64, U8
from planview.foreground.gain import Exposure
from planview.maps.view import COLOURED, NO_DEPTH, SURFACE, PixelRays, View, colour_codes
from planview.tracking import body
from planview.tracking.body import BodyPart, BodyTable, build_table
from planview.tracking.explain.explanation import ANYBODY, Explanation, Likelihood, Owners, People, loose_prior
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.samples import Model
from planview.tracking.human_model.model_map import HumanModelMapParams
from planview.tracking.matching import common_areas

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
    """Places where people are expected."""
    seen_on_body: float = Field(0.8, gt=0.5, lt=1)
    """pF, share of a body's pixels that are foreground."""
    seen_on_background: float = Field(0.03, gt=0, lt=0.5)
    """pB, share of the background's pixels that are foreground."""
    seen_near_people: float = Field(0.2, gt=0, lt=1)
    """The same within an arm's reach of a person: arms, shadows and what is carried."""
    hidden: float = Field(0.05, ge=0, lt=1)
    """Probability that furniture hides a pixel on the lower part of somebody who stands."""
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


@cache
def silhouette() -> BodyTable:
    """Table of all depression angles; its ``front`` is not known from a mask, and 0."""
    parts = []
    for low, high, half_m, depth, covers in SILHOUETTE_PARTS:
        parts.append(BodyPart(((low, high, half_m, depth),), SILHOUETTE_BLUR_M, min(covers, SUREST)))
    table = build_table(parts)
    return table._replace(front=np.zeros_like(table.front))


def likelihood_of_masks(p: HumanModelParams) -> Likelihood:
    """Likelihood of pixels without ranges."""
    model = Model(
        body=p.seen_on_body,
        background=p.seen_on_background,
        near_people=p.seen_near_people,
        reach_m=MASK_REACH_M,
        patch_m=p.patch_m,
        patch_px=PATCH_PX,
        spacing_m=SPACING_M,
        colour=p.colour_weight,
        masks=1.0,
        hidden=p.hidden,
        hidden_sitting=p.hidden_sitting,
        hidden_to=HIDDEN_TO,
        sitting_from=0.5 * (1.0 + p.sitting),
        sits=p.low_share,
        sitting=p.sitting,
    )
    return Likelihood.of(model, silhouette())


class PairFit(NamedTuple):
    """Two people compared with the second one alone.

    Attributes:
        evidence: for two against one.
        alone: (5,) pose of the second one alone.
        gain: of that pose on the present one.
    """

    evidence: float
    alone: F64
    gain: float


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
        self.kind: U8 = np.where(view.kind == NO_DEPTH, np.uint8(SURFACE), view.kind)
        self.pixels: I64 = np.flatnonzero(self.kind == SURFACE)
        colour = None
        if view.image is not None and likelihood.model["colour"][0] > 0:
            colour = self._colour(view.image)
        super().__init__((View(rays, self.kind, view.range_m, colour),), likelihood)

    def _colour(self, image: U8) -> U8 | None:
        """(H, W) uint8 colour codes of the surface; None of grey images, and by night: no colours, which is not grey
        clothes."""
        if image.ndim < 3:
            return None
        codes = colour_codes(image, self.pixels.astype(np.int32), Exposure())
        if not COLOURED[codes].any():
            return None
        colour: U8 = np.zeros(self.kind.shape, np.uint8)
        colour.reshape(-1)[self.pixels] = codes
        return colour

    def residual(self, owners: Owners) -> F32:
        """(H, W) float32: what one more person behind all others would gain at some pixels, 0 elsewhere."""
        residual: F32 = np.zeros(self.kind.shape, np.float32)
        residual.reshape(-1)[owners.pixels] = owners.lacking
        return residual

    def rivals(self, people: People, seniority: F64) -> I64:
        """(N,) index of the person of better (N,) seniority who may account for the foreground of each; -1 for none."""
        boxes = self.boxes(0, people.poses, body.TORSO.torso_radius_m).astype(np.float64)
        boxes[:, 2:] -= boxes[:, :2]
        area = boxes[:, 2:].prod(axis=1)
        shared = common_areas(boxes, boxes) / np.maximum(np.minimum(area[:, None], area), 1.0)
        shared[seniority <= seniority[:, None]] = 0.0
        return np.where(shared.max(axis=1, initial=0.0) > RIVAL_OVERLAP, shared.argmax(axis=1), -1)

    def weigh_pair(self, i: int, j: int, people: People, refit: bool = False) -> PairFit:
        """Compare two people with the second alone, who may be anywhere near either.

        Args:
            refit: move both to where they explain most together.
        """
        poses = people.poses
        statures = people.statures.copy()
        if refit:
            statures[j] = ANYBODY
        judged = people._replace(statures=statures)
        shared = self.share_rays(poses)
        shared[:, [i, j]] = False
        rest = np.flatnonzero(shared[i] | shared[j])
        # The same pixels with the same weights for one and for two.
        reach_m = 0.4 + 0.5 * math.dist(poses[i, :2], poses[j, :2])
        samples = self.samples_around(0.5 * (poses[i] + poses[j]), reach_m)
        samples.lay_others(people, rest)
        here = samples.evidence(*judged.person(j))
        prior = loose_prior(MASK_REACH_M, body.HEIGHT_STD_M)
        fits: list[tuple[float, F64]] = []
        for start in (poses[j], np.array([*poses[i, :2], *poses[j, 2:]])):
            pose = start.copy()
            # How tall the one is may have been learned without what the other covers.
            value, _ = samples.ascend(pose, start, prior, ANYBODY, people.ratios[j])
            fits.append((value, pose))
        one, alone = max(fits, key=lambda fit: fit[0])
        if refit:
            for a, b in ((j, i), (i, j)):
                samples.lay_others(people, np.append(rest, b))
                pose, stature, ratios = judged.person(a)
                samples.ascend(pose, pose.copy(), prior, stature, ratios)
        samples.lay_others(people, rest)
        both = samples.log_ratio(*judged.person(i)) + samples.log_prior(poses[j], statures[j])
        both += samples.log_prior(poses[i], statures[i], np.append(rest, j))
        samples.lay_others(people, np.append(rest, i))
        both += samples.log_ratio(*judged.person(j))
        return PairFit(both - one - TOGETHER, alone, one - here)
