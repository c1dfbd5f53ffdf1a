"""Depth of some frames as it may be meant, and how plausible the floor in it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.doubt import Score
from calib.errors import WorkError
from calib.floor.plane import MIN_PATCH
from calib.rig import Floor
from calib.types import F32, U8, AnyArray
from stereo.depth import RectifiedGeometry, back_project
from stereo.floor import FITTED_STEP_PX, FloorSearch, floor_in, moved_patches

NEAREST_M = 0.4
FARTHEST_M = 20.0
"""Median depth of views with people in them [m]; other readings of depth need no search for a floor."""
CAMERA_M = 2.5
"""Median height of cameras above floors [m]."""
CAMERA_SPREAD = 0.5
"""Deviation of its logarithm (see ``calib.floor.plane``)."""
PERSON_M = 1.7
"""Height of the taller of what moves, mostly adults [m]."""
PERSON_STD_M = 0.15
"""Its deviation with that of the measurement [m]."""
PERSON_STDS_MAX = 5.0
"""Largest deviation of what moves that still speaks against a floor: a larger one may be a door."""
PEOPLE = 8.0
"""Likelihood ratio of something of a person's height above a right floor and above another, where any height up to 3 m
occurs."""
NO_FLOOR = -6.0
"""Plausibility of a view without a floor: a camera may show none, but rarely does."""
PLAUSIBLE = -6.0
"""Least plausibility of a floor that explains anything: a tenth of the depth 9 m below, or people of 1.3 m or 2.1 m."""


class StoredDepth(NamedTuple):
    """Depth as stored, with its images.

    Attributes:
        images, values: of each frame.
        units_per_m: values per metre.
        ray: (H, W) length of each pixel's ray at unit depth.
        rectified: makes (H, W) float32 depth [m] as measured into that of the geometry.
    """

    images: Sequence[U8]
    values: Sequence[AnyArray]
    units_per_m: float
    ray: F32
    rectified: Callable[[U8, F32], F32]

    @property
    def usual(self) -> float:
        """The usual value; NaN without any."""
        medians = [float(np.median(values[values > 0])) for values in self.values if (values > 0).any()]
        return float(np.median(medians)) if medians else math.nan


@dataclass(frozen=True, eq=False)
class DepthScene:
    """(H, W) float32 depth of some frames [m], NaN where unknown, and its geometry; of depth cameras also as stored."""

    depths: Sequence[F32]
    geometry: RectifiedGeometry
    stored: StoredDepth | None = None

    def read(self, metres: Callable[[AnyArray, StoredDepth], F32]) -> DepthScene:
        """Depth made of the stored values in another way; itself without these."""
        stored = self.stored
        if stored is None:
            return self
        pairs = zip(stored.images, stored.values, strict=True)
        depths = [stored.rectified(image, np.asarray(metres(values, stored), np.float32)) for image, values in pairs]
        return replace(self, depths=depths)

    def turn(self, quarters: int) -> DepthScene:
        """The view turned counterclockwise by quarter turns."""
        scene = self
        for _ in range(quarters):
            g = scene.geometry
            geometry = replace(
                g, width=g.height, height=g.width, focal_u_px=g.focal_v_px, focal_v_px=g.focal_u_px, cu_px=g.cv_px,
                cv_px=g.width - 1 - g.cu_px, baseline_m=g.disparity_metre / g.focal_v_px,
            )  # fmt: skip
            depths = [np.ascontiguousarray(np.rot90(depth)) for depth in scene.depths]
            scene = replace(scene, depths=depths, geometry=geometry)
        return scene

    def scale(self, factor: float) -> DepthScene:
        """The view of cameras that are this many times as far apart."""
        geometry = replace(self.geometry, baseline_m=self.geometry.baseline_m * factor)
        return replace(self, depths=[depth * np.float32(factor) for depth in self.depths], geometry=geometry)


class FloorView(NamedTuple):
    """The floor in some depth, None where none is found, and how plausible it is with what moves above it: the
    logarithm of its share of the depth, and of how usual the heights of camera and people are."""

    floor: Floor | None = None
    plausible: float = NO_FLOOR

    def __str__(self) -> str:
        return f"the floor is {self.floor.height_m:.2f} m below the camera" if self.floor else "no floor is found"


def floor_view(scene: DepthScene, search: FloorSearch) -> FloorView:
    known = np.concatenate([np.empty(0), *(depth[::8, ::8].ravel() for depth in scene.depths)])
    known = known[np.isfinite(known)]
    if not len(known) or not NEAREST_M < np.median(known) < FARTHEST_M:
        return FloorView()
    try:
        floor = floor_in(scene.depths, scene.geometry, search.floor)
    except WorkError:
        return FloorView()
    off = math.log(floor.height_m / CAMERA_M) / CAMERA_SPREAD
    plausible = math.log(max(floor.inlier_fraction, 1e-6)) - 0.5 * off**2
    tops_m = []
    grids = [back_project(depth, scene.geometry)[::FITTED_STEP_PX, ::FITTED_STEP_PX] for depth in scene.depths]
    for patch in moved_patches(grids):
        if len(patch) >= MIN_PATCH:
            points = floor.world_SE3_left @ patch
            tops_m.append(np.percentile(points[:, 2], 95))
    if tops_m:
        stds = abs(float(np.percentile(tops_m, 75)) - PERSON_M) / PERSON_STD_M
        plausible += math.log(PEOPLE) - 0.5 * min(stds, PERSON_STDS_MAX) ** 2
    return FloorView(floor, plausible)


def floor_score(view: FloorView, before: FloorView) -> Score:
    """Plausibility of the floor of a view; ``before`` is the view as recorded."""
    instead = f" in place of {before.floor.height_m:.2f} m" if before.floor else ""
    return Score(max(view.plausible, NO_FLOOR), f"{view}{instead}")
