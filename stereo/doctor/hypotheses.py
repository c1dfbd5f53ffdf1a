"""The table of hypotheses: ways in which a recording may not be what it seems, and what undoes each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from calib.camera import Camera
from calib.doubt import Hypothesis
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F32, AnyArray
from stereo.depth import DEPTH_UNITS, metres
from stereo.doctor.overlay import Overlay
from stereo.doctor.pairs import Pairs
from stereo.doctor.scenes import DepthScene, StoredDepth
from stereo.rectify import rectified_rig

AS_TAKEN = "record or convert the images as the cameras took them"
SCALED = "give the calibration of these images"
REGISTER = "give the calibration of the depth camera and its pose, or record registered depth"
SCALE = "state its scale, or store floating-point numbers in metres"
UPRIGHT = "turn the images, and calibrate the turned ones"
TIMES = "give each camera the times of its images; where one counts from 0 and the other from 1, renumber it"
PLANE_ODDS = 100.0
"""Odds against a hypothesis that a plane alone supports, which may be a ceiling or a wall: people who stand on it
decide."""
CURVED_ODDS = 2.0
"""Odds against rows that bend: what bends may also be moved."""


def _images(undo: Callable[[AnyArray, AnyArray], tuple[AnyArray, AnyArray]]) -> Callable[[Pairs], Pairs]:
    """Makes each pair of images what it should be."""
    return lambda pairs: replace(pairs, shots=[undo(*shot) for shot in pairs.shots])


def _turn_by_180(image: AnyArray) -> AnyArray:
    return image[::-1, ::-1]


def _rig(undo: Callable[[StereoRig], StereoRig]) -> Callable[[Pairs], Pairs]:
    """Makes the calibration what it should be."""
    return lambda pairs: replace(pairs, rig=undo(pairs.rig))


def _invert(rig: StereoRig) -> StereoRig:
    """The inverse pose, with the right camera on the right."""
    pose = rig.right_SE3_left.inverse()
    return replace(rig, right_SE3_left=SE3(pose.rotation, -pose.translation))


def _of_images(scale: float) -> Callable[[StereoRig], StereoRig]:
    """The calibration of images ``scale`` times as large, fitted to these."""

    def fit(camera: Camera) -> Camera:
        cx = (camera.cx + 0.5) / scale - 0.5
        cy = (camera.cy + 0.5) / scale - 0.5
        return replace(camera, fx=camera.fx / scale, fy=camera.fy / scale, cx=cx, cy=cy)

    return lambda rig: replace(rig, left=fit(rig.left), right=fit(rig.right))


RAW_PAIRS = (
    Hypothesis[Pairs](
        "the images of one camera are shifted up or down",
        "cut the images of both alike",
        lambda pairs: replace(pairs, rows="shifted"),
    ),
    Hypothesis[Pairs](
        "the images are not rectified yet",
        "give the calibration of the images as they are",
        lambda pairs: replace(pairs, rows="curved"),
        CURVED_ODDS,
    ),
)
"""Hypotheses about images that do not lie on their rows under a calibration of rectified ones."""
PAIRS = (
    Hypothesis("left and right are exchanged", "exchange them", _images(lambda left, right: (right, left))),
    Hypothesis("the right images are upside down", AS_TAKEN, _images(lambda left, right: (left, _turn_by_180(right)))),
    Hypothesis("the left images are upside down", AS_TAKEN, _images(lambda left, right: (_turn_by_180(left), right))),
    Hypothesis(
        "the images of both cameras are upside down",
        AS_TAKEN,
        _images(lambda left, right: (_turn_by_180(left), _turn_by_180(right))),
    ),
    Hypothesis(
        "the images of both cameras are mirrored",
        AS_TAKEN,
        _images(lambda left, right: (left[:, ::-1], right[:, ::-1])),
    ),
    Hypothesis("the images are rectified already", "give the calibration of the rectified images", _rig(rectified_rig)),
    Hypothesis("the pose of the right camera is inverted", "store right_SE3_left, not left_SE3_right", _rig(_invert)),
    Hypothesis("the calibration is that of images twice the size", SCALED, _rig(_of_images(2.0))),
    Hypothesis("the calibration is that of images half the size", SCALED, _rig(_of_images(0.5))),
)
"""Hypotheses about the images and the calibration of a pair: rows show them."""


def _baseline(name: str, unit_m: float) -> Hypothesis[DepthScene]:
    return Hypothesis(f"the baseline is in {name}", "give it in metres", lambda scene: scene.scale(unit_m))


def _mount(how: str, quarters: int) -> Hypothesis[DepthScene]:
    return Hypothesis(f"the camera {how}", UPRIGHT, lambda scene: scene.turn(quarters), PLANE_ODDS)


BASELINES = (
    _baseline("millimetres", 0.001),
    _baseline("centimetres", 0.01),
    _baseline("inches, or in squares of about 25 mm", 0.0254),
)
MOUNTS = (
    _mount("hangs upside down", 2),
    _mount("lies on its left side", 3),
    _mount("lies on its right side", 1),
)
"""Hypotheses about how measurements are taken: the floor shows them."""


def _units(per_metre: float) -> Hypothesis[DepthScene]:
    def in_metres(values: AnyArray, stored: StoredDepth) -> F32:
        return metres(values / per_metre, 1.0)

    return Hypothesis(f"depth counts {per_metre:g} values per metre", SCALE, lambda scene: scene.read(in_metres))


def _inverse(values: AnyArray, stored: StoredDepth) -> F32:
    """Depth of values that grow towards the camera, the usual one at 3 m: their unit is not known."""
    return metres(np.where(values > 0, 3.0 * stored.usual / np.maximum(values, 1e-6), 0.0), 1.0)


UNITS = tuple(_units(per_metre) for per_metre in DEPTH_UNITS)
DEPTHS = (
    *UNITS,
    Hypothesis[DepthScene](
        "depth is measured along the ray",
        "divide it by the ray's length at unit depth",
        lambda scene: scene.read(lambda values, stored: metres(values / stored.units_per_m / stored.ray, 1.0)),
    ),
    Hypothesis[DepthScene](
        "depth is inverse depth or disparity",
        "store focal length x baseline / disparity",
        lambda scene: scene.read(_inverse),
        PLANE_ODDS,
    ),
)
"""Hypotheses about stored depth: the floor shows them."""


def _in_size(scale: float) -> Callable[[F32], F32]:
    """A map at another size, around its middle."""

    def lay(depth: F32) -> F32:
        height, width = depth.shape
        to = np.array([[scale, 0.0, (1 - scale) * width / 2], [0.0, scale, (1 - scale) * height / 2]])
        return np.asarray(cv2.warpAffine(depth, to, (width, height), flags=cv2.INTER_LINEAR), dtype=np.float32)

    return lay


def _registration(size: float) -> Hypothesis[Overlay]:
    name = f"depth is not registered to its image, {size:g} of its size"
    return Hypothesis(name, REGISTER, lambda overlay: overlay.lay(_in_size(size)))


PLACES = (
    Hypothesis[Overlay](
        "depth is mirrored against its image", AS_TAKEN, lambda overlay: overlay.lay(lambda depth: depth[:, ::-1])
    ),
    *(_registration(size) for size in (0.72, 0.84, 0.92, 1.09, 1.19, 1.39)),
)
"""Hypotheses about depth on its image, whose edges it has. Unregistered depth has the size of another lens: 0.92 of
Kinects, 0.72 of RealSense, and the inverse where the image is not registered to the depth."""
OFFSET_DEPTH = Hypothesis[Overlay](
    "depth is not registered to its image but offset from it", REGISTER, lambda overlay: overlay.at_best_shift
)


def _late(name: str) -> Hypothesis[Any]:
    """Hypothesis about lags with ``frames`` and ``gain``, the log odds of the lag against none."""
    return Hypothesis(name, TIMES, lambda lag: lag._replace(frames=0.0, gain=0.0))


LATE = {
    "right camera": _late("the cameras are not synchronous, or one of them is numbered one higher"),
    "depth": _late("depth and its image are not of one time"),
}
"""Hypotheses about time: what moves, moves in both at once."""
BY_KIND: dict[str, tuple[Hypothesis[Any], ...]] = {
    "images and calibration of a pair": (*PAIRS, *RAW_PAIRS),
    "baseline": BASELINES,
    "mount": MOUNTS,
    "depth": DEPTHS,
    "depth on its image": (*PLACES, OFFSET_DEPTH),
    "time": tuple(LATE.values()),
}
"""All of them, by what they are about."""
HYPOTHESES = tuple(hypothesis for kind in BY_KIND.values() for hypothesis in kind)
UNEXPLAINED = f"none of {len(HYPOTHESES)} causes that were tried explains it"
