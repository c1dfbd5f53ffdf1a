"""Images of one camera as an ideal pinhole would have taken them."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.camera import Camera
from calib.types import F32, F64, U8, AnyArray, Bool
from stereo.gate import Window
from stereo.view import source_pixels

_OUTSIDE_PX = -1e4
"""Where nothing was recorded, the source lies outside."""


class Warp:
    """Recorded images to those of a pinhole, averaged down first where they are much larger.

    Attributes:
        mask: (H, W) uint8, 255 where the pinhole's image shows something.
    """

    def __init__(
        self, camera: Camera, rotation: F64, pixel_to_ray: F64, size: tuple[int, int], working_px: int
    ) -> None:
        """Prepare the maps.

        Args:
            camera: that recorded.
            rotation: (3, 3) its frame to the pinhole's.
            pixel_to_ray: (3, 3) homogeneous pixel of the pinhole to its ray.
            size: (width, height) of the pinhole's image [px].
            working_px: longest side that images are averaged down to [px]; 0 keeps their size.
        """
        self._reduced = _reduced_size(camera.size, working_px)
        pixels = source_pixels(camera, rotation, pixel_to_ray, size)
        inside: Bool = np.all((pixels > -0.5) & (pixels < np.array(camera.size) - 0.5), axis=-1)
        self.mask: U8 = np.where(inside, np.uint8(255), np.uint8(0))
        nearest = np.where(inside[..., None], np.round(np.nan_to_num(pixels)), 0.0).astype(np.int16)
        self._columns, self._rows = nearest[..., 0], nearest[..., 1]
        shrink = np.array(self._reduced) / np.array(camera.size)
        reduced = np.clip((pixels + 0.5) * shrink - 0.5, 0.0, np.array(self._reduced) - 1.0)
        reduced = np.where(inside[..., None], reduced, _OUTSIDE_PX).astype(np.float32)
        # OpenCV's fixed-point maps: whole pixels (H, W, 2) int16 and fractions (H, W) uint16.
        fixed, fraction = cv2.convertMaps(reduced[..., 0], reduced[..., 1], cv2.CV_16SC2)
        self._maps: tuple[AnyArray, AnyArray] = np.asarray(fixed), np.asarray(fraction)
        self._sampled: dict[int, tuple[AnyArray, AnyArray]] = {}

    def __call__(self, image: U8) -> U8:
        """(H, W) or (H, W, 3) uint8 of an image of the camera, by bilinear interpolation."""
        return self.of(self.source(image))

    def of(self, source: U8) -> U8:
        """A call, from what ``source`` gave."""
        return np.asarray(cv2.remap(source, *self._maps, cv2.INTER_LINEAR), dtype=np.uint8)

    def source(self, image: U8) -> U8:
        """An image of the camera, or what another warp of it needs, averaged down as this warp needs it."""
        if self._reduced == image.shape[1::-1]:
            return image
        return np.asarray(cv2.resize(image, self._reduced, interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def part(self, source: U8, window: Window) -> U8:
        """(h, w) or (h, w, 3) uint8 of a window of the pinhole's image, from what ``source`` gave."""
        whole, fraction = (table[window.slices] for table in self._maps)
        return np.asarray(cv2.remap(source, whole, fraction, cv2.INTER_LINEAR), dtype=np.uint8)

    def samples(self, source: U8, step: int) -> U8:
        """Every ``step``-th row and column of the pinhole's image, from what ``source`` gave."""
        if step not in self._sampled:
            whole, fraction = (np.ascontiguousarray(table[::step, ::step]) for table in self._maps)
            self._sampled[step] = whole, fraction
        return np.asarray(cv2.remap(source, *self._sampled[step], cv2.INTER_LINEAR), dtype=np.uint8)

    def nearest(self, depth: F32) -> F32:
        """(H, W) float32 of a depth image of the camera: nearest pixels, as a mean over an edge is nowhere; else NaN.

        The depth along the optical axis stays what it is only when the pinhole has the camera's orientation.
        """
        return np.where(self.mask > 0, depth[self._rows, self._columns], np.float32(np.nan))


def _reduced_size(size: tuple[int, int], working_px: int) -> tuple[int, int]:
    """Size to which recorded images are averaged before the warp: a whole fraction, which is the fast case.

    Up to 1.7 source pixels per rectified one the warp alone aliases little; averaging more would blur.
    """
    factor = max(1, math.floor(max(size) / working_px + 0.3)) if working_px else 1
    return max(1, size[0] // factor), max(1, size[1] // factor)
