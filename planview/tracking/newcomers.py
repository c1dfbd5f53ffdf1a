"""What may be new on the floor: depth tells a person from a part of another person, which a mask does not."""

from __future__ import annotations

import math

from calib.types import F32
from planview.maps.builder import PlanViewMaps, Viewpoint


def is_part_of(
    maps: PlanViewMaps,
    place_m: tuple[float, float],
    other_m: tuple[float, float],
    share: float,
    arm_m: float,
    half_m: float,
) -> bool:
    """Whether what stands at a place is carried by a person or is a limb: near that person and much smaller.

    Args:
        place_m, other_m: (x, y) of what may be new, and of the person [m].
        share: smaller means less than this share of the person's visible surface.
        arm_m: near means inseparable at this distance [m], see ``inseparable``.
        half_m: half the side of the square in which surface is summed [m].
    """
    if not inseparable(maps.view, place_m, other_m, arm_m):
        return False
    return visible_area_m2(maps, place_m, half_m) < share * visible_area_m2(maps, other_m, half_m)


def visible_area_m2(maps: PlanViewMaps, place_m: tuple[float, float], half_m: float) -> float:
    """Visible surface in a square of side 2 ``half_m`` about a place [m^2]."""
    return float(_window(maps.occupancy, maps, place_m, half_m).sum())


def top_height_m(maps: PlanViewMaps, place_m: tuple[float, float], half_m: float) -> float:
    """Largest height in a square of side 2 ``half_m`` about a place [m]; 0 outside the maps."""
    near = _window(maps.height, maps, place_m, half_m)
    return float(near.max()) if near.size else 0.0


def _window(values: F32, maps: PlanViewMaps, place_m: tuple[float, float], half_m: float) -> F32:
    """The cells of a square that lie inside the maps."""
    row, col = maps.grid.index_of(*place_m)
    reach = half_m / maps.grid.cell_m
    r0, c0 = max(0, math.floor(row - reach)), max(0, math.floor(col - reach))
    return values[r0 : max(0, math.ceil(row + reach)) + 1, c0 : max(0, math.ceil(col + reach)) + 1]


def inseparable(view: Viewpoint, one_m: tuple[float, float], other_m: tuple[float, float], distance_m: float) -> bool:
    """Whether two floor positions may be one body: within a distance, stretched along the ray by depth noise.

    Matching favours whole disparities, so a far body may fall into two clumps one disparity step apart: four of its
    standard deviations of 0.25 px.
    """
    across, along, (ray_x, ray_y) = view.footprint(*one_m, distance_m, sigmas=4.0)
    dx, dy = other_m[0] - one_m[0], other_m[1] - one_m[1]
    radial, lateral = dx * ray_x + dy * ray_y, -dx * ray_y + dy * ray_x
    return (radial / along) ** 2 + (lateral / across) ** 2 < 1.0
