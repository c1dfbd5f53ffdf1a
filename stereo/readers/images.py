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
from calib.types import U8
from stereo.readers.source import Decoded, is_grey

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"})
_END_MARKERS = {b"\xff\xd8\xff": b"\xff\xd9", b"\x89PNG": b"IEND"}


class ImageFiles:
    """One camera's frames as files; None stands for a file that is missing.

    Raises:
        InputError: no file of the list can be decoded.
    """

    fps = math.nan

    def __init__(self, files: Sequence[Path | None]) -> None:
        self._files = tuple(files)
        self.n_frames = len(self._files)
        first = next((image for file in self._files if file and (image := read_image(file)) is not None), None)
        if first is None:
            where = next((file for file in self._files if file), Path())
            raise InputError(f"{where.parent}: expected images, found none of {self.n_frames} that can be decoded")
        self.size = first.shape[1], first.shape[0]
        self._grey = is_grey(first)

    def __iter__(self) -> Iterator[Decoded]:
        return self.at(range(self.n_frames))

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """Only these frames."""
        for index in indices:
            yield self._decode(index, self._files[index])

    def _decode(self, index: int, file: Path | None) -> Decoded:
        if file is None:
            return Decoded(index, None, None, "file is missing")
        image = read_image(file)
        if image is None:
            return Decoded(index, None, None, f"{file.parent.name}/{file.name} cannot be decoded")
        if (image.shape[1], image.shape[0]) != self.size:
            found = size_text((image.shape[1], image.shape[0]))
            return Decoded(index, None, None, f"{file.parent.name}/{file.name} is {found}, not {size_text(self.size)}")
        return Decoded(index, None, as_grey(image) if self._grey else as_colour(image))


def read_image(file: Path) -> U8 | None:
    """(H, W) or (H, W, 3) uint8 BGR as stored, None when it cannot be decoded or its end is cut off."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    for start, end in _END_MARKERS.items():
        # Decoders fill the missing rest of a truncated file with grey and call it an image.
        if data.startswith(start) and end not in data[-1024:]:
            return None
    if not data:
        return None
    try:
        flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


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
