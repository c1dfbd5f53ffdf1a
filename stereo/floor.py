"""The floor of a stereo recording: the one estimate behind runs, their examination, calibration and benches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import compress
from typing import Any

import cv2
import numpy as np
from pydantic import Field

from calib.errors import WorkError
from calib.floor.find import find_floor
from calib.floor.plane import FLOOR_DISPARITY_STD_PX, INLIER_SIGMAS, MAD_TO_SIGMA, TUKEY_C, FloorParams, Plane, sandwich
from calib.images import as_grey
from calib.params import Params
from calib.pose import SE3
from calib.rig import Floor
from calib.types import F32, F64, U8, AnyArray, Bool
from stereo.depth import RectifiedGeometry, back_project, median_image
from stereo.matcher import RangeParams, SgbmMatcher, SgbmParams, disparity_range
from stereo.recording import DepthCamera, Frame, Recording, Shot, StereoPair
from stereo.rectify import Rectified, RectifyParams, aligned_rectifier
from stereo.rgbd import RgbdRectifier
from stereo.rig_correction import RigCorrection, match_corners
from stereo.thumbnails import Thumbnails
from stereo.viewpoint import SpreadView, Viewpoints, view_of_most

SETUP_FRAMES = 24
"""Frames, spread over a recording, in which floor and rig are measured."""
ON_ROW_PX = 0.5
"""Median row offset of corners that are matched to the right ones: chance puts them anywhere, pixels away [px]."""
FITTED_STEP_PX = 3
"""The floor is fitted to every n-th row and column."""
MIN_WATCHED, NEARER_FACTOR = 5, 1.15
"""Number of frames in which something must move, and the factor by which it is nearer than the usual depth of its
pixel: a person half a metre in front of a wall 4 m away."""
ALIGN_WINDOW, ALIGN_NOISE = 1 / 30, 3.0
"""Side of the windows in which light is taken out, of the image's width, and the least deviation in them [grey levels]
that counts as texture."""
ALIGN_STEPS, MIN_ALIGNED, ALIKE_PX = 12, 1000, 25
"""Steps of the alignment: four settle it, others which pixels are on the plane; fewest pixels for it; and how many
pixels have their error in common: a patch of 5 x 5."""
LEFT_BY_CALIBRATION = 5e-4
"""Deviation of what a calibration leaves of disparities at the edge of the image, of its width: 0.3 px at 640 (measured
on a factory calibration: up to 0.55 px)."""
SCALE_STD, FOCAL_STD = 0.003, 0.002
"""Deviations of a baseline, or of a sensor's unit of depth, and of a focal length [1]: printed boards and factories are
off by some tenths of a per cent."""
LIKE_LIGHT = 0.2
"""Logarithm of the ratio of two images' mean luma up to which they show the same light: people change it by less."""
MIN_VALID = 0.03
"""Smallest share of pixels with disparity in the median frame: a bare room still has more, unrelated images less."""


class FloorSearch(Params):
    """Parameters of the search for the floor of a recording; the defaults are those of a run."""

    frames: int = Field(SETUP_FRAMES, ge=1, le=1000)
    """Frames to look at, spread over the recording."""
    rectify: RectifyParams = RectifyParams()
    range: RangeParams = RangeParams()
    sgbm: SgbmParams = SgbmParams()
    floor: FloorParams = FloorParams()


class PairFrames:
    """Frames spread over a stereo recording, rectified by its calibration as they correct it.

    Attributes:
        sensor: what recorded them.
        frames: as recorded.
        plain: rectifier of the calibration as it is.
        rectifier: of the corrected calibration.
        correction: of the calibration, in pixels of the rectifier's images.
        searched: disparities from infinity to ``range.nearest_m``.
        view: where the cameras look over the recording, by index of its frames.
    """

    def __init__(
        self, sensor: StereoPair, frames: Sequence[Frame[Shot]], search: FloorSearch, view: SpreadView
    ) -> None:
        self.frames = frames
        self.view = view
        self.sensor = sensor
        self._search = search
        self.plain, self.rectifier, self.correction = aligned_rectifier(sensor.rig, frames, self._search.rectify)
        geometry = self.rectifier.geometry
        self.searched = disparity_range(geometry, self._search.range)
        masks = self.rectifier.mask, self.rectifier.right_mask
        self._match = SgbmMatcher(geometry, self._search.sgbm, self.searched, *masks)

    @cached_property
    def matches(self) -> F64:
        """(N, 4) float64 corners [px] in frames rectified by ``plain``: u, v, u in the right image, row offset.

        Where those by which the calibration was corrected lie on their rows then, they are right. Else disparities of
        both signs are searched in four frames, and rows that are wide apart, as they are when the wrong calibration is
        taken to an image: a rig turned by 2 degrees still matches.
        """
        is_measured = np.isfinite(self.correction.deviations).any()
        if is_measured and self.correction.after_px < ON_ROW_PX:
            return self.correction.matches
        geometry = self.plain.geometry
        searched = disparity_range(geometry)
        corners = list[F64]()
        largest = searched.first_px + searched.count
        rows_px = geometry.width * 3 // 80
        for frame in self.frames[:: -(-len(self.frames) // 4)]:
            pair = self.plain(*frame.images)
            corners.append(match_corners(pair.left_grey, pair.right_grey, largest, -largest, search_px=rows_px))
        return np.concatenate(corners)

    @cached_property
    def rectified_pairs(self) -> list[Rectified]:
        """Each pair, rectified."""
        return [self.rectifier(*frame.images) for frame in self.frames]

    @property
    def viewpoints(self) -> Viewpoints:
        """Views of the rectified cameras."""
        geometry = self.rectifier.geometry
        shots = [(pair.left_grey, pair.right_grey) for pair in self.rectified_pairs]
        return Viewpoints(shots, geometry.focal_u_px / geometry.width)

    @property
    def images(self) -> list[U8]:
        """(H, W[, 3]) uint8 rectified left image of each."""
        return [pair.image for pair in self.rectified_pairs]

    @cached_property
    def greys(self) -> list[U8]:
        """(H, W) uint8 left image of each."""
        return [pair.left_grey for pair in self.rectified_pairs]

    @cached_property
    def disparities(self) -> list[F32]:
        """(H, W) float32 disparity [px] of each, NaN where unknown."""
        return [self._match(pair.left_grey, pair.right_grey) for pair in self.rectified_pairs]

    @cached_property
    def depths(self) -> list[F32]:
        """(H, W) float32 depth [m] of each, NaN where unknown."""
        return [self.rectifier.geometry.depth(disparity) for disparity in self.disparities]

    def thumbnails(self, frame: Frame[Shot]) -> Thumbnails:
        """Thumbnails that show whether all stands still in another frame."""
        pair = self.rectifier(*frame.images)
        return Thumbnails.of_pair(pair.left_grey, pair.right_grey)

    def depth_of(self, frame: Frame[Shot]) -> F32:
        """(H, W) float32 depth [m] of another frame; NaN where unknown."""
        pair = self.rectifier(*frame.images)
        return self.rectifier.geometry.depth(self._match(pair.left_grey, pair.right_grey))

    def floor(self) -> Floor:
        """The floor common to the frames: found in the depth of each, then aligned with their images. Raises WorkError:
        hardly any disparity is valid, or no floor is visible."""
        geometry = self.rectifier.geometry
        alike = of_like_light(self.greys)
        pairs = list(compress(self.rectified_pairs, alike))
        depths = list(compress(self.depths, alike))

        def align(plane: Plane) -> Plane:
            left = median_image([pair.left_grey for pair in pairs])
            right = median_image([pair.right_grey for pair in pairs])
            aligned = align_plane(plane, left, right, median_image(depths), geometry)
            return with_calibration_errors(aligned, geometry.baseline_m, self.correction)

        return floor_in(depths, geometry, self._search.floor, align)


class DepthFrames:
    """Frames spread over a recording of images with depth, without distortion; see ``PairFrames``."""

    def __init__(
        self, sensor: DepthCamera, frames: Sequence[Frame[Shot]], search: FloorSearch, view: SpreadView
    ) -> None:
        self.sensor = sensor
        self.frames = frames
        self.view = view
        self._search = search
        self.rectifier = RgbdRectifier(sensor.camera, sensor.technology, search.rectify)
        self.searched = self.rectifier.disparities()

    @property
    def viewpoints(self) -> Viewpoints:
        """View of the camera, without distortion."""
        geometry = self.rectifier.geometry
        return Viewpoints([(image,) for image in self.images], geometry.focal_u_px / geometry.width)

    @cached_property
    def rectified_shots(self) -> list[tuple[U8, F32]]:
        """Each image and its depth [m], without distortion."""
        return [self.rectifier(*frame.images) for frame in self.frames]

    @property
    def images(self) -> list[U8]:
        """(H, W[, 3]) uint8 image of each."""
        return [image for image, _ in self.rectified_shots]

    @cached_property
    def greys(self) -> list[U8]:
        """(H, W) uint8 image of each."""
        return [as_grey(image) for image in self.images]

    @cached_property
    def disparities(self) -> list[F32]:
        """(H, W) float32 disparity [px] that a pair would have, of each."""
        return [self.rectifier.disparity(depth_m) for depth_m in self.depths]

    @cached_property
    def depths(self) -> list[F32]:
        """(H, W) float32 depth [m] of each, NaN where unknown."""
        return [depth_m for _, depth_m in self.rectified_shots]

    def thumbnails(self, frame: Frame[Shot]) -> Thumbnails:
        """Thumbnails that show whether all stands still in another frame."""
        image, depth_m = self.rectifier(*frame.images)
        return Thumbnails.of_depth(image, self.rectifier.disparity(depth_m))

    def depth_of(self, frame: Frame[Shot]) -> F32:
        """(H, W) float32 depth [m] of another frame, NaN where unknown."""
        return self.rectifier(*frame.images)[1]

    def floor(self) -> Floor:
        """The floor common to the frames. Raises WorkError: hardly any depth, or no floor is visible."""
        geometry = self.rectifier.geometry
        align = partial(with_calibration_errors, baseline_m=geometry.baseline_m)
        return floor_in(self.depths, geometry, self._search.floor, align)


FRAMES: dict[type, Callable[..., PairFrames | DepthFrames]] = {StereoPair: PairFrames, DepthCamera: DepthFrames}
"""By what recorded them, frames to measure a floor in."""


def spread_frames(recording: Recording[StereoPair | DepthCamera], search: FloorSearch) -> PairFrames | DepthFrames:
    """Frames spread over a recording, in which its floor is measured. Raises WorkError: none can be used."""
    frames, view = frames_of_one_view(recording, search.frames)
    return FRAMES[type(recording.sensor)](recording.sensor, frames, search, view)


def of_like_light(images: Sequence[U8]) -> Bool:
    """(N,) which of some images are of the light in which most of them are, or of the brighter one of two."""
    luma = np.array([float(image[::8, ::8].mean()) + 1.0 for image in images])
    alike = np.asarray(np.abs(np.log(luma[:, None] / luma)) < LIKE_LIGHT, dtype=np.bool_)
    return np.asarray(alike[np.lexsort((luma, alike.sum(axis=1)))[-1]], dtype=np.bool_)


def align_plane(plane: Plane, left: AnyArray, right: AnyArray, depth: F32, geometry: RectifiedGeometry) -> Plane:
    """The plane by which the right image, moved by the plane's disparities, looks like the left one.

    Semi-global matching smooths what stands on a floor into it: over the plane its disparities are off by a tenth of a
    pixel, 0.7 degrees of tilt. Here all pixels of the plane are matched at once, by Gauss-Newton on both images less
    their local mean, over their local deviation, with Tukey's weights (Baker and Matthews 2004). Free are the plane and
    what a calibration leaves: a rotation of one camera (x^2, x y) and the lenses (x r^2), which are small.

    Args:
        plane: first guess.
        left, right: (H, W) grey, rectified, without people.
        depth: (H, W) float32 [m] of the left image, NaN where unknown: pixels off the plane are left out.
        geometry: of the images.
    Returns:
        The plane with its covariance; the guess where the images leave the plane's disparities less certain than the
        guess may be, as without texture.
    """
    height, width = left.shape
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    x = 2 * u / width - 1
    y = (2 * v - height) / width
    to_disparity = geometry.focal_u_px * geometry.baseline_m
    basis = np.dstack([to_disparity * geometry.rays(np.dstack([u, v])), x * x, x * y, x * (x * x + y * y)])
    prior = np.diag([0.0] * 3 + [1.0 / (LEFT_BY_CALIBRATION * width) ** 2] * 3)
    window = 2 * round(width * ALIGN_WINDOW / 2) + 1
    texture = _without_light(left, window)
    gate_px = INLIER_SIGMAS * FLOOR_DISPARITY_STD_PX
    with np.errstate(invalid="ignore", divide="ignore"):
        disparity = to_disparity / depth
    slope = cv2.Sobel(texture, cv2.CV_32F, 1, 0)
    values = np.append(plane.q, np.zeros(3))
    for _ in range(ALIGN_STEPS):
        predicted = (basis @ values).astype(np.float32)
        with np.errstate(invalid="ignore"):
            near = (np.abs(disparity - predicted) < gate_px).astype(np.uint8)
        on = (cv2.erode(near, np.ones((5, 5))) > 0) & (u - predicted > window) & (u - predicted < width - window)
        if on.sum() < MIN_ALIGNED:
            return plane
        moved = _without_light(cv2.remap(right.astype(np.float32), u - predicted, v, cv2.INTER_CUBIC), window)
        left_slope = slope[on].astype(np.float64) / 8
        right_slope = cv2.Sobel(moved, cv2.CV_32F, 1, 0)[on].astype(np.float64) / 8
        error = (texture - moved)[on].astype(np.float64)
        deviation = max(MAD_TO_SIGMA * float(np.median(np.abs(error))), 1e-9)
        weight = np.maximum(1.0 - (error / (TUKEY_C * deviation)) ** 2, 0.0) ** 2 / (ALIKE_PX * deviation**2)
        # The noise of the two images is not the same, so that only texture is information.
        used = basis[on]
        information = prior + (used * (weight * left_slope * right_slope)[:, None]).T @ used
        if np.linalg.eigvalsh(information)[0] <= 0:
            return plane
        inverse = np.linalg.inv(information)
        scores = used * (weight * error * 0.5 * (left_slope + right_slope))[:, None]
        values = values - inverse @ (scores.sum(axis=0) + prior @ values)
    covariance = sandwich(inverse, scores, np.column_stack([u[on], v[on]])) + inverse @ prior @ inverse
    plane_px = used[:, :3]
    unsure_px = float(np.sqrt(np.einsum("ni,ij,nj->n", plane_px, covariance[:3, :3], plane_px).max()))
    return Plane(values[:3], plane.scale, covariance[:3, :3]) if unsure_px < gate_px else plane


def with_calibration_errors(plane: Plane, baseline_m: float, correction: RigCorrection | None = None) -> Plane:
    """The plane with the errors of a calibration added to its covariance, of which points on the plane show nothing:
    a wrong length of the baseline scales it, a yaw moves all disparities alike, a roll tilts them."""
    _, yaw, roll = (np.zeros(3) if correction is None else correction.left_over).tolist()
    scaled = SCALE_STD * plane.q
    lengthened = FOCAL_STD * plane.q * np.array([0.0, 0.0, 1.0])
    turned = np.array([[0.0, 0.0, yaw], [0.0, roll, 0.0]]) / baseline_m
    errors = np.vstack([scaled, lengthened, turned])
    return replace(plane, covariance=plane.covariance + errors.T @ errors)


def _without_light(image: AnyArray, window: int) -> F32:
    """(H, W) float32 image less its mean in windows, over its deviation there."""
    image = image.astype(np.float32)
    mean = cv2.blur(image, (window, window))
    variance = np.maximum(cv2.blur(image * image, (window, window)) - mean * mean, 0.0)
    return np.asarray((image - mean) / np.maximum(np.sqrt(variance), ALIGN_NOISE))


def floor_in(
    depths: Iterable[F32],
    geometry: RectifiedGeometry,
    params: FloorParams,
    align: Callable[[Plane], Plane] | None = None,
    near: SE3 | None = None,
) -> Floor:
    """The floor common to the (H, W) float32 depth images of some frames [m], NaN where unknown. Raises WorkError:
    there is hardly any depth, or no floor is visible.

    ``align`` improves the plane that was chosen; ``near`` is where alone it is looked for.
    """
    fitted = np.s_[::FITTED_STEP_PX, ::FITTED_STEP_PX]
    rays = back_project(np.ones(geometry.size[::-1], np.float32), geometry)[fitted]
    grids = [depth[fitted][..., None] * rays for depth in depths]
    clouds = [grid.reshape(-1, 3) for grid in grids]
    valid = float(np.median([np.isfinite(cloud[:, 2]).mean() for cloud in clouds])) if clouds else 0.0
    if valid < MIN_VALID:
        raise WorkError(
            f"expected depth in at least {MIN_VALID:.0%} of the pixels, found {valid:.1%}: the images are not of this "
            "calibration, show no texture, or all is out of range"
        )
    sigma_z = None
    if geometry.depth_std_min_m > 0.0:
        share = FLOOR_DISPARITY_STD_PX / geometry.disparity_std_px  # what medians leave of a frame's noise
        sigma_z = [np.float32(share) * geometry.depth_std_m(cloud[:, 2]) for cloud in clouds]
    return find_floor(
        clouds, focal_px=geometry.focal_u_px, baseline_m=geometry.baseline_m, sigma_z=sigma_z,
        moved=moved_patches(grids), align=align, near=near, params=params,
    )  # fmt: skip


def moved_patches(grids: Sequence[F32]) -> list[F64]:
    """(M, 3) points [m] of every patch in front of what is usually measured in its pixels: mostly people; none of fewer
    than ``MIN_WATCHED`` frames."""
    patches: list[F64] = []
    if len(grids) < MIN_WATCHED:
        return patches
    inverse = 1.0 / np.maximum(np.stack(grids)[..., 2], 0.01)
    # Unknown depth counts as farther than all else, so that what is hardly ever measured has no usual depth.
    usual = np.median(np.nan_to_num(inverse, nan=0.0), axis=0)
    nearer = (inverse > NEARER_FACTOR * usual) & (usual > 0)
    for grid, mask in zip(grids, nearer, strict=True):
        count, labels = cv2.connectedComponents(cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)))
        for label in range(1, count):
            patches.append(grid[labels == label].astype(np.float64))
    return patches


def frames_of_one_view(recording: Recording[Any], count: int) -> tuple[list[Frame[Shot]], SpreadView]:
    """Usable frames spread over a recording, of the view that most of them show, and where the cameras look over the
    recording, by index of its frames. Raises WorkError: there is none."""
    frames = recording.sample(count)
    if not frames:
        raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used")
    sensor = recording.sensor
    view = view_of_most([sensor.images(frame.images) for frame in frames], sensor.focal_widths)
    usual = [frames[number] for number in view.usual]
    elsewhere = {frames[number].index: how for number, how in view.elsewhere.items()}
    return usual, view._replace(usual=[frame.index for frame in usual], elsewhere=elsewhere)
