"""Hypotheses: every one undoes its own fault, and is named where that was made."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
from toy_rgbd import CAMERA, EMPTY, FRAMES, HEIGHT_M, depth_image
from toy_stereo import ToyWorld, toy_rig, walking

from calib.camera import Camera
from calib.doubt import best
from calib.pose import SE3
from calib.rig import Floor, StereoRig
from calib.types import F32, U8, AnyArray
from stereo.depth import Depths
from stereo.doctor.diagnose import diagnose, place_of_depth
from stereo.doctor.hypotheses import HYPOTHESES, MOUNTS
from stereo.doctor.scenes import NO_FLOOR, FloorView, floor_score
from stereo.recording import Decoded, DepthCamera, Frame, FrameClock, Recording, Shot, StereoPair
from stereo.rectify import rectified_rig

Change = Callable[[AnyArray], AnyArray]


def rig() -> StereoRig:
    """Two cameras that are not alike: the right one is turned, and its principal point is elsewhere."""
    own = toy_rig(rotation_deg=(0.6, -0.5, 0.7), distortion=(-0.1, 0.02, 0.0, 0.0, 0.0))
    return replace(own, right=replace(own.right, cx=own.right.cx - 6.0, cy=own.right.cy + 5.0))


@cache
def pairs() -> tuple[tuple[U8, U8], ...]:
    """Of somebody who crosses a hall."""
    world = ToyWorld()
    return tuple(world.pair(rig(), walking(i), i) for i in range(0, 36, 6))


def recorded(change: Callable[[U8, U8], tuple[U8, U8]], claimed: StereoRig | None = None) -> Recording[StereoPair]:
    """A recording of changed pairs with a calibration that may be another."""

    def decode(indices):
        for i in range(6) if indices is None else indices:
            yield tuple(Decoded(i, i / 2.5, image) for image in change(*pairs()[i]))

    return Recording(Path("pairs"), decode, 6, FrameClock(2.5), [], StereoPair(claimed or rig()))


def named(recording: Recording[Any]) -> str:
    finding = diagnose(recording)
    return finding.names if finding else ""


def test_names_of_hypotheses_are_unique():
    assert len({hypothesis.name for hypothesis in HYPOTHESES}) == len(HYPOTHESES)


def test_every_hypothesis_says_what_to_do():
    assert all(hypothesis.remedy for hypothesis in HYPOTHESES)


def upside_down(image: U8) -> U8:
    return np.ascontiguousarray(np.rot90(image, 2))


def rectified(left: U8, right: U8) -> tuple[U8, U8]:
    """Images as OpenCV rectifies them."""
    own = rig()
    pose = own.right_SE3_left
    k1, d1 = own.left.matrix, own.left.coefficients
    k2, d2 = own.right.matrix, own.right.coefficients
    shift = pose.translation.reshape(3, 1)
    r1, r2, p1, p2, *_ = cv2.stereoRectify(k1, d1, k2, d2, own.left.size, pose.rotation, shift, alpha=0)
    to_left = cv2.initUndistortRectifyMap(k1, d1, r1, p1, own.left.size, cv2.CV_32FC1)
    to_right = cv2.initUndistortRectifyMap(k2, d2, r2, p2, own.left.size, cv2.CV_32FC1)
    aligned = cv2.remap(left, *to_left, cv2.INTER_LINEAR), cv2.remap(right, *to_right, cv2.INTER_LINEAR)
    return np.asarray(aligned[0], np.uint8), np.asarray(aligned[1], np.uint8)


def noise(left: U8, right: U8) -> tuple[U8, U8]:
    return left, np.random.default_rng(int(right[0, 0])).integers(0, 255, right.shape, np.uint8)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (lambda a, b: (a, b), ""),
        (lambda a, b: (b, a), "left and right are exchanged"),
        (lambda a, b: (a, upside_down(b)), "the right images are upside down"),
        (lambda a, b: (upside_down(a), b), "the left images are upside down"),
        (lambda a, b: (upside_down(a), upside_down(b)), "the images of both cameras are upside down"),
        (lambda a, b: (np.fliplr(a), np.fliplr(b)), "the images of both cameras are mirrored"),
        (rectified, "the images are rectified already"),
        (noise, ""),
    ],
    ids=["right", "exchanged", "right upside down", "left upside down", "both", "mirrored", "rectified", "noise"],
)
def test_fault_of_images_is_named(fault, name):
    assert named(recorded(fault)) == name


def test_images_cut_at_another_height_are_named():
    def cut(left, right):
        left, right = rectified(left, right)
        return left, np.roll(right, 4, axis=0)

    assert named(recorded(cut, rectified_rig(rig()))) == "the images of one camera are shifted up or down"


def sized(camera: Camera, scale: float) -> Camera:
    """The camera of images that are larger, under the size of these."""
    larger = camera.scaled(round(scale * camera.width), round(scale * camera.height))
    return replace(larger, width=camera.width, height=camera.height)


def claimed(turned: bool = False, baseline: float = 1.0, scale: float = 1.0) -> StereoRig:
    own, pose = rig(), rig().right_SE3_left
    if turned:
        pose = SE3(pose.rotation.T, -pose.inverse().translation)
    left, right = (sized(camera, scale) for camera in (own.left, own.right))
    return StereoRig(left, right, SE3(pose.rotation, baseline * pose.translation))


@pytest.mark.parametrize(
    ("rig", "name"),
    [
        (claimed(turned=True), "the pose of the right camera is inverted"),
        (claimed(baseline=100.0), "the baseline is in centimetres"),
        (claimed(scale=2.0), "the calibration is that of images twice the size"),
        (rectified_rig(rig()), "the images are not rectified yet"),
    ],
    ids=["pose", "baseline", "size", "raw"],
)
def test_fault_of_the_calibration_is_named(rig, name):
    assert named(recorded(lambda a, b: (a, b), rig)) == name


CEILING = FloorView(Floor(SE3(np.eye(3), np.array([0.0, 0.0, 2.5])), inlier_fraction=0.4), -0.9)


@pytest.mark.parametrize(("plausible", "is_turned"), [(-2.8, False), (NO_FLOOR, True)], ids=["a floor", "none"])
def test_a_ceiling_as_large_as_the_floor_does_not_turn_the_camera(plausible, is_turned):
    as_recorded = FloorView(CEILING.floor, plausible)
    upside_down = replace(MOUNTS[0], undo=lambda view: CEILING)
    finding = best(as_recorded, [upside_down], lambda view: floor_score(view, as_recorded))
    assert (finding is not None) == is_turned


RAY: F32 = np.linalg.norm(
    CAMERA.unproject(np.indices((CAMERA.height, CAMERA.width))[::-1].reshape(2, -1).T), axis=1
).reshape(CAMERA.height, CAMERA.width).astype(np.float32)  # fmt: skip


def measured(change: Change, camera: Camera = CAMERA, dtype: type = np.uint16) -> Recording[DepthCamera]:
    """A recording of changed depth in millimetres."""
    units = Depths()

    def decode(indices):
        for i in range(FRAMES) if indices is None else indices:
            depth = depth_image(max(i, EMPTY))
            stored = change(np.where(depth < 9, depth * 1000, 0).round()).astype(dtype)
            image = np.zeros(stored.shape, np.uint8)
            yield Decoded(i, i / 10, image), Decoded(i, i / 10, units(stored))

    sensor = DepthCamera(camera, "", "structured-light", lambda depth: depth, None, units)
    return Recording(Path("depth"), cast(Any, decode), FRAMES, FrameClock(10.0), [], sensor)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (lambda mm: mm, ""),
        (lambda mm: mm * 5, "depth counts 5000 values per metre"),
        (lambda mm: mm * RAY, "depth is measured along the ray"),
        (lambda mm: np.where(mm > 0, 6e7 / np.maximum(mm, 1), 0), "depth is inverse depth or disparity"),
        (lambda mm: np.rot90(mm, 2), "the camera hangs upside down"),
    ],
    ids=["right", "units", "ray", "inverse", "upside down"],
)
def test_fault_of_depth_is_named_with_the_floor_that_it_hides(fault, name):
    finding = diagnose(measured(fault))
    assert (finding.hypothesis.name if finding else "") == name
    if finding and "inverse" not in name:  # whose scale is not known
        assert f"the floor is {HEIGHT_M:.1f}" in finding.measured


def test_unit_of_floating_point_depth_that_is_not_metres_is_named():
    assert named(measured(lambda mm: mm, dtype=np.float32)) == "depth counts 1000 values per metre"


def test_floating_point_depth_in_metres_is_right():
    assert diagnose(measured(lambda mm: mm / 1000, dtype=np.float32)) is None


@pytest.mark.parametrize(("turns", "side"), [(1, "left"), (-1, "right")])
def test_depth_camera_that_lies_on_its_side_is_named(turns, side):
    c = CAMERA
    cx, cy = (c.cy, c.width - 1 - c.cx) if turns > 0 else (c.height - 1 - c.cy, c.cx)
    recording = measured(lambda mm: np.rot90(mm, turns), Camera(c.height, c.width, c.fy, c.fx, cx, cy))
    assert named(recording) == f"the camera lies on its {side} side"


def with_depth(lay: Callable[[F32], F32]) -> list[Frame[Shot]]:
    """Frames of boxes that stand before a wall, whose depth is laid onto them in some way."""
    frames = []
    for i in range(6):
        image = np.full((120, 160), 60, np.uint8)
        depth = np.full(image.shape, 4.0, np.float32)
        for x, y in ((15, 20), (60 + 6 * i, 50), (115, 75)):
            image[y : y + 30, x : x + 18] = 200
            depth[y : y + 30, x : x + 18] = 2.0
        frames.append(Frame[Shot](i, 0.1 * i, ((image, np.ascontiguousarray(lay(depth))),)))
    return frames


@pytest.mark.parametrize(
    ("lay", "name"),
    [
        (lambda depth: depth, ""),
        (np.fliplr, "depth is mirrored against its image"),
        (lambda depth: np.roll(depth, 8, axis=1), "depth is not registered to its image but offset from it"),
    ],
    ids=["right", "mirrored", "offset"],
)
def test_depth_that_does_not_lie_on_its_image_is_named(lay, name):
    finding = place_of_depth(with_depth(lay)).finding
    assert (finding.names if finding else "") == name


def test_depth_lies_where_it_was_moved_to():
    across_px, down_px = place_of_depth(with_depth(lambda depth: np.roll(depth, 2, axis=1))).shift_px
    assert (across_px, down_px) == pytest.approx((-8.0, 0.0), abs=2.1)
