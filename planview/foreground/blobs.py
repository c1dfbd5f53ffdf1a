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
    _, labels, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)
    return Blobs(
        np.asarray(labels, np.int32),
        stats[:, cv2.CC_STAT_AREA].astype(np.int64),
        np.asarray(stats[:, : cv2.CC_STAT_AREA], np.int32),
    )
