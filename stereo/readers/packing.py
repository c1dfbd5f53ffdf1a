"""How two cameras share one picture: side by side or one above the other, whole or squeezed to half."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.images import as_grey
from calib.types import F64, U8
from stereo.vertical import VerticalParams, match_corners

Size = tuple[int, int]
Halves = tuple[U8, U8]

REDUCED_PX = 320
"""Width to which halves are reduced for matching."""
SEARCH = VerticalParams(features=150, search_px=24)
"""Rows of unrectified cameras may be 24 of 320 px apart."""
REACH = 0.3
"""Disparities are searched up to this share of the width, each way (our choice)."""
ROW_SPREAD_PX = 4.0
"""Matches of one pair of cameras lie about on one row offset [px of 320] (our choice)."""
MIN_MATCHED = 0.12
"""Share of the corners that two views of one scene have in common at least (our choice: real pairs have 0.3 to 0.8,
halves of one picture under 0.03)."""
MIN_CORNERS = 20
"""Fewer corners in a picture tell nothing (our choice)."""


@dataclass(frozen=True)
class Packing:
    """Where the two views lie in a picture.

    Attributes:
        stacked: one above the other, else side by side.
        squeezed: each was reduced to half along the axis on which they share the picture, and is stretched again.
    """

    stacked: bool
    squeezed: bool

    def size(self, picture: Size) -> Size:
        """(width, height) of one view as it is given [px]."""
        width, height = picture
        if self.squeezed:
            return picture
        return (width, height // 2) if self.stacked else (width // 2, height)

    def split(self, picture: U8) -> Halves:
        """The first (left or upper) and the second view."""
        height, width = picture.shape[:2]
        if self.stacked:
            parts = picture[: height // 2], picture[height // 2 : height // 2 * 2]
        else:
            parts = picture[:, : width // 2], picture[:, width // 2 : width // 2 * 2]
        first, second = (self._given(part, (width, height)) for part in parts)
        return first, second

    def _given(self, part: U8, picture: Size) -> U8:
        if not self.squeezed:
            return np.ascontiguousarray(part)
        return np.asarray(cv2.resize(part, picture, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)

    @property
    def text(self) -> str:
        """For people."""
        kind = "one above the other" if self.stacked else "side by side"
        return kind + (", squeezed to half" if self.squeezed else "")


@dataclass(frozen=True, eq=False)
class Common:
    """What the two views of some pictures have in common.

    Attributes:
        corners: that were looked for.
        matches: (N, 4) float64 [px of the view as it is given]: u, v in the first view, u, v in the second.
    """

    corners: int
    matches: F64

    @property
    def fraction(self) -> float:
        return len(self.matches) / self.corners if self.corners else 0.0


def common(pictures: Iterable[U8], split: Callable[[U8], Halves]) -> Common:
    """Match corners between the two views of each picture."""
    corners, found = 0, [np.empty((0, 4))]
    for picture in pictures:
        first, second = (as_grey(view) for view in split(picture))
        reduced, scale = (_reduced(view) for view in (first, second)), first.shape[1] / min(first.shape[1], REDUCED_PX)
        a, b = reduced
        points = cv2.goodFeaturesToTrack(a, SEARCH.features, 0.01, 14.0)
        corners += 0 if points is None else len(points)
        reach = REACH * a.shape[1]
        matches = match_corners(a, b, reach, SEARCH, -reach)
        if len(matches):
            near = np.abs(matches[:, 3] - np.median(matches[:, 3])) <= ROW_SPREAD_PX
            u, v, u_second, offset = matches[near].T
            found.append(np.column_stack([u, v, u_second, v + offset]) * scale)
    return Common(corners, np.concatenate(found))


def find_packing(pictures: Sequence[U8], aspect: float | None) -> tuple[Packing | None, Common]:
    """The packing whose two views have most in common.

    Args:
        aspect: width over height of one camera's images by the calibration; None when unknown.
    Returns:
        None when no packing gives two views of one scene, and what the best one has in common.
    """
    height, width = pictures[0].shape[:2]
    candidates = _possible((width, height), aspect) or _possible((width, height), None)
    if not candidates:
        return None, Common(0, np.empty((0, 4)))
    shared = {packing.stacked: common(pictures, packing.split) for packing in candidates}
    best = max(candidates, key=lambda packing: shared[packing.stacked].fraction)
    found = shared[best.stacked]
    if found.corners < MIN_CORNERS:  # nothing to tell by: what is most usual for the size
        return (None if candidates[0].squeezed else candidates[0]), found
    return (best if found.fraction >= MIN_MATCHED else None), found


def _possible(picture: Size, aspect: float | None) -> list[Packing]:
    """Packings that give views of a camera's aspect, the most usual first."""
    width, height = picture
    usual = ((False, False, 1.2, 3.4), (True, False, 1.2, 2.6), (False, True, 1.2, 2.4), (True, True, 1.2, 2.4),
             (False, False, 0.9, 1.2), (True, False, 0.9, 1.2))  # fmt: skip
    found: list[Packing] = []
    for stacked, squeezed, low, high in usual:
        packing = Packing(stacked, squeezed)
        w, h = packing.size(picture)
        if height % 2 if stacked else width % 2:
            continue
        fits = low <= w / h < high if aspect is None else abs(w / h / aspect - 1.0) < 0.02
        if fits and packing not in found and not any(p.stacked == stacked for p in found):
            found.append(packing)
    return found


def _reduced(view: U8) -> U8:
    if view.shape[1] <= REDUCED_PX:
        return view
    height = round(view.shape[0] * REDUCED_PX / view.shape[1])
    return np.asarray(cv2.resize(view, (REDUCED_PX, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
