"""How well people at some places explain every pixel of a mask: the joint explanation of pixels without ranges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.types import F32, F64, I64, U8
from planview.foreground.gain import Exposure
from planview.maps.view import COLOURED, NO_DEPTH, SURFACE, PixelRays, View, colour_codes
from planview.tracking import body
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.silhouette import silhouette
from planview.tracking.joint.explanation import ANYBODY, Explanation, Likelihood, Owned, People, about
from planview.tracking.joint.samples import Model

SPACING_M = 0.05
"""Distance of samples on a body [m]."""
PATCH_PX = 3.0
"""Errors of pixels nearer than this in the image are one error, however far away people are [px]."""
NEAR_M = 0.6
"""From the body's axis to hands and feet that the silhouette does not expect, and to shadows [m]."""
HIDDEN_TO = 0.6
"""Relative height below which furniture may hide people."""
RIVAL_OVERLAP = 0.3
"""Share of the smaller of two boxes that they have in common when two people are rivals for the same foreground."""
TOGETHER = 4.0
"""Price of a second person in a first one's outline [log-odds]: that one walks half hidden by another all the time is
seldom (section 4: merging)."""


def likelihood_of_masks(p: HumanModelParams) -> Likelihood:
    """For pixels without ranges."""
    table = silhouette()
    model = Model(
        body=p.seen_on_body, background=p.seen_on_background, near_people=p.seen_near_people, hidden=p.hidden,
        hidden_sitting=p.hidden_sitting, hidden_to=HIDDEN_TO, sitting_from=0.5 * (1.0 + p.sitting), no_depth=0.0,
        outliers=0.0, range_m=1.0, unknown=0.0, surface_var=0.0, colour=p.colour_weight, low_share=0.0,
        sits=p.low_share, sitting=p.sitting, masks=1.0, patch_m=p.patch_m, patch_px=PATCH_PX, spacing_m=SPACING_M,
        body_m=body.TORSO.height_m, reach_m=NEAR_M, apart_m=body.APART_M,
        height_min_m=body.HEIGHT_MIN_M, height_max_m=body.HEIGHT_MAX_M, lean_std_m=body.LEAN_STD_M,
    )  # fmt: skip
    return Likelihood.of(model, table)


class Pair(NamedTuple):
    """Two people against one.

    Attributes:
        evidence: for two.
        alone: (5,) pose of one alone.
        gain: how much that gains on the second's present pose.
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
        kind: (H, W) uint8 of BACKGROUND_SEEN, SHADOW, SURFACE and UNKNOWN.
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
        low, high = boxes[:, :2], boxes[:, 2:]
        sides = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
        area = (high - low).prod(axis=1)
        common = np.maximum(sides, 0.0).prod(axis=2) / np.maximum(np.minimum(area[:, None], area), 1.0)
        common[standing <= standing[:, None]] = 0.0
        return np.where(common.max(axis=1, initial=0.0) > RIVAL_OVERLAP, common.argmax(axis=1), -1)

    def pair(self, i: int, j: int, people: People, refit: bool = False) -> Pair:
        """Evidence for two people against the second alone, who may be anywhere near either.

        Args:
            refit: move both to where they explain most together.
        """
        poses, tall, ratios = people.poses, people.tall.copy(), people.ratios
        if refit:
            tall[j] = ANYBODY
        touch = self.touching(poses)
        touch[:, [i, j]] = False
        rest = np.flatnonzero(touch[i] | touch[j])
        # The same pixels with the same weights for one and for two.
        samples = self.around(0.5 * (poses[i] + poses[j]), 0.4 + 0.5 * math.dist(poses[i, :2], poses[j, :2]))
        samples.layer(people, rest)
        here, information = samples.evidence(poses[j], tall[j], ratios[j]), about(NEAR_M, body.HEIGHT_STD_M)
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
        return Pair(both - value - TOGETHER, alone, value - here)
