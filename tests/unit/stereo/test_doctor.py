"""Hypotheses: every one undoes its own fault, and is named where that was made."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from toy_rgbd import CAMERA, EMPTY, FRAMES, HEIGHT_M, depth_image
from toy_stereo import ToyWorld, toy_rig, walking

from benchmarks.doctor import DONE, rectified
from calib.camera import Camera
from calib.pose import SE3
from calib.rig import Floor, StereoRig
from calib.types import F32, U8, AnyArray
from stereo.depth import Depths, metres
from stereo.doctor.explain import _by_floor, _clearly, _Try, explain, explain_colours, explain_fields
from stereo.doctor.hypotheses import HYPOTHESES, PAIRS, TURNED, VIEWS, WHICH
from stereo.doctor.tries import FloorView
from stereo.recording import Decoded, DepthCamera, Frame, FrameClock, Pair, Recording, Shot
from stereo.rectify import rectified_rig

interlaced = DONE["interlaced, one field above the other"]
Undo = Callable[[AnyArray], AnyArray]


def rig() -> StereoRig:
    """Two cameras that are not alike: the right one is turned, and its principal point is elsewhere."""
    own = toy_rig(rotation_deg=(0.6, -0.5, 0.7), distortion=(-0.1, 0.02, 0.0, 0.0, 0.0))
    return replace(own, right=replace(own.right, cx=own.right.cx - 6.0, cy=own.right.cy + 5.0))


@cache
def pairs() -> tuple[tuple[U8, U8], ...]:
    """Of somebody who crosses a hall."""
    world = ToyWorld()
    return tuple(world.pair(rig(), walking(i), i) for i in range(0, 36, 6))


def recorded(change: Callable[[U8, U8], tuple[U8, U8]], claimed: StereoRig | None = None) -> Recording[Pair]:
    """A recording of changed pairs with a calibration that may be another."""

    def decode(indices: Sequence[int] | None) -> Generator[tuple[Decoded, ...], None, None]:
        for i in range(6) if indices is None else indices:
            yield tuple(Decoded(i, i / 2.5, image) for image in change(*pairs()[i]))

    return Recording(Path("pairs"), decode, 6, FrameClock(2.5), [], Pair(claimed or rig()))


def named(recording: Recording[Any]) -> str:
    found = explain(recording)
    return found.hypothesis.name if found else ""


@pytest.mark.parametrize("what", TURNED)
def test_what_was_done_to_an_image_is_undone(what: str) -> None:
    image = np.arange(24, dtype=np.uint8).reshape(4, 6)
    np.testing.assert_allclose(TURNED[what](DONE[what](image)), image, atol=4 if "size" in what else 0)


def test_every_hypothesis_stands_in_the_page_on_troubleshooting() -> None:
    page = (Path(__file__).parents[3] / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    words = {which for which, *_ in WHICH}
    for hypothesis in HYPOTHESES:
        first = max((which for which in words if hypothesis.name.startswith(which)), key=len, default="")
        assert f"`{first}" in page and f"{hypothesis.name.removeprefix(first).strip()}`" in page, hypothesis.name


def test_names_are_unique_and_every_hypothesis_says_what_to_do() -> None:
    assert len({hypothesis.name for hypothesis in HYPOTHESES}) == len(HYPOTHESES)
    assert all(hypothesis.remedy for hypothesis in HYPOTHESES)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (lambda a, b: (a, b), ""),
        (lambda a, b: (b, a), "left and right are exchanged"),
        (lambda a, b: (a, np.fliplr(b)), "the right images are mirrored"),
        (lambda a, b: (np.rot90(a), b), "the left images are turned by 90 degrees to the left"),
        (lambda a, b: (np.rot90(a, 2), np.rot90(b, 2)), "the images of both cameras are turned by 180 degrees"),
        (lambda a, b: (np.fliplr(b), np.fliplr(a)), "the images of both cameras are exchanged and mirrored"),
        (lambda a, b: (a, interlaced(b)), "the right images are interlaced, one field above the other"),
        (lambda a, b: (a, DONE["of half the size"](b)), "the right images are of half the size"),
        (rectified(rig()), "the images are rectified already"),
        (lambda a, b: (255 - a, b), "the images of one camera are negative"),
        (lambda a, b: (a, np.random.default_rng(int(b[0, 0])).integers(0, 255, b.shape, np.uint8)), ""),
    ],
    ids=[
        "right", "exchanged", "mirrored", "turned", "upside down", "both", "interlaced", "half", "rectified",
        "negative", "noise",
    ],
)  # fmt: skip
def test_fault_of_images_is_named(fault: Callable[[U8, U8], tuple[U8, U8]], name: str) -> None:
    assert named(recorded(fault)) == name


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
        (replace(rig(), left=rig().right, right=rig().left), "the lenses of left and right are exchanged"),
        (claimed(baseline=100.0), "the baseline is in centimetres"),
        (claimed(scale=2.0), "the calibration is that of images twice the size"),
        (rectified_rig(rig()), "the images are not rectified yet"),
    ],
    ids=["pose", "lenses", "baseline", "size", "raw"],
)
def test_fault_of_the_calibration_is_named(rig: StereoRig, name: str) -> None:
    assert named(recorded(lambda a, b: (a, b), rig)) == name


def test_red_and_blue_that_are_exchanged_in_one_camera_are_named() -> None:
    rows = np.random.default_rng(1).integers(0, 255, (60, 1, 3), dtype=np.uint8).repeat(80, axis=1)
    frame = Frame[Shot](0, 0.0, ((rows, np.ascontiguousarray(rows[..., ::-1])),))
    found = explain_colours([frame])
    assert found is not None and str(found).startswith("if red and blue are exchanged in the images of one camera")
    assert explain_colours([replace(frame, shots=((rows, rows),))]) is None


def seen(share: float, height_m: float, plausible: float) -> FloorView:
    return FloorView(Floor(SE3(np.eye(3), np.array([0.0, 0.0, height_m])), inlier_fraction=share), plausible)


UPSIDE_DOWN = next(hypothesis for hypothesis in VIEWS if hypothesis.turns == 2)


def test_a_ceiling_as_large_as_the_floor_does_not_turn_the_camera() -> None:
    assert _by_floor([(UPSIDE_DOWN, seen(0.4, 2.5, -0.9))], seen(0.4, 0.94, -2.8)) is None
    assert _by_floor([(UPSIDE_DOWN, seen(0.4, 2.5, -0.9))], FloorView()) is not None


def test_two_hypotheses_that_explain_as_much_are_both_named() -> None:
    tries = [_Try(PAIRS[0], -1.0, "rows agree"), _Try(PAIRS[1], -1.1, "rows agree"), _Try(PAIRS[2], -9.0, "")]
    found = f"either if {PAIRS[0].name}, rows agree, or if {PAIRS[1].name}, rows agree"
    assert str(_clearly(tries, -5.0)) == f"{found}: {PAIRS[0].remedy} or {PAIRS[1].remedy}"
    assert _clearly(tries, -1.1) is None


def test_images_woven_of_two_fields_are_named_where_something_moves() -> None:
    images = [np.full((80, 100), 40, np.uint8) for _ in range(6)]
    for i, image in enumerate(images):
        image[20:60, 5 + 15 * i : 15 + 15 * i] = 200
    woven = [now.copy() for now in images[:-1]]
    for image, later in zip(woven, images[1:], strict=True):
        image[1::2] = later[1::2]
    frames, whole = ([Frame[Shot](i, 0.1 * i, ((one,),)) for i, one in enumerate(each)] for each in (woven, images))
    found = explain_fields(frames)
    assert found is not None and found.hypothesis.name == "each image is woven of two fields of different times"
    assert explain_fields(whole) is None


RAY: F32 = np.linalg.norm(
    CAMERA.unproject(np.indices((CAMERA.height, CAMERA.width))[::-1].reshape(2, -1).T), axis=1
).reshape(CAMERA.height, CAMERA.width).astype(np.float32)  # fmt: skip


def measured(change: Undo, camera: Camera = CAMERA) -> Recording[DepthCamera]:
    """A recording of changed depth in millimetres."""
    units = Depths()

    def decode(indices: Sequence[int] | None) -> Generator[tuple[Decoded, ...], None, None]:
        for i in range(FRAMES) if indices is None else indices:
            depth = depth_image(max(i, EMPTY))
            stored = change(np.where(depth < 9, depth * 1000, 0).round()).astype(np.uint16)
            image = np.zeros(stored.shape, np.uint8)
            yield Decoded(i, i / 10, image), Decoded(i, i / 10, metres(stored, units.units_per_m))

    head = DepthCamera(camera, "", "structured-light", lambda depth: depth, None, units)
    return Recording(Path("depth"), cast(Any, decode), FRAMES, FrameClock(10.0), [], head)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (lambda mm: mm, ""),
        (lambda mm: mm * 5, "depth counts 5000 values per metre"),
        (lambda mm: mm.astype(np.uint16).byteswap(), "depth has its two bytes exchanged"),
        (lambda mm: mm * RAY, "depth is measured along the ray"),
        (lambda mm: mm / RAY, "depth was taken from the ray to the axis twice"),
        (lambda mm: np.where(mm > 0, 6e7 / np.maximum(mm, 1), 0), "depth is inverse depth or disparity"),
        (lambda mm: np.rot90(mm, 2), "the camera hangs upside down"),
    ],
    ids=["right", "units", "bytes", "ray", "ray twice", "inverse", "upside down"],
)
def test_fault_of_depth_is_named_with_the_floor_that_it_hides(fault: Undo, name: str) -> None:
    found = explain(measured(fault))
    assert (found.hypothesis.name if found else "") == name
    if found and "inverse" not in name:  # whose scale is not known
        assert f"the floor is {HEIGHT_M:.1f}" in found.gives


@pytest.mark.parametrize(("turns", "side"), [(1, "left"), (-1, "right")])
def test_depth_camera_that_lies_on_its_side_is_named(turns: int, side: str) -> None:
    c = CAMERA
    cx, cy = (c.cy, c.width - 1 - c.cx) if turns > 0 else (c.height - 1 - c.cy, c.cx)
    found = explain(measured(lambda mm: np.rot90(mm, turns), Camera(c.height, c.width, c.fy, c.fx, cx, cy)))
    assert found is not None and found.hypothesis.name == f"the camera lies on its {side} side"
