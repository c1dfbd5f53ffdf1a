"""The human model map: how a person looks at every pixel of a camera (Zhang et al. 2008, section 3.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike
from pydantic import Field

from calib.ground_camera import GroundCamera
from calib.params import Params
from calib.people.model import HumanModel
from calib.types import F32, F64, I32

MAX_NODES = 4_000_000
"""Refuse to allocate larger model maps."""
MIN_VISIBLE = 0.05
"""Visible fraction of the model below which no person is expected (our choice)."""


class HumanModelMapParams(Params):
    """Limits of the places where people are expected."""

    max_distance_m: float = Field(default=60.0, gt=0, le=500)
    """Farthest floor point, measured along the floor from below the camera [m]. Our choice: beyond it a person
    of 1.76 m is under 10 px tall in a 480-line image of usual focal length."""
    step_px: int = Field(default=4, ge=1, le=64)
    """Distance of the foot pixels held in the map [px]; between them the nearest is taken. Our choice: half a step
    is about the error of a foreground outline."""
    min_height_px: float = Field(default=20.0, ge=0, le=1000)
    """Longest side of a person's box in the image below which no person is expected [px]. Our choice: a known person
    can be followed until the legs are a pixel wide each."""


@dataclass(frozen=True, eq=False)
class HumanModelMap:
    """Outline of a person with the foot at each pixel of a grid (section 3.4, figure 7).

    The grid reaches beyond the image, since feet may be outside while the head is inside. Only places where a person
    is possible (on the floor, near enough, visible) have an entry, so the others cost neither memory nor time.

    Attributes:
        camera, model: what the map was computed for.
        params: where people were expected.
        origin_px: (u, v) of grid node (0, 0) [px].
        index: (rows, cols) int32, number of the node's entry, -1 where no person is possible.
        foot_px: (N, 2) float32, the node's pixel.
        floor_m: (N, 2) float32, world position of the foot.
        hull_px: (N, HULL_POINTS, 2) float32, convex outline.
        visibility: (N,) float32, fraction of the hull's area inside the image.
    """

    camera: GroundCamera
    model: HumanModel
    params: HumanModelMapParams
    origin_px: tuple[int, int]
    index: I32
    foot_px: F32
    floor_m: F32
    hull_px: F32
    visibility: F32

    def __len__(self) -> int:
        return len(self.visibility)

    def entry_at(self, pixels: ArrayLike) -> I32:
        """(...) int32 entries of the nodes nearest to foot pixels (..., 2), -1 where no person is possible."""
        uv = np.asarray(pixels, dtype=np.float64)
        finite = np.where(np.isfinite(uv), uv, -1e6)
        grid = np.rint((finite - self.origin_px) / self.params.step_px).astype(np.int64)
        col, row = np.moveaxis(grid, -1, 0)
        rows, cols = self.index.shape
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        entry = self.index[np.where(inside, row, 0), np.where(inside, col, 0)]
        return np.where(inside, entry, -1).astype(np.int32)

    def boxes(self) -> F32:
        """(N, 4) float32 left, top, width, height [px] of the entries' hulls."""
        low = self.hull_px.min(axis=1)
        size = self.hull_px.max(axis=1) - low
        return np.concatenate([low, size], axis=1)


def build_model_map(
    camera: GroundCamera, model: HumanModel | None = None, params: HumanModelMapParams | None = None
) -> HumanModelMap:
    """Compute the map once per camera; the paper's person by default. Raises ValueError: more than MAX_NODES nodes."""
    model = model or HumanModel()
    params = params or HumanModelMapParams()
    # A foot can be outside by at most a person's image size; the largest visible person is near the image's.
    margin = max(camera.size)
    u = np.arange(-margin, camera.width + margin, params.step_px)
    v = np.arange(-margin, camera.height + margin, params.step_px)
    if len(u) * len(v) > MAX_NODES:
        raise ValueError(f"expected at most {MAX_NODES} map nodes, got {len(v)}x{len(u)}: enlarge step_px")
    index = np.full((len(v), len(u)), -1, dtype=np.int32)
    parts: list[tuple[F64, ...]] = []
    count = 0
    for row, v_px in enumerate(v):  # all rows at once would take gigabytes
        foot = np.stack([u, np.full(len(u), v_px)], axis=-1).astype(np.float64)
        floor = camera.back_project(foot)
        keep = np.flatnonzero(np.hypot(floor[:, 0], floor[:, 1]) <= params.max_distance_m)
        hulls = model.hulls(camera, floor[keep])
        finite = np.isfinite(hulls).all(axis=(1, 2))
        visibility = np.zeros(len(keep))
        visibility[finite] = visible_fraction(hulls[finite], camera.width, camera.height)
        expected = (visibility > MIN_VISIBLE) & (np.ptp(hulls, axis=1).max(axis=1) >= params.min_height_px)
        keep = keep[expected]
        index[row, keep] = count + np.arange(len(keep))
        count += len(keep)
        parts.append((foot[keep], floor[keep], hulls[expected], visibility[expected]))
    columns = [np.concatenate(column).astype(np.float32) for column in zip(*parts, strict=True)]
    return HumanModelMap(camera, model, params, (-margin, -margin), index, *columns)


def visible_fraction(hulls: ArrayLike, width: int, height: int) -> F64:
    """(N,) share of the area of convex polygons (N, K, 2) [px] inside the image (the paper's human visibility ratio).

    Pixels reach half a pixel beyond the outer centres; 0 for a polygon on the border without area.
    """
    p = np.asarray(hulls, dtype=np.float64)
    polygons = shapely.polygons(p)
    area = shapely.area(polygons)
    inside = shapely.area(shapely.clip_by_rect(polygons, -0.5, -0.5, width - 0.5, height - 0.5))
    return np.asarray(np.divide(inside, area, out=np.zeros(len(p)), where=area > 0))
