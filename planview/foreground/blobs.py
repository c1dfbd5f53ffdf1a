"""Blobs: foreground pixels grouped in space (Zhang et al. 2008, section 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import I32, I64, U8
from planview.foreground import _blob_kernels as kernels


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
    most = height * (width + 1) // 2
    runs, parents = np.empty((most, 3), np.int32), np.empty(most, np.int32)
    n = kernels.find_runs(np.ascontiguousarray(mask), runs, parents)
    labels = np.zeros(mask.shape, np.int32)
    area_px, box_px = kernels.label_runs(runs[:n], parents[:n], labels)
    area_px[0], box_px[0] = height * width - area_px.sum(), (0, 0, width, height)
    return Blobs(labels, area_px, box_px)
