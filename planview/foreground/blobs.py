"""Blobs: foreground pixels grouped in space (Zhang et al. 2008, section 2)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.types import I32, I64, U8


@dataclass(frozen=True, eq=False)
class Blobs:
    """Connected groups of foreground pixels; label 0 is the background.

    Attributes:
        labels: (H, W) int32.
        area_px: (n,) int64 pixels of each label, the background's included.
        box_px: (n, 4) int32 left, top, width, height of each label.
    """

    labels: I32
    area_px: I64
    box_px: I32

    def __len__(self) -> int:
        return len(self.area_px)


def find_blobs(mask: U8) -> Blobs:
    """Group the non-zero pixels of a (H, W) uint8 mask, diagonal neighbours included."""
    height, width = mask.shape
    left, top, across, down = cv2.boundingRect(mask)
    # The algorithm looks at blocks of 2x2 pixels: from an even corner it finds the same labels in the same order.
    right, bottom, left, top = left + across, top + down, left - left % 2, top - top % 2
    labels = np.zeros(mask.shape, np.int32)
    rows = np.zeros((1, 5), np.int64)
    if across:
        # On one core this algorithm takes a third of the default's time.
        found = cv2.connectedComponentsWithStatsWithAlgorithm(
            np.ascontiguousarray(mask[top:bottom, left:right]), 8, cv2.CV_32S, cv2.CCL_BBDT
        )
        labels[top:bottom, left:right] = found[1]
        rows = np.asarray(found[2], dtype=np.int64)
        rows[:, :2] += left, top
    rows[0] = 0, 0, width, height, height * width - rows[1:, cv2.CC_STAT_AREA].sum()
    return Blobs(labels, rows[:, cv2.CC_STAT_AREA], rows[:, :4].astype(np.int32))
