"""Frames from image files: announced sizes, decoding, and values of more than 8 bits."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from calib.errors import InputError
from calib.images import as_colour, as_grey
from calib.io import size_text
from calib.types import U8, AnyArray
from stereo.readers.base import Decoded, is_grey

Size = tuple[int, int]
Stored = TypeVar("Stored", bound=AnyArray)

MAX_PIXELS = 100_000_000
"""Largest image that is decoded: larger than any camera's, and 0.6 GB at 16 bits in three channels (our choice)."""
_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_PNM = re.compile(rb"P[1-6][ \t\r\n]+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s")


def header_size(data: bytes) -> Size | None:
    """(width, height) [px] that a PNG, JPEG, BMP, TIFF, WebP or PNM file announces; None for any other content."""
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            width, height = struct.unpack_from(">II", data, 16)
        elif data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        elif data.startswith(b"BM"):
            width, height = struct.unpack_from("<ii", data, 18)
        elif data[:4] in (b"II*\0", b"MM\0*"):
            return _tiff(data)
        elif data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _webp(data)
        else:
            match = _PNM.match(data[:4096])
            return (int(match[1]), int(match[2])) if match else None
    except struct.error:
        return None
    return abs(int(width)), abs(int(height))


def is_image_size(size: Size | None) -> bool:
    """Whether an announced size is one that may be decoded."""
    return size is not None and min(size) > 0 and size[0] * size[1] <= MAX_PIXELS


def _jpeg(data: bytes) -> Size | None:
    at = 2
    while at + 9 <= len(data):
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        if marker == 0xFF:
            at += 1
        elif marker == 0x01 or 0xD0 <= marker <= 0xD8:
            at += 2
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None


def _tiff(data: bytes) -> Size | None:
    order = "<" if data.startswith(b"II") else ">"
    (directory,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, directory)
    found: dict[int, int] = {}
    for at in range(directory + 2, directory + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(order + "HH", data, at)
        if tag in (256, 257):
            (found[tag],) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, at + 8)
    return (found[256], found[257]) if len(found) == 2 else None


def _webp(data: bytes) -> Size | None:
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        width, height = (int.from_bytes(data[at : at + 3], "little") for at in (24, 27))
        return width + 1, height + 1
    return None


DEPTHS = (8, 10, 12, 14, 16)
"""Bits that sensors give."""
FRAMES = 5
"""Frames of each camera in which the largest value is looked for (our choice)."""


def true_bits(images: Iterable[AnyArray]) -> int | None:
    """Bits that the values of 16-bit images use.

    Values that fill the upper bits (a 12-bit sensor's times 16) count as 16: their scale is that of 16 bits.

    Args:
        images: several frames, since one may be dark.
    Returns:
        The smallest of ``DEPTHS`` that holds the largest value; None when no image has more than 8 bits per value.
    """
    largest = [int(image.max()) for image in images if image.dtype == np.uint16 and image.size]
    if not largest:
        return None
    return next(bits for bits in DEPTHS if max(largest) < 1 << bits)


def to_8_bits(image: AnyArray, bits: int | None) -> U8:
    """The image with 8 bits per value.

    Args:
        image: uint8 as it is; uint16 with values of ``bits`` bits, larger ones are clipped.
    """
    if image.dtype == np.uint8:
        return np.asarray(image, dtype=np.uint8)
    shifted = image >> max(0, (bits or 16) - 8)
    return np.asarray(np.minimum(shifted, 255), dtype=np.uint8)


def bits_note(bits: int | None) -> tuple[str, ...]:
    """What is said once about such images."""
    if bits is None:
        return ()
    return (f"images of 16 bits whose values use {bits}: their upper 8 bits are taken",)


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
        first = first_readable(self._files, lambda file: read_image(file, bits))
        if first is None:
            folder = folder_of(self._files)
            raise InputError(f"{folder}: expected images, found none of {self.n_frames} that can be decoded")
        self.size = first.shape[1], first.shape[0]
        self.is_grey = is_grey(first)

    def __iter__(self) -> Iterator[Decoded]:
        return self.at(range(self.n_frames))

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """Only these frames."""
        for index in indices:
            image, why = read_of_size(self._files[index], lambda file: read_image(file, self._bits), self.size)
            given = None if image is None else as_grey(image) if self.is_grey else as_colour(image)
            yield Decoded(index, None, given, why)


def first_readable(files: Iterable[Path | None], read: Callable[[Path], Stored | None]) -> Stored | None:
    """What the first file holds that can be read."""
    return next((stored for file in files if file and (stored := read(file)) is not None), None)


def folder_of(files: Iterable[Path | None]) -> Path:
    """Where the files are, for messages."""
    return next((file for file in files if file), Path()).parent


def read_of_size(file: Path | None, read: Callable[[Path], Stored | None], size: Size) -> tuple[Stored | None, str]:
    """What a file holds, or None and the reason: missing, unreadable, or not of (width, height) [px]."""
    if file is None:
        return None, "file is missing"
    stored, name = read(file), f"{file.parent.name}/{file.name}"
    if stored is None:
        return None, f"{name} cannot be decoded"
    found = stored.shape[1], stored.shape[0]
    return (stored, "") if found == size else (None, f"{name} is {size_text(found)}, not {size_text(size)}")


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
