"""Cameras that stand still, move or are cut, and depth that is not of its image."""

import re
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from toy_recordings import write_frames

from calib.ground_camera import GroundCamera, save_ground_camera
from calib.types import F32, U8
from planview.checks.check import Check
from planview.checks.examine import examine
from planview.checks.images import standing_checks
from planview.checks.scene import registration_checks
from stereo.readers import OpenOptions
from stereo.recording import Frame, Shot
from stereo.viewpoint import Standing, Viewpoints


def scene(seed: int) -> U8:
    """(120, 300) uint8 patches, wider than the image."""
    coarse = np.random.default_rng(seed).integers(40, 216, (12, 30), dtype=np.uint8)
    return cv2.resize(coarse, (300, 120), interpolation=cv2.INTER_CUBIC)


SCENE, OTHER = scene(1), scene(2)
SIZE = (160, 120)


def window(image: U8, left_px: int = 0) -> U8:
    return np.ascontiguousarray(image[:, left_px : left_px + SIZE[0]])


def watched(frames: list[U8]) -> tuple[Standing, list[bool]]:
    """Follow one camera at ten frames a second: whether it stands in each frame."""
    standing = Standing(Viewpoints([], 1.0))
    return standing, [standing.update(i, 0.1 * i, (frame,)) for i, frame in enumerate(frames)]


def test_panning_camera_settles_when_it_stops():
    frames = [window(SCENE)] * 10 + [window(SCENE, 2 * i) for i in range(20)]
    standing, stands = watched(frames)
    assert stands[:10] == [True] * 10
    assert stands[16:] == [False] * 14
    assert not standing.is_settled
    assert watched(frames + [frames[-1]] * 15)[0].is_settled


def test_camera_that_pans_from_the_start_stands_when_it_stops():
    pan = [window(SCENE, 2 * i) for i in range(20)]
    _, stands = watched(pan + [pan[-1]] * 7)
    assert stands[3:20] == [False] * 17
    assert stands[-1]


def test_frames_in_which_a_camera_swings_out_of_its_view_are_counted_as_shaking():
    frames = [window(SCENE, 40 + shift_px) for shift_px in [0] * 12 + [4, -4] + [0] * 10]
    moved, shake = standing_checks(watched(frames)[0], "")
    assert moved.ok
    assert not shake.ok
    assert "in 2 frames" in shake.note


def test_cut_is_named_after_three_seconds():
    standing, stands = watched([window(SCENE if i < 4 else OTHER) for i in range(37)])
    assert stands == [True] * 36 + [False]
    assert standing.is_settled
    assert "another view at frame" in standing_checks(standing, "")[0].note


@pytest.mark.parametrize("frames", [25, 1], ids=["a person close before the camera", "one damaged frame"])
def test_a_short_break_is_no_cut(frames):
    assert all(watched([window(SCENE)] * 4 + [window(OTHER, i) for i in range(frames)] + [window(SCENE)] * 4)[1])


def test_frames_that_show_nothing_are_no_cut():
    noise = np.random.default_rng(0).integers(0, 256, (2, 20, 120, 160), np.uint8)
    frames = [*noise[0], *[np.zeros((120, 160), np.uint8)] * 20, *noise[1]]
    assert all(watched([window(SCENE)] * 4 + frames + [window(SCENE)] * 4)[1])


def test_textured_person_before_a_plain_wall_is_no_moving_camera():
    frames = [np.full(SIZE[::-1], 120, np.uint8) for _ in range(25)]
    for i, frame in enumerate(frames):
        frame[20:110, 4 * i + 10 : 4 * i + 60] = SCENE[20:110, :50]
    assert all(watched(frames)[1])


def test_crowd_that_fills_the_view_is_no_moving_camera():
    steps = np.array([-2, -2, 2, 2] * 3) * np.random.default_rng(3).uniform(0.7, 1.3, 12)

    def crowd(i):
        rows = [np.roll(SCENE[10 * row : 10 * row + 10], round(step * i), axis=1) for row, step in enumerate(steps)]
        return window(np.concatenate(rows))

    assert all(watched([crowd(i) for i in range(30)])[1])


def test_camera_that_zooms_while_turning_moves():
    def zoomed(i):
        motion = cv2.getRotationMatrix2D((80.0, 60.0), 0.5 * i, 1.0 + 0.01 * i)
        return cv2.warpAffine(SCENE, motion, SIZE, borderMode=cv2.BORDER_REFLECT)

    assert not all(watched([zoomed(i) for i in range(20)])[1])


def test_large_person_before_a_dark_noisy_wall_is_no_scene_cut():
    rng = np.random.default_rng(0)
    frames = [np.clip(rng.normal(30.0, 6.0, SIZE[::-1]), 0, 255).astype(np.uint8) for _ in range(50)]
    for frame in frames[6:]:
        frame[:, 40:120] = OTHER[:, :80]
    assert all(watched(frames)[1])


def test_of_one_camera_is_checked_what_one_camera_shows(tmp_path):
    still, shaken, camera = tmp_path / "still.avi", tmp_path / "shaken.avi", tmp_path / "camera.toml"
    write_frames(still, [window(SCENE)] * 12)
    write_frames(shaken, [window(SCENE, 4 * i) for i in range(12)])
    fine = examine(still).checks
    assert all(c.ok for c in fine)
    assert {"camera moved", "over-exposure"} <= {c.name for c in fine}
    assert {c.name for c in examine(shaken).checks if not c.ok} == {"camera moved"}
    save_ground_camera(GroundCamera(160, 120, 100.0, 25.0, 0.5), camera)
    found = examine(still, OpenOptions(camera)).checks
    assert [c.name for c in found if not c.ok] == ["camera height"]
    save_ground_camera(GroundCamera(320, 240, 100.0, 3.0, 0.5), camera)
    assert "images of 160x120 px, found one for 320x240 px" in examine(still, OpenOptions(camera)).checks[0].note


W, H = 320, 240


def frame(index: int) -> Frame[Shot]:
    """A room of boxes, and somebody who walks there and back."""
    rng = np.random.default_rng(1)
    image, depth = np.full((H, W), 90, np.uint8), np.full((H, W), 5.0, np.float32)
    boxes = [(*rng.integers(0, (W - 40, H - 40)), *rng.integers(20, 60, 2), rng.integers(0, 255), 2 + 2 * rng.random())
             for _ in range(9)]  # fmt: skip
    walker = (round(140 + 110 * np.sin(index / 9) + 20 * np.sin(index / 2.3)), 90, 30, 90, 230, 1.6)
    for x, y, width, height, level, z in (*boxes, walker):
        image[y : y + height, x : x + width], depth[y : y + height, x : x + width] = level, z
    noise = np.random.default_rng(index).normal(0, 3, (H, W))
    return Frame(index, index / 15, ((np.clip(image + noise, 0, 255).astype(np.uint8), depth),))


FRAMES = [frame(index) for index in range(60)]


def failing(change: Callable[[F32], F32] = lambda depth: depth, late: int = 0) -> dict[str, Check]:
    """The checks, by name, that fail when depth is changed, or late by some frames."""
    pairs = zip(FRAMES[late:], FRAMES[: len(FRAMES) - late], strict=True)
    shots = [(now, (now.image, np.ascontiguousarray(change(then.images[1])))) for now, then in pairs]
    frames = [replace(now, shots=(shot,)) for now, shot in shots]
    return {check.name: check for check in registration_checks(frames[::5], frames) if not check.ok}


def scaled(depth: F32) -> F32:
    to = np.array([[0.92, 0.0, 0.04 * W], [0.0, 0.92, 0.04 * H]])
    return np.asarray(cv2.warpAffine(depth, to, (W, H), flags=cv2.INTER_NEAREST, borderValue=float("nan")), np.float32)


def test_depth_of_its_image_passes():
    assert failing() == {}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda depth: np.roll(depth, -12, axis=1), r"\+2[2-6] px to the right, [+-][0-2] down"),
        (lambda depth: np.roll(depth, 10, axis=0), r"[+-][0-2] px to the right, -(18|20|22) down"),
        (scaled, r"not registered to its image, 1\.09 of its size"),
    ],
    ids=["to the left", "down", "another lens"],
)
def test_depth_that_is_not_of_its_image_is_named_with_its_figure(change, named):
    assert re.search(named, failing(change)["depth on its image"].note)


@pytest.mark.parametrize("late", [1, 3])
def test_depth_that_is_late_is_named_with_its_delay(late):
    check = failing(late=late)["depth delay"]
    assert check.note.startswith(
        "if depth and its image are not of one time, depth late of its image, by movement: give"
    )
    assert check.value == pytest.approx(late, abs=0.3)


def test_images_without_edges_are_not_judged():
    flat = [replace(one, shots=((np.full((H, W), 90, np.uint8), one.images[1]),)) for one in FRAMES]
    assert all(check.ok for check in registration_checks(flat[::5], flat))
