"""Frames from image files."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from calib.errors import InputError
from calib.images import as_colour, as_grey
from calib.length import size_text
from calib.types import U8, AnyArray
from stereo.readers.bits import FRAMES, to_8_bits, true_bits
from stereo.readers.image_header import header_size, is_image_size
from stereo.readers.source import Decoded, is_grey

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"})
_END_MARKERS = {b"\xff\xd8\xff": b"\xff\xd9", b"\x89PNG": b"IEND"}


MAX_BYTES = 1 << 30
"""Files larger than this are no camera's image, and are not read."""


class ImageFiles:
    """One camera's frames as files; None stands for a file that is missing.

    Raises:
        InputError: no file of the list can be decoded.
    """

    fps = math.nan

    def __init__(self, files: Sequence[Path | None], bits: int | None = None) -> None:
        """Args: bits that the values of 16-bit images use (see ``bits_of``)."""
        self._files = tuple(files)
        self._bits = bits
        self.n_frames = len(self._files)
        first = next((image for file in self._files if file and (image := read_image(file, bits)) is not None), None)
        if first is None:
            where = next((file for file in self._files if file), Path())
            raise InputError(f"{where.parent}: expected images, found none of {self.n_frames} that can be decoded")
        self.size = first.shape[1], first.shape[0]
        self.is_grey = is_grey(first)

    def __iter__(self) -> Iterator[Decoded]:
        return self.at(range(self.n_frames))

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """Only these frames."""
        for index in indices:
            yield self._decode(index, self._files[index])

    def _decode(self, index: int, file: Path | None) -> Decoded:
        if file is None:
            return Decoded(index, None, None, "file is missing")
        image = read_image(file, self._bits)
        if image is None:
            return Decoded(index, None, None, f"{file.parent.name}/{file.name} cannot be decoded")
        if (image.shape[1], image.shape[0]) != self.size:
            found = size_text((image.shape[1], image.shape[0]))
            return Decoded(index, None, None, f"{file.parent.name}/{file.name} is {found}, not {size_text(self.size)}")
        return Decoded(index, None, as_grey(image) if self.is_grey else as_colour(image))


def read_image(file: Path, bits: int | None = None) -> U8 | None:
    """(H, W) or (H, W, 3) uint8 BGR, None when it cannot be decoded or its end is cut off.

    Args:
        bits: that the values of a 16-bit image use; None: 16.
    """
    stored = _stored(file)
    return None if stored is None else to_8_bits(stored, bits)


def _stored(file: Path) -> AnyArray | None:
    try:
        return decode_image(file.read_bytes()) if file.stat().st_size <= MAX_BYTES else None
    except OSError:
        return None


def decode_image(data: bytes) -> AnyArray | None:
    """(H, W) or (H, W, 3) uint8 or uint16 BGR as stored, None when it cannot be decoded or its end is cut off.

    The size that the header announces is checked before memory is taken for the image.
    """
    if not is_image_size(header_size(data)):
        return None
    for start, end in _END_MARKERS.items():
        # Decoders fill the missing rest of a truncated file with grey and call it an image.
        if data.startswith(start) and end not in data[-1024:]:
            return None
    try:
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        return None
    return np.asarray(image) if image is not None and image.dtype in (np.uint8, np.uint16) else None


def bits_of(*cameras: Sequence[Path | None]) -> int | None:
    """Bits that the images of all cameras use, from some of each; None for 8-bit images."""
    images = []
    for files in cameras:
        there = [file for file in files if file]
        for at in sorted({round(i) for i in np.linspace(0, len(there) - 1, FRAMES)} if there else ()):
            image = _stored(there[at])
            if image is None or image.dtype != np.uint16:
                break
            images.append(image)
    return true_bits(images)


def image_files(folder: Path) -> list[Path]:
    """The images of a folder, sorted by name with numbers in numeric order."""
    return sorted((f for f in folder.iterdir() if f.suffix.lower() in SUFFIXES and f.is_file()), key=_natural)


def frame_number(file: Path) -> int | None:
    """The last number in a file's name, None when it has none."""
    numbers = re.findall(r"\d+", file.stem)
    return int(numbers[-1]) if numbers else None


def _natural(file: Path) -> tuple[tuple[str, int], ...]:
    parts = re.findall(r"(\D*)(\d*)", file.stem)
    return tuple((text, int(digits) if digits else -1) for text, digits in parts)
