"""The search for ghosts with whole images in numpy and OpenCV; it defines planview/foreground/_ghost_kernels.py."""

from __future__ import annotations

import cv2
import numpy as np

from calib.types import F32, U8, Bool
from planview.foreground.blobs import Blobs, find_blobs
from planview.foreground.ghosts import EDGE_LEVELS, EDGE_RATIO, GHOST_AREA_PX, GHOST_MOTION

SQUARE: U8 = np.ones((3, 3), np.uint8)


def find_ghosts(luma: U8, background: U8, blobs: Blobs, motion: U8) -> U8:
    count, labels = len(blobs), blobs.labels
    mask = (labels > 0).astype(np.uint8)
    rim = (mask > 0) & (cv2.erode(mask, SQUARE) == 0)
    which = labels[rim]
    length = np.maximum(1, np.bincount(which, minlength=count))
    inside = _edges(luma)[rim], _edges(background)[rim]
    here, before = (np.bincount(which, values, minlength=count) / length for values in inside)
    ghost = (before >= EDGE_LEVELS) & (before >= EDGE_RATIO * here) & _still(blobs, motion)
    return np.where(ghost[labels], 255, 0).astype(np.uint8)


def find_still(blobs: Blobs, moved: U8) -> U8:
    return np.where(_still(blobs, moved)[blobs.labels], 255, 0).astype(np.uint8)


def _still(blobs: Blobs, motion: U8) -> Bool:
    moving = np.bincount(blobs.labels[motion > 0], minlength=len(blobs)) / np.maximum(1, blobs.area_px)
    still = (moving <= GHOST_MOTION) & (blobs.area_px >= GHOST_AREA_PX)
    still[0] = False
    return still


def find_uncovered(luma: U8, background: U8, mask: U8) -> U8:
    blobs = cv2.dilate(mask, SQUARE)
    if not mask.any() or blobs.all():
        return np.zeros_like(mask)
    around = _nearest_outside(cv2.blur(luma, (3, 3)).astype(np.float32), blobs)
    here, before = (_mean_difference(a, around, mask) for a in (luma, background))
    alike = (mask > 0) & (before >= EDGE_RATIO * here + EDGE_LEVELS)
    uncovered = cv2.morphologyEx(np.where(alike, np.uint8(255), np.uint8(0)), cv2.MORPH_OPEN, SQUARE)
    parts = find_blobs(uncovered)
    uncovered[parts.area_px[parts.labels] < GHOST_AREA_PX] = 0
    return uncovered


def _nearest_outside(values: F32, mask: U8) -> F32:
    _, nearest = cv2.distanceTransformWithLabels(mask, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    by_label = np.zeros(int(nearest.max()) + 1, np.float32)
    by_label[nearest[mask == 0]] = values[mask == 0]
    return by_label[nearest]


def _mean_difference(luma: U8, around: F32, mask: U8) -> F32:
    inside = (mask > 0).astype(np.float32)
    total, count = (cv2.blur(a, (5, 5)) for a in (np.abs(luma - around) * inside, inside))
    return total / np.maximum(count, 1e-3)


def _edges(luma: U8) -> F32:
    right, down = (cv2.Sobel(luma, cv2.CV_32F, dx, 1 - dx, ksize=3) for dx in (1, 0))
    return cv2.magnitude(right, down) / 4.0


def background_luma(levels: F32, gain: float, offset: float) -> U8:
    luma = levels * np.float32(gain) + np.float32(offset)
    return np.clip(np.round(luma), 0, 255).astype(np.uint8)
