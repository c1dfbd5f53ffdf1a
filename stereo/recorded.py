"""Disparities that another program computed, in place of a matcher."""

from __future__ import annotations

import zipfile
from pathlib import Path

import cv2
import numpy as np

from calib.errors import InputError
from calib.types import F32, U8, AnyArray
from stereo.depth import RectifiedGeometry

PNG_SCALE = 256.0
"""A 16-bit PNG holds disparities times 256, 0 invalid (KITTI's convention)."""
SUFFIXES = (".png", ".npy", ".npz")
MAX_FACTOR = 8


class RecordedDisparity:
    """Reads a recording's ``disparity/`` folder; a ``Matcher`` that does not look at the images.

    The files belong to the rectified left image, whose size they have, or a whole multiple of it. Set ``index`` to the
    frame's index before each call when frames may be skipped; it advances by itself.

    Attributes:
        index: frame that the next call returns.
    """

    def __init__(self, folder: Path, geometry: RectifiedGeometry) -> None:
        """List the files.

        Raises:
            InputError: no folder, or no disparity in it.
        """
        self._files = sorted(f for f in folder.iterdir() if f.suffix in SUFFIXES) if folder.is_dir() else []
        if not self._files:
            raise InputError(f"{folder}: expected disparities as 16-bit PNG, .npy or .npz, found none")
        self._geometry = geometry
        self.index = 0

    def __len__(self) -> int:
        return len(self._files)

    def __call__(self, left_grey: U8, right_grey: U8) -> F32:
        """Disparity of frame ``index`` (see ``Matcher``).

        Raises:
            InputError: no file for the frame, unreadable, or of another shape.
        """
        if self.index >= len(self._files):
            raise InputError(
                f"{self._files[0].parent}: expected a disparity for frame {self.index}, found {len(self)} files"
            )
        disparity = load_disparity(self._files[self.index], self._geometry)
        self.index += 1
        return disparity


def load_disparity(file: Path, geometry: RectifiedGeometry) -> F32:
    """One disparity image at the geometry's size.

    Returns:
        (H, W) float32 [px of the geometry]; NaN invalid.
    Raises:
        InputError: unreadable, or neither of the geometry's size nor of a whole multiple of it.
    """
    shape = geometry.height, geometry.width
    try:
        values = _read(file, shape)
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, cv2.error) as error:
        raise InputError(f"{file}: expected a disparity image, found {error}") from error
    factor = values.shape[1] // shape[1]
    if values.shape != (shape[0] * factor, shape[1] * factor):
        raise InputError(f"{file}: expected {shape} or a whole multiple, found {values.shape}")
    disparity = values[factor // 2 :: factor, factor // 2 :: factor].astype(np.float32) / np.float32(factor)
    disparity[~(disparity > 0)] = np.nan
    return disparity


def _read(file: Path, shape: tuple[int, int]) -> AnyArray:
    if file.suffix == ".png":
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        if image is None or image.ndim != 2 or image.dtype != np.uint16:
            raise ValueError("no 16-bit grey PNG")
        return np.asarray(image) / PNG_SCALE
    most = shape[0] * shape[1] * MAX_FACTOR**2 * 8 + 4096
    if file.suffix == ".npz":
        with zipfile.ZipFile(file) as archive:
            entry = archive.infolist()[0] if archive.infolist() else None
        if entry is None or entry.file_size > most:
            raise ValueError(f"no array of at most {most} bytes")
        with np.load(file, allow_pickle=False) as arrays:
            return _image(arrays[arrays.files[0]])
    return _image(np.load(file, mmap_mode="r", allow_pickle=False))


def _image(values: AnyArray) -> AnyArray:
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        raise ValueError(f"an array of {values.dtype} with {values.ndim} axes")
    return values
