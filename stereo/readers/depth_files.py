"""Depth images from files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from calib.errors import InputError
from calib.length import size_text
from calib.types import F32, AnyArray
from stereo.readers.image_header import header_size, is_image_size
from stereo.readers.images import MAX_BYTES
from stereo.readers.source import DecodedDepth

UNITS_PER_M = 1000.0
"""Depth values per metre of files that do not say: sensors and their tools write millimetres."""
RANGE_M = 30.0
"""No depth sensor for rooms measures farther [m]; such values mark what is unknown (65535, for one)."""


class DepthFiles:
    """Depth images as files of one channel; None stands for a file that is missing.

    Whole numbers count ``units_per_m`` to the metre, with 0 for unknown; floating-point numbers are metres.

    Attributes:
        size: (width, height) [px].
        n_frames: files.
    Raises:
        InputError: no file of the list can be decoded as depth.
    """

    def __init__(self, files: Sequence[Path | None], units_per_m: float = UNITS_PER_M) -> None:
        self._files = tuple(files)
        self._units_per_m = units_per_m
        self.n_frames = len(self._files)
        first = next((depth for file in self._files if file and (depth := read_depth(file)) is not None), None)
        if first is None:
            where = next((file for file in self._files if file), Path())
            raise InputError(
                f"{where.parent}: expected depth images (one channel of 16 bits), found none of {self.n_frames}"
            )
        self.size = first.shape[1], first.shape[0]

    def __iter__(self) -> Iterator[DecodedDepth]:
        return self.at(range(self.n_frames))

    def at(self, indices: Iterable[int]) -> Iterator[DecodedDepth]:
        """Only these frames."""
        for index in indices:
            yield self._decode(index, self._files[index])

    def scaled(self, units_per_m: float) -> DepthFiles:
        """The same files with another scale."""
        return DepthFiles(self._files, units_per_m)

    def _decode(self, index: int, file: Path | None) -> DecodedDepth:
        if file is None:
            return DecodedDepth(index, None, None, "file is missing")
        stored = read_depth(file)
        name = f"{file.parent.name}/{file.name}"
        if stored is None:
            return DecodedDepth(index, None, None, f"{name} cannot be decoded")
        if (stored.shape[1], stored.shape[0]) != self.size:
            found = size_text((stored.shape[1], stored.shape[0]))
            return DecodedDepth(index, None, None, f"{name} is {found}, not {size_text(self.size)}")
        return DecodedDepth(index, None, metres(stored, self._units_per_m))


def metres(stored: AnyArray, units_per_m: float) -> F32:
    """(H, W) float32 [m] of depth as stored, NaN where unknown: 0, negative, not finite or out of any range."""
    whole = np.issubdtype(stored.dtype, np.integer)
    depth = stored.astype(np.float32) * np.float32(1.0 / units_per_m if whole else 1.0)
    with np.errstate(invalid="ignore"):
        return np.where((depth > 0) & (depth < RANGE_M), depth, np.float32(np.nan))


def read_depth(file: Path) -> AnyArray | None:
    """(H, W) uint16 or float32 as stored; None when it cannot be decoded or holds anything else."""
    try:
        return decode_depth(file.read_bytes()) if file.stat().st_size <= MAX_BYTES else None
    except OSError:
        return None


def decode_depth(data: bytes) -> AnyArray | None:
    """(H, W) uint16 or float32 of an encoded depth image; None when it cannot be decoded or holds anything else."""
    if not is_image_size(header_size(data)):
        return None
    try:
        stored = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    if stored is None or stored.ndim != 2 or stored.dtype not in (np.uint16, np.float32):
        return None
    return np.asarray(stored)
