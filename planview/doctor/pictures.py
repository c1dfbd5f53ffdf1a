"""Pictures that show what the checks measured."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calib.images import as_colour, as_grey, write_image
from calib.types import F32, U8
from planview.doctor.evidence import RecordingEvidence, RgbdEvidence, SceneEvidence
from planview.doctor.exposure import SATURATED_LEVEL
from stereo.depth import DepthFromDisparity, back_project

LINE_STEP_PX = 25
FLOOR_BAND_M = 0.10


def write_pictures(evidence: RecordingEvidence | RgbdEvidence, folder: Path) -> list[Path]:
    """Write PNG pictures of the frame in the middle of the recording.

    Returns:
        ``rows.png`` (of a pair: rectified, with horizontal lines and matched corners), ``disparity.png``, ``floor.png``
        (what lies on the floor green, above it red) and ``exposure.png`` (saturated pixels magenta).
    """
    folder.mkdir(parents=True, exist_ok=True)
    middle = len(evidence.disparities) // 2
    disparity = evidence.disparities[middle]
    pictures = {"disparity.png": disparity_picture(disparity, evidence.searched.first_px + evidence.searched.count)}
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
    both[LINE_STEP_PX // 2 :: LINE_STEP_PX] = (0, 220, 0)
    return both


def disparity_picture(disparity: F32, largest_px: int) -> U8:
    """Near red, far blue, invalid black."""
    invalid = np.isnan(disparity)
    scaled = np.where(invalid, 0.0, np.clip(disparity * (255.0 / largest_px), 0, 255)).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(scaled, cv2.COLORMAP_TURBO), dtype=np.uint8)
    picture[invalid] = 0
    return picture


def floor_picture(evidence: SceneEvidence, left: U8, disparity: F32) -> U8:
    """The left image with what lies on the floor tinted green and what stands above it red."""
    picture = as_colour(left)
    if evidence.floor is None:
        return picture
    geometry = evidence.rectifier.geometry
    points = back_project(DepthFromDisparity(geometry)(disparity), geometry)
    world = evidence.floor.world_SE3_left
    above = points @ world.rotation[2].astype(np.float32) + np.float32(world.translation[2])
    for of_it, channel in ((np.abs(above) <= FLOOR_BAND_M, 1), (above > FLOOR_BAND_M, 2)):
        picture[of_it] //= 2
        picture[of_it, channel] += 128
    return picture


def exposure_picture(image: U8) -> U8:
    """The recorded image with saturated pixels in magenta."""
    picture = as_colour(image)
    picture[image >= SATURATED_LEVEL] = (255, 0, 255)
    return picture
