"""Metres from stored depth and from disparity, and how far they may be off."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar, cast, overload

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.floor_camera import FloorPinhole
from calib.images import as_colour
from calib.libraries import import_open3d
from calib.pose import SE3
from calib.types import F32, F64, U8, AnyArray
from stereo.thumbnails import Thumbnails

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

DISPARITY_STD_PX = 0.25
"""Standard deviation of a matched disparity [px]: 0.24 to 0.30 on rendered people."""
DEPTH_MAX_M = 30.0
"""Farther points are left out [m]: sensors for rooms do not reach them, and a pair's deviation exceeds any room."""
UNITS_PER_M = 1000.0
"""Depth values per metre of files without a scale: sensors and their tools write millimetres."""
DEPTH_UNITS = (10_000.0, 8000.0, 5000.0, 4000.0, UNITS_PER_M, 256.0, 100.0)
"""Values per metre of depth in files: RealSense D405, Kinect's with three bits for players, TUM, RealSense L515, most
sensors, KITTI, centimetres."""
ONE_SURFACE = 0.03
"""Neighbouring pixels show one surface when their distances differ by a smaller share: on a floor 12 m away and 2.5 m
below they differ by 0.014 (at a focal length of 350 px), between a person and what is 0.1 m behind at 3 m by 0.03."""


@dataclass
class Depths:
    """Pixels of depth, as float32 metres (see ``metres``) or as they are stored."""

    units_per_m: float = UNITS_PER_M
    as_stored: bool = False
    name = "depth images (one channel of 16 bits)"
    text = "depth"

    def fits(self, stored: AnyArray) -> bool:
        """True if stored values are those of depth."""
        return stored.ndim == 2 and stored.dtype in (np.uint16, np.float32, np.float64)

    def prepare(self, first: AnyArray) -> None:
        """Depth has no colour."""

    @contextmanager
    def raw(self) -> Iterator[None]:
        """Give values as they are stored meanwhile."""
        before = self.as_stored
        self.as_stored = True
        try:
            yield
        finally:
            self.as_stored = before

    def __call__(self, stored: AnyArray) -> AnyArray:
        return stored if self.as_stored else metres(stored, self.units_per_m)


def metres(stored: AnyArray, units_per_m: float) -> F32:
    """(H, W) float32 [m] of depth as stored, NaN where unknown: 0, negative, not finite or out of any range.
    Whole numbers count ``units_per_m`` to the metre; floating-point numbers are metres."""
    depth = stored.astype(np.float32)
    if np.issubdtype(stored.dtype, np.integer):
        depth *= np.float32(1.0 / units_per_m)
    with np.errstate(invalid="ignore"):
        return np.where((depth > 0) & (depth < DEPTH_MAX_M), depth, np.float32(np.nan))


@dataclass(frozen=True)
class RectifiedGeometry:
    """Pinhole geometry of a rectified pair: no distortion, rows aligned, disparity 0 at infinity.

    Attributes:
        width, height: image size [px].
        focal_u_px, focal_v_px: focal lengths along a row and along a column [px].
        cu_px, cv_px: principal point of both images [px]; pixel (0, 0) is the centre of the top-left pixel.
        baseline_m: distance between the cameras along x [m].
        disparity_std_px: standard deviation of a matched disparity [px].
        depth_std_min_m: deviation of the depth however near [m]: 0 for triangulation, not for time of flight.
    """

    width: int
    height: int
    focal_u_px: float
    focal_v_px: float
    cu_px: float
    cv_px: float
    baseline_m: float
    disparity_std_px: float = DISPARITY_STD_PX
    depth_std_min_m: float = 0.0

    def __post_init__(self) -> None:
        if not min(self.focal_u_px, self.focal_v_px, self.baseline_m) > 0:
            raise ValueError(f"expected focal lengths and a baseline above 0, got {self}")

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px], as OpenCV takes it."""
        return self.width, self.height

    @property
    def matrix(self) -> F64:
        """(3, 3) camera matrix K of both images [px]."""
        return np.array([[self.focal_u_px, 0.0, self.cu_px], [0.0, self.focal_v_px, self.cv_px], [0.0, 0.0, 1.0]])

    @property
    def pixel_to_ray(self) -> F64:
        """(3, 3) homogeneous pixel to ray, the inverse of K."""
        return np.asarray(np.linalg.inv(self.matrix))

    def above(self, world_SE3_left: SE3, step: int = 1) -> FloorPinhole:
        """The left camera above the floor, its image reduced by a whole factor ``step``."""
        size = (-(-self.width // step), -(-self.height // step))
        middle = middle_px(0, step)
        reduced = np.array([[1.0, 0.0, -middle], [0.0, 1.0, -middle], [0.0, 0.0, step]]) / step
        return FloorPinhole(size, reduced @ self.matrix, world_SE3_left)

    @property
    def disparity_metre(self) -> float:
        """Disparity of a point one metre away, f b [px m]; depth is this divided by disparity."""
        return self.focal_u_px * self.baseline_m

    def rays(self, pixels: ArrayLike) -> F64:
        """(..., 3) float64 rays at unit z through (..., 2) pixels u, v, in the rectified left camera frame."""
        p = np.asarray(pixels, dtype=np.float64)
        u = (p[..., 0] - self.cu_px) / self.focal_u_px
        v = (p[..., 1] - self.cv_px) / self.focal_v_px
        return np.stack([u, v, np.ones_like(u)], axis=-1)

    def disparity_at(self, depth_m: float) -> float:
        """Disparity [px] of a point at a depth [m]."""
        return self.disparity_metre / depth_m

    def depth(self, disparity: F32, max_m: float = DEPTH_MAX_M) -> F32:
        """(H, W) float32 depth along the optical axis [m] of a disparity (H, W) float32 [px]; NaN where that is NaN,
        not positive, or means more than ``max_m``."""
        usable = np.where(disparity >= self.disparity_at(max_m), disparity, np.float32(np.nan))
        return np.asarray(np.float32(self.disparity_metre) / usable, dtype=np.float32)

    @property
    def depth_std_per_m2(self) -> float:
        """Growth of the depth deviation with squared depth [1/m], sigma_d / (f b): the derivative of z = f b / d."""
        return self.disparity_std_px / self.disparity_metre

    @property
    def disparity_std_per_px2(self) -> float:
        """Growth of the disparity deviation with squared disparity [1/px] that ``depth_std_min_m`` means."""
        return self.depth_std_min_m / self.disparity_metre

    @overload
    def depth_std_m(self, depth: float) -> float: ...
    @overload
    def depth_std_m(self, depth: F32) -> F32: ...
    def depth_std_m(self, depth: float | F32) -> float | F32:
        """Predicted standard deviation of depths [m]: sigma_z^2 = (z^2 sigma_d / (f b))^2 + depth_std_min_m^2."""
        if isinstance(depth, np.ndarray):
            grown = depth * depth * np.float32(self.depth_std_per_m2)
            return np.asarray(np.hypot(grown, np.float32(self.depth_std_min_m)), dtype=np.float32)
        return math.hypot(depth * depth * self.depth_std_per_m2, self.depth_std_min_m)


class Matched(NamedTuple):
    """A disparity and the pair in which it was found.

    Attributes:
        left, right: (h, w) uint8, the pair's samples, each the mean of 5x5.
        disparity: (h, w) float32 of the left samples [px], NaN where unknown.
        kept: pairs since then, in which nothing has moved.
        seen: pairs since the first one.
    """

    left: U8
    right: U8
    disparity: F32
    kept: int
    seen: int


@dataclass(frozen=True, eq=False)
class Depth:
    """A rectified frame and how far away its pixels are.

    Attributes:
        image: (h, w[, 3]) uint8, the (left) image at the size of analysis.
        disparity: (h, w) float32 of its pixels [px of the rectified image], NaN invalid.
        step: rows and columns of the rectified image to one of these.
        rectified: images of cameras at their whole size, (H, W[, 3]) uint8: both of a pair, or the one with depth.
        thumbnails: makes what shows whether all stands still.
        picture: makes the rectified (left) image, (H, W[, 3]) uint8, in which boxes of people are.
        matched: how the disparity was matched, for the next frame; None where nothing was, or by another matcher.
    """

    image: U8
    disparity: F32
    step: int
    rectified: tuple[U8, ...]
    thumbnails: Callable[[], Thumbnails]
    picture: Callable[[], U8]
    matched: Matched | None = None

    @staticmethod
    def of_whole(image: U8, disparity: F32, step: int) -> Depth:
        """Depth from an (H, W[, 3]) image without distortion and its (H, W) disparity, at an n-th of their size."""
        samples = sample_means(image, step)
        disparities = sample_disparities(disparity, step)
        thumbnails = partial(Thumbnails.of_depth, samples, disparities)
        return Depth(samples, disparities, step, (image,), thumbnails, lambda: image)


Samples = TypeVar("Samples", float, F64)


def middle_px(sample: Samples, step: int) -> Samples:
    """Middle of a sample of ``step`` pixels, counted from 0, along a row or column of the image [px]."""
    return step * sample + 0.5 * (step - 1)


def whole_samples(image: U8, step: int) -> U8:
    """An (H, W[, 3]) image with whole samples of step x step pixels at the right and lower edge."""
    below, right = (-n % step for n in image.shape[:2])
    return np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE), dtype=np.uint8)


def sample_means(image: U8, step: int) -> U8:
    """(h, w[, 3]) uint8 means of step x step pixels of an (H, W[, 3]) image."""
    if step == 1:
        return image
    whole = whole_samples(image, step)
    size = whole.shape[1] // step, whole.shape[0] // step
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def sample_disparities(disparity: F32, step: int) -> F32:
    """(h, w) float32 disparity in the middle of samples of step x step pixels of an (H, W) image [px], NaN where there
    is none.

    The middle of an even number of pixels lies between four. The disparity of a surface is linear in the image, so the
    mean of the four is that of the middle; at an edge those count that show the surface of the second nearest.
    """
    middle = middle_px(0, step)
    around = range(math.floor(middle), math.ceil(middle) + 1)
    below, right = (-n % step for n in disparity.shape)
    whole = np.pad(disparity, ((0, below), (0, right)), constant_values=np.nan) if below or right else disparity
    pixels = np.stack([whole[row::step, column::step] for row in around for column in around])
    if len(pixels) == 1:
        return np.asarray(pixels[0])
    # A pixel without depth counts as its neighbour in the row.
    nearest = np.fmax(pixels[::2], pixels[1::2])
    farther = np.fmin(pixels[::2], pixels[1::2])
    second = np.fmax(np.fmin(*nearest), np.fmax(*farther))
    on_it = np.abs(pixels - second) <= np.float32(ONE_SURFACE) * second
    total = np.where(on_it, pixels, np.float32(0.0)).sum(axis=0)
    with np.errstate(invalid="ignore"):  # nothing over nothing where there is no depth
        mean = total / on_it.sum(axis=0, dtype=np.float32)
    return np.asarray(mean, dtype=np.float32)


def back_project(depth: F32, geometry: RectifiedGeometry, step: int = 1) -> F32:
    """(H, W, 3) float32 points [m], in the rectified left camera frame, of the depth (H, W) float32 [m], NaN where that
    is, of samples of step x step pixels of the geometry's image."""
    rows, cols = depth.shape
    points = np.empty((rows, cols, 3), dtype=np.float32)
    across = np.zeros((cols, 2))
    down = np.zeros((rows, 2))
    across[:, 0] = middle_px(np.arange(float(cols)), step)
    down[:, 1] = middle_px(np.arange(float(rows)), step)
    x = geometry.rays(across)[:, 0].astype(np.float32)
    y = geometry.rays(down)[:, 1].astype(np.float32)
    np.multiply(depth, x, out=points[..., 0])
    np.multiply(depth, y[:, None], out=points[..., 1])
    points[..., 2] = depth
    return points


def point_cloud(
    disparity: F32, image: U8, geometry: RectifiedGeometry, world_SE3_left: SE3, step: int = 1
) -> PointCloud:
    """Points [m] of a disparity (H, W) in the world, with the colours of its image (H, W[, 3]); ``step`` as of
    ``back_project``. Raises WorkError: open3d is missing."""
    o3d = import_open3d("a cloud of points")
    points = back_project(geometry.depth(disparity), geometry, step).reshape(-1, 3)
    known = np.isfinite(points).all(axis=1)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(world_SE3_left @ points[known].astype(np.float64)))
    cloud.colors = o3d.utility.Vector3dVector(as_colour(image).reshape(-1, 3)[known, ::-1] / 255.0)
    return cast("PointCloud", cloud)


def median_image(images: Sequence[AnyArray]) -> F32:
    """The background of some frames, which people who move do not change: (H, W) float32 median of the valid values of
    each pixel of (H, W) images, NaN invalid; NaN where there is none."""
    sorted_so_far = list(images)
    # Whole images are sorted by exchanging neighbours, in a fraction of the time of sorting the values of each pixel.
    for first in range(len(images)):
        for k in range(first % 2, len(images) - 1, 2):
            low, high = sorted_so_far[k : k + 2]
            sorted_so_far[k : k + 2] = np.fmin(low, high), np.maximum(low, high)  # NaN comes last
    ordered = np.stack(sorted_so_far)
    known = np.isfinite(ordered).sum(axis=0, keepdims=True)
    lower = np.take_along_axis(ordered, np.maximum(known - 1, 0) // 2, axis=0)[0]
    upper = np.take_along_axis(ordered, known // 2, axis=0)[0]
    mean = np.float32(0.5) * np.add(lower, upper, dtype=np.float32)
    return np.where(known[0] > 0, mean, np.float32(np.nan))
