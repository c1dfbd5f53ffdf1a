"""Pictures of what a check has looked at."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path

import numpy as np

from calib.images import as_colour, write_image
from calib.rig import Floor
from calib.types import U8
from planview.checks.heights import heights_above_floor
from planview.drawing.style import Entry, Rgb, as_bgr, disparity_colours, with_legend
from stereo.depth import back_project, median_image
from stereo.floor import DepthFrames, PairFrames

LINE_STEP_PX = 25
FLOOR_BAND_M = 0.10
ROW: Rgb = (0, 220, 0)
ABOVE: Rgb = (230, 40, 40)
BELOW: Rgb = (60, 90, 255)
FAR: Rgb = (48, 18, 59)
NEAR: Rgb = (122, 4, 3)
"""Ends of the colours of disparity."""


def write_pictures(seen: PairFrames | DepthFrames, floor: Floor | None, folder: Path) -> list[Path]:
    """Write PNG pictures of the frame in the middle of the recording.

    Returns:
        ``rows.png`` (of a pair: rectified, with horizontal lines and matched corners), ``disparity.png`` and
        ``floor.png`` (what lies on the floor green, above it red, below it blue).
    """
    folder.mkdir(parents=True, exist_ok=True)
    middle = len(seen.frames) // 2
    pictures = {
        "disparity.png": _disparity_picture(seen, middle),
        "floor.png": floor_picture(seen, floor),
        **row_pictures(seen, middle),
    }
    for name, picture in pictures.items():
        write_image(folder / name, picture)
    return [folder / name for name in pictures]


def _disparity_picture(seen: PairFrames | DepthFrames, middle: int) -> U8:
    first_px = seen.searched.first_px
    last_px = first_px + seen.searched.count
    colours = disparity_colours(seen.disparities[middle], first_px, last_px)
    return with_legend(
        colours, [Entry(FAR, f"{first_px} px"), Entry(NEAR, f"{last_px} px"), Entry((0, 0, 0), "unknown")]
    )


@singledispatch
def row_pictures(seen: PairFrames | DepthFrames, middle: int) -> dict[str, U8]:
    """A picture of the rows of a pair; none of images with depth."""
    return {}


@row_pictures.register
def _row_pictures_of_pair(seen: PairFrames, middle: int) -> dict[str, U8]:
    pair = seen.rectified_pairs[middle]
    rows = as_colour(np.hstack([pair.left_grey, pair.right_grey]))
    rows[LINE_STEP_PX // 2 :: LINE_STEP_PX] = as_bgr(ROW)
    return {"rows.png": with_legend(rows, [Entry(ROW, "one row: the same point is on it in both images")])}


def floor_picture(seen: PairFrames | DepthFrames, floor: Floor | None) -> U8:
    """The left image, median of the frames, tinted green where it shows the floor, red above it and blue below it."""
    picture = as_colour(median_image(seen.greys).astype(np.uint8))
    if floor is None:
        return with_legend(picture, [Entry(ABOVE, "no floor was found")])
    geometry = seen.rectifier.geometry
    points = back_project(geometry.depth(median_image(seen.disparities)), geometry)
    above = heights_above_floor(points, floor.world_SE3_left)
    with np.errstate(invalid="ignore"):
        slope = floor.height_m / points[..., 2]  # height above the floor by depth, along the ray of a pixel
        within = FLOOR_BAND_M + 2 * slope * geometry.depth_std_m(points[..., 2])
        bands = {
            Entry(ROW, f"on the floor, within {100 * FLOOR_BAND_M:.0f} cm and noise"): np.abs(above) <= within,
            Entry(ABOVE, "above it"): above > within,
            Entry(BELOW, "below it: wrong floor or depth"): above < -within,
        }
    for band, mask in bands.items():
        picture[mask] = (0.5 * picture[mask] + 0.5 * np.array(as_bgr(band.colour))).astype(np.uint8)
    return with_legend(picture, [*bands, Entry((255, 255, 255), "no tint: depth unknown")])
