"""Where the images of one camera come from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

import cv2
import numpy as np

from calib.types import F32, U8


@dataclass(frozen=True, eq=False)
class Decoded:
    """One frame of one camera: an image, or the reason why there is none.

    Attributes:
        index: position in the recording, from 0.
        timestamp_s: the file's own time of the frame, None when it has none.
        image: (H, W) or (H, W, 3) uint8, BGR; None when it could not be had.
        why: the reason when image is None.
    """

    index: int
    timestamp_s: float | None
    image: U8 | None
    why: str = ""


@dataclass(frozen=True, eq=False)
class DecodedDepth:
    """One depth image as stored.

    Attributes:
        index, timestamp_s: as of ``Decoded``.
        depth_m: (h, w) float32 [m] in the depth sensor's own pixels, NaN where unknown; None when it could not be had.
        why: the reason when depth_m is None.
    """

    index: int
    timestamp_s: float | None
    depth_m: F32 | None
    why: str = ""


DecodedItem = TypeVar("DecodedItem", bound=Decoded | DecodedDepth, covariant=True)


class ItemSource(Protocol[DecodedItem]):
    """What was decoded, in order; every index is yielded once, with or without an image."""

    def __iter__(self) -> Iterator[DecodedItem]: ...

    def at(self, indices: Iterable[int]) -> Iterator[DecodedItem]:
        """Only these frames, which must ascend; the iteration ends where the file does."""


class FrameSource(ItemSource[Decoded], Protocol):
    """Images of one camera in order.

    Attributes:
        size: (width, height) [px].
        n_frames: frames announced; the iteration may end earlier.
        fps: nominal rate, NaN when the files hold none.
    """

    size: tuple[int, int]
    n_frames: int
    fps: float


GREY_TOLERANCE = 4
"""Largest difference of the channels [grey levels] in a grey video: codecs that store YUV round a little."""


def is_grey(image: U8) -> bool:
    """Whether an image holds no colour: one channel, or three nearly equal ones that are not all the same value.

    A uniform picture (a black first frame) decides nothing and counts as colour, which loses nothing.
    """
    if image.ndim == 2:
        return True
    green = image[..., 1]
    difference = max(int(cv2.absdiff(image[..., c], green).max()) for c in (0, 2))
    return int(np.ptp(green)) > 4 * GREY_TOLERANCE and difference <= GREY_TOLERANCE
