"""The table of hypotheses: ways in which a recording may not be what it seems, and what undoes each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import cv2
import numpy as np

from calib.camera import Camera
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F32, U8, AnyArray
from stereo.depth import DEPTH_UNITS, metres
from stereo.rectify import rectified_rig


class StoredDepth(NamedTuple):
    """How depth is stored: values per metre, (H, W) length of each pixel's ray at unit depth, and the usual value."""

    units_per_m: float
    ray: F32
    usual: float


def _as_it_is(image: AnyArray) -> AnyArray:
    return image


@dataclass(frozen=True)
class Hypothesis:
    """One way in which a recording may not be what it seems.

    Attributes:
        name: what is so, a clause.
        remedy: what to do then, a clause.
        exchanged: whether left and right are to be exchanged.
        left, right: make the image of a side, once they are exchanged, what it should be.
        rig: makes the calibration of a pair what it should be.
        rows: what row offsets may be where the calibration is that of rectified images: "shifted" alike, or "curved",
            as lenses and turned cameras make them.
        depth: makes (H, W) metres along the axis of (H, W) stored values.
        placed: lays depth, or a map of it, onto the image.
        baseline: factor to the baseline.
        turns: quarter turns of the view, counterclockwise, after which the camera stands upright.
    """

    name: str
    remedy: str
    exchanged: bool = False
    left: Callable[[U8], U8] = _as_it_is
    right: Callable[[U8], U8] = _as_it_is
    rig: Callable[[StereoRig], StereoRig] | None = None
    rows: Literal["aligned", "shifted", "curved"] = "aligned"
    depth: Callable[[AnyArray, StoredDepth], F32] | None = None
    placed: Callable[[F32], F32] = _as_it_is
    baseline: float = 1.0
    turns: int = 0

    def images(self, left: U8, right: U8) -> tuple[U8, U8]:
        """A recorded pair as it should be."""
        first, second = (right, left) if self.exchanged else (left, right)
        return np.ascontiguousarray(self.left(first)), np.ascontiguousarray(self.right(second))


def _woven(image: U8) -> U8:
    """The rows of the upper and the lower half in turn."""
    half = len(image) // 2
    return np.stack([image[:half], image[half : 2 * half]], axis=1).reshape(2 * half, *image.shape[1:])


def _twice_as_large(image: U8) -> U8:
    return np.asarray(cv2.resize(image, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)


def _of_images(scale: float) -> Callable[[StereoRig], StereoRig]:
    """The calibration of images ``scale`` times as large, fitted to these."""

    def fitted(own: Camera) -> Camera:
        cx, cy = ((centre + 0.5) / scale - 0.5 for centre in (own.cx, own.cy))
        return replace(own, fx=own.fx / scale, fy=own.fy / scale, cx=cx, cy=cy)

    return lambda rig: replace(rig, left=fitted(rig.left), right=fitted(rig.right))


def _inverted(rig: StereoRig) -> StereoRig:
    """The inverse pose, with the right camera on the right."""
    pose = rig.right_SE3_left.inverse()
    return replace(rig, right_SE3_left=SE3(pose.rotation, -pose.translation))


def _of_other_cameras(rig: StereoRig) -> StereoRig:
    """The lens of each camera for the other one."""
    return replace(rig, left=rig.right, right=rig.left)


def _in_units(per_m: float) -> Callable[[AnyArray, StoredDepth], F32]:
    return lambda values, stored: metres(values, per_m)


def _swapped(values: AnyArray, stored: StoredDepth) -> F32:
    return metres(values.byteswap(), stored.units_per_m)


def _along_ray(values: AnyArray, stored: StoredDepth) -> F32:
    return metres(values, stored.units_per_m) / stored.ray


def _divided_twice(values: AnyArray, stored: StoredDepth) -> F32:
    return metres(values, stored.units_per_m) * stored.ray


def _inverse(values: AnyArray, stored: StoredDepth) -> F32:
    """Depth of values that grow towards the camera, the usual one at 3 m: their unit is not known."""
    depth = np.where(values > 0, 3.0 * stored.usual / np.maximum(values, 1e-6), 0.0)
    return metres(depth.astype(np.float32).clip(0, 1e3), 1.0)


def _in_size(scale: float) -> Callable[[F32], F32]:
    """A map at another size, around its middle."""

    def placed(depth: F32) -> F32:
        height, width = depth.shape
        to = np.array([[scale, 0.0, (1 - scale) * width / 2], [0.0, scale, (1 - scale) * height / 2]])
        return np.asarray(cv2.warpAffine(depth, to, (width, height), flags=cv2.INTER_LINEAR), dtype=np.float32)

    return placed


AS_RECORDED = Hypothesis("", "")
TURNED: dict[str, Callable[[AnyArray], AnyArray]] = {
    "mirrored": lambda image: image[:, ::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "flipped top to bottom": lambda image: image[::-1],
    "turned by 90 degrees to the left": lambda image: np.rot90(image, -1),
    "turned by 90 degrees to the right": np.rot90,
    "interlaced, one field above the other": _woven,
    "of half the size": _twice_as_large,
}
"""What may have been done to images, and what undoes it."""
WHICH = (
    ("the right images are", False, False, True),
    ("the left images are", False, True, False),
    ("the images of both cameras are", False, True, True),
    ("the images of both cameras are exchanged and", True, True, True),
)
"""To which images, whether they are exchanged, and whether it is undone in the left and the right one."""
LENGTHS = {
    "millimetres": 1e-3, "centimetres": 1e-2, "inches, or in squares of about 25 mm": 0.0254, "decimetres": 0.1,
    "feet": 0.3048, "tens of metres": 10.0, "kilometres": 1e3,
}  # fmt: skip
"""Units of a baseline [m]."""
BACK = "record or convert the images as the cameras took them"
SCALED = "give the calibration of these images"
REGISTER = "give the calibration of the depth camera and its pose, or record registered depth"
UPRIGHT = "turn the images, and calibrate the turned ones"
TIMES = "give each camera the times of its images; where one counts from 0 and the other from 1, renumber it"
PAIRS = (
    Hypothesis("left and right are exchanged", "exchange them", exchanged=True),
    *(
        Hypothesis(f"{which} {what}", BACK, exchanged, undo if left else _as_it_is, undo if right else _as_it_is)
        for what, undo in TURNED.items()
        for which, exchanged, left, right in WHICH
    ),
    Hypothesis("the images of one camera are negative", BACK, right=lambda image: 255 - image),
    Hypothesis("the images are rectified already", "give the calibration of the rectified images", rig=rectified_rig),
    Hypothesis("the images of one camera are shifted up or down", "cut the images of both alike", rows="shifted"),
    Hypothesis("the images are not rectified yet", "give the calibration of the images as they are", rows="curved"),
    Hypothesis("the lenses of left and right are exchanged", "exchange them in the calibration", rig=_of_other_cameras),
    Hypothesis("the pose of the right camera is inverted", "store right_SE3_left, not left_SE3_right", rig=_inverted),
    *(
        Hypothesis(f"the calibration is that of images {what} the size", SCALED, rig=_of_images(scale))
        for what, scale in (("twice", 2.0), ("1.5 times", 1.5), ("two thirds of", 2 / 3), ("half", 0.5))
    ),
)
"""Of the images and the calibration of a pair: rows show them."""
COLOURS = Hypothesis("red and blue are exchanged in the images of one camera", "exchange its channels")
"""Of colours, which both cameras see alike."""
FIELDS = Hypothesis("each image is woven of two fields of different times", "deinterlace it (ffmpeg -vf yadif)")
"""Of what moves, which has combed edges."""
VIEWS = (
    *(Hypothesis(f"the baseline is in {unit}", "give it in metres", baseline=m) for unit, m in LENGTHS.items()),
    Hypothesis("the camera hangs upside down", UPRIGHT, turns=2),
    Hypothesis("the camera lies on its left side", UPRIGHT, turns=3),
    Hypothesis("the camera lies on its right side", UPRIGHT, turns=1),
)
"""Of what is measured rightly and taken wrongly: the floor shows them."""
DEPTHS = (
    *(Hypothesis(f"depth counts {n:g} values per metre", "state its scale", depth=_in_units(n)) for n in DEPTH_UNITS),
    Hypothesis("depth has its two bytes exchanged", "exchange the bytes of each value", depth=_swapped),
    Hypothesis("depth is measured along the ray", "divide it by the ray's length at unit depth", depth=_along_ray),
    Hypothesis("depth was taken from the ray to the axis twice", "leave it as it was measured", depth=_divided_twice),
    Hypothesis("depth is inverse depth or disparity", "store focal length x baseline / disparity", depth=_inverse),
)
"""Of stored depth: the floor shows them."""
PLACES = (
    Hypothesis("depth is mirrored against its image", BACK, placed=lambda depth: depth[:, ::-1]),
    Hypothesis("depth is flipped top to bottom against its image", BACK, placed=lambda depth: depth[::-1]),
    Hypothesis("depth is turned by 180 degrees against its image", BACK, placed=lambda depth: depth[::-1, ::-1]),
    *(
        Hypothesis(f"depth is not registered to its image, {size:g} of its size", REGISTER, placed=_in_size(size))
        for size in (0.72, 0.84, 0.92, 1.09, 1.19, 1.39)
    ),
)
"""Of depth on its image, whose edges it has. Unregistered depth has the size of another lens: 0.92 of Kinects, 0.72 of
RealSense."""
OFFSET_DEPTH = Hypothesis("depth is not registered to its image but offset from it", REGISTER)
LATE = {
    "right camera": Hypothesis("the cameras are not synchronous, or one of them is numbered one higher", TIMES),
    "depth": Hypothesis("depth and its image are not of one time", TIMES),
}
"""Of time: what moves, moves in both at once."""
HYPOTHESES = (*PAIRS, COLOURS, FIELDS, *VIEWS, *DEPTHS, *PLACES, OFFSET_DEPTH, *LATE.values())
UNEXPLAINED = f"none of {len(HYPOTHESES)} causes that were tried explains it"
