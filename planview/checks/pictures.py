"""Pictures that show what the checks measured."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calib.images import as_colour, as_grey, write_image
from calib.types import F32, U8
from planview.checks.evidence import RecordingEvidence, RgbdEvidence, SceneEvidence
from planview.checks.exposure import SATURATED_LEVEL
from planview.drawing.colours import Rgb, as_bgr
from planview.drawing.legend import Entry, with_colour_bar, with_legend
from stereo.depth import DepthFromDisparity, back_project

LINE_STEP_PX = 25
FLOOR_BAND_M = 0.10
ROW: Rgb = (0, 220, 0)
ON_FLOOR: Rgb = (0, 220, 0)
ABOVE: Rgb = (230, 40, 40)
BELOW: Rgb = (60, 90, 255)
SATURATED: Rgb = (255, 0, 255)


def write_pictures(evidence: RecordingEvidence | RgbdEvidence, folder: Path) -> list[Path]:
    """Write PNG pictures of the frame in the middle of the recording.

    Returns:
        ``rows.png`` (of a pair: rectified, with horizontal lines and matched corners), ``disparity.png``, ``floor.png``
        (what lies on the floor green, above it red, below it blue) and ``exposure.png`` (saturated pixels magenta).
    """
    folder.mkdir(parents=True, exist_ok=True)
    middle = len(evidence.disparities) // 2
    disparity = evidence.disparities[middle]
    searched = evidence.searched
    pictures = {"disparity.png": disparity_picture(disparity, searched.first_px, searched.first_px + searched.count)}
    if isinstance(evidence, RgbdEvidence):
        left, recorded = as_grey(evidence.rectified[middle].left), [evidence.spread[middle].image]
    else:
        pair, frame = evidence.pairs[middle], evidence.spread[middle]
        left, recorded = pair.left_grey, [frame.left, frame.right]
        pictures["rows.png"] = rows_picture(pair.left_grey, pair.right_grey)
    pictures["floor.png"] = floor_picture(evidence, left, disparity)
    pictures["exposure.png"] = np.hstack([exposure_picture(as_grey(image)) for image in recorded])
    for name, picture in pictures.items():
        write_image(folder / name, picture)
    return [folder / name for name in pictures]


def rows_picture(left: U8, right: U8) -> U8:
    """Both rectified images side by side with lines along the rows, which the same points must touch."""
    both = as_colour(np.hstack([left, right]))
    both[LINE_STEP_PX // 2 :: LINE_STEP_PX] = as_bgr(ROW)
    return with_legend(both, [Entry(ROW, "one row: the same point is on it in both images")])


def disparity_picture(disparity: F32, smallest_px: int, largest_px: int) -> U8:
    """Near red, far blue, unknown black."""
    invalid = np.isnan(disparity)
    scaled = (np.nan_to_num(disparity) - smallest_px) * (255.0 / (largest_px - smallest_px))
    levels = np.clip(scaled, 0, 255).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), dtype=np.uint8)
    picture[invalid] = 0
    ends = f"far: {smallest_px} px", f"near: {largest_px} px"
    return with_colour_bar(picture, cv2.COLORMAP_TURBO, *ends, [Entry((0, 0, 0), "unknown")])


def floor_picture(evidence: SceneEvidence, left: U8, disparity: F32) -> U8:
    """The left image with what lies on the floor tinted green, what stands above it red, below it blue."""
    picture = as_colour(left).copy()
    if evidence.floor is None:
        return with_legend(picture, [Entry(ABOVE, "no floor was found")])
    geometry = evidence.rectifier.geometry
    points = back_project(DepthFromDisparity(geometry)(disparity), geometry)
    world = evidence.floor.world_SE3_left
    above = points @ world.rotation[2].astype(np.float32) + np.float32(world.translation[2])
    bands = (
        Entry(ON_FLOOR, f"on the floor, within {100 * FLOOR_BAND_M:.0f} cm"),
        Entry(ABOVE, "above it"),
        Entry(BELOW, "below it: wrong floor or depth"),
    )
    with np.errstate(invalid="ignore"):
        masks = np.abs(above) <= FLOOR_BAND_M, above > FLOOR_BAND_M, above < -FLOOR_BAND_M
    for mask, band in zip(masks, bands, strict=True):
        picture[mask] = (0.5 * picture[mask] + 0.5 * np.array(as_bgr(band.colour))).astype(np.uint8)
    return with_legend(picture, [*bands, Entry((255, 255, 255), "no tint: depth unknown")])


def exposure_picture(image: U8) -> U8:
    """The recorded image with saturated pixels in magenta."""
    picture = as_colour(image).copy()
    picture[image >= SATURATED_LEVEL] = as_bgr(SATURATED)
    return with_legend(picture, [Entry(SATURATED, f"saturated: {SATURATED_LEVEL:.0f} or brighter")])
