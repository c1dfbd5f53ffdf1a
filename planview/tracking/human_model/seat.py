"""A place where a person sits, and whether it is still taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F32, F64, U8, Bool
from planview.tracking.human_model.params import PostureParams

HEAD_SHARE = 1 / 3
"""Upper part of a seated silhouette that leaves first: the legs of a person who walks off towards the camera
cover the rest longer (our choice)."""
MIN_VISIBLE = 0.3
"""Smallest visible part of a silhouette that tells whether it is still there (our choice)."""
SILHOUETTE_GAIN = 0.05
"""Smallest share of a frame in the remembered silhouette (our choice): a mean while the person settles, later it
follows a shift on the chair within seconds."""


@dataclass(slots=True, eq=False)
class Seat:
    """A taken seat and the silhouette observed there: the place stays while others pass in front of it.

    What is remembered of the silhouette tells whether the seat is empty better than the model does: backs of chairs
    and tables hide half of a seated body, so that it never fills the model.

    Attributes:
        xy: (2,) on the floor [m].
        since_s: when the person sat down [s].
        scale: of the model there.
        window: rows and columns of the image around the model.
        model: (h, w) bool, the model within the window.
        silhouette: (h, w) float32 share of the frames in which a pixel was foreground.
        empty_since_s: since when it has looked empty, NaN if it does not.
        frames: how many the silhouette was learned from.
    """

    xy: F64
    since_s: float
    scale: float
    window: tuple[slice, slice]
    model: Bool
    silhouette: F32
    empty_since_s: float = np.nan
    frames: int = 1

    def observe(self, evidence: U8, cover: U8, now_s: float, params: PostureParams) -> float:
        """Remember what is visible of the person now, and for how long nothing has been.

        Args:
            evidence: (H, W) uint8, not 0 in the foreground.
            cover: (H, W) uint8 number of models on each pixel, this one included.
        Returns:
            the smaller of the shares of the silhouette and of its upper part that are still there; NaN where too much
            of both is hidden.
        """
        visible = cover[self.window] <= self.model
        there = evidence[self.window] > 0
        # Other people may be beside the model.
        known = (self.silhouette > 0.5) & self.model
        rows = np.flatnonzero(known.any(axis=1))
        if len(rows):
            neck = rows[0] + round(HEAD_SHARE * (rows[-1] + 1 - rows[0]))
            whole = _kept(known, visible, there)
            kept = float(np.fmin(whole, _kept(known[:neck], visible[:neck], there[:neck])))
        else:
            whole = kept = 0.0
        if whole >= params.empty:
            self.frames += 1
            gain = np.float32(max(SILHOUETTE_GAIN, 1.0 / self.frames))
            self.silhouette += gain * visible * (there - self.silhouette)
        if np.isnan(kept) or kept >= params.empty:
            self.empty_since_s = np.nan
        elif np.isnan(self.empty_since_s):
            self.empty_since_s = now_s
        return kept


def _kept(known: Bool, visible: Bool, there: Bool) -> float:
    """Share of the visible part of a silhouette (h, w) that is still foreground; NaN where too little is visible."""
    expected = int(np.count_nonzero(known & visible))
    if expected < MIN_VISIBLE * np.count_nonzero(known):
        return float("nan")
    return np.count_nonzero(known & visible & there) / max(1, expected)
